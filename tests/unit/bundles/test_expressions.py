"""Formulas and constraints: what parses, what has a value, and that nothing else happens."""

import contextlib
import math
import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from tests.support.effort import examples
from tests.support.values import faults_of

from drivecal.bundles.expressions import Constraint, Formula, UndefinedError
from drivecal.domain.errors import InvalidInputError

MEASURES = ("energy_kwh", "min_ttc_s", "x", "engine.mass", "mean-gap")
PARAMETERS: dict[str, tuple[str, ...]] = {"a": (), "b": (), "v0": (), "mode": ("eco", "sport"), "engine.mass": ()}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("100*energy_kwh + 10/max(min_ttc_s, 0.1)", 100 * 1.5 + 10 / 2.0),
        ("-x ** 2", -9.0),
        ("2 ** -1", 0.5),
        ("+x - -x", 6.0),
        ("clip(x, 0, 1) + clip(-x, -1, 1)", 0.0),
        ("min(x, 1, 2) + abs(-2) + sqrt(16) + exp(0) + log(1)", 1 + 2 + 4 + 1),
        ("  x\n + 1\t", 4.0),
        ("engine.mass / 2", 800.0),
        (".5 + 1. + 1e-1", 1.6),
        ("7", 7.0),
    ],
)
def test_a_formula_has_the_value_of_its_arithmetic(text: str, value: float) -> None:
    values = {"energy_kwh": 1.5, "min_ttc_s": 2.0, "x": 3.0, "engine.mass": 1600.0}
    assert Formula(text, MEASURES)(values) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(
    ("text", "column"),
    [
        ("", None),
        ("x +", None),
        ("x y", None),
        ("energy + 1", 1),
        ("1 + energy_kw", 5),
        ("mean-gap", 1),
        ("min", 1),
        ("min(x)", 1),
        ("min(*x, 1)", 1),
        ("floor(x)", 1),
        ("x(1)", 1),
        ("min(x, key=1)", None),
        ("x.real", 1),
        ("x < 1", 1),
        ("'x'", 1),
        ("x % 2", 3),
        ("x ^ 2", 3),
        ("x ** 101", 6),
        ("1e999", 1),
        ("9" * 1990, 1),
        ("1_000", 1),
        ("1if x else 2", 1),
        ("True", 1),
        ("lambda", None),
        ("__import__('os')", None),
        ("x := 1", 3),
        ("x # comment", 3),
        ("x\x00", 2),
        ("\ud800", 1),
        ("x" * 3000, None),
        ("(" * 1900, None),
        ("-" * 1900 + "x", None),
        ("x+" * 900 + "x", None),
        ("2**" * 600 + "2", None),
        ("min(x," * 300 + "x" + ")" * 300, None),
        ("x" + ".x" * 900, None),
    ],
)
def test_anything_else_is_refused_at_its_column(text: str, column: int | None) -> None:
    refusal = faults_of(Formula, text, MEASURES, "scores.cost.formula")
    for problem in refusal:
        assert problem.field == "scores.cost.formula"
        assert problem.remedy
    assert column is None or refusal[0].message.startswith(f"column {column}:")


def test_every_fault_of_a_formula_is_named_with_the_nearest_name() -> None:
    remedies = [problem.remedy for problem in faults_of(Formula, "energy_kw + 2*min_tcc_s + floor(y)", MEASURES)]
    assert len(remedies) == 3
    assert "energy_kwh" in remedies[0]
    assert "min_ttc_s" in remedies[1]


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("1/x", {"x": 0.0}),
        ("sqrt(x)", {"x": -1.0}),
        ("x ** 0.5", {"x": -1.0}),
        ("exp(x)", {"x": 1e6}),
        ("1/(x*x)", {"x": 1e200}),
        ("x", {"x": math.inf}),
        ("min(x, 1)", {"x": math.nan}),
        ("x", {}),
    ],
)
def test_a_formula_without_a_value_says_so_with_its_values(text: str, values: dict[str, float]) -> None:
    with pytest.raises(UndefinedError) as error:
        Formula(text, MEASURES)(values)
    assert error.value.expression == text
    assert error.value.reason
    assert error.value.values.keys() == values.keys()
    copy = pickle.loads(pickle.dumps(error.value))
    assert str(copy) == str(error.value)


def test_white_space_does_not_change_the_canonical_text() -> None:
    assert Formula(" x  +\n1 ", MEASURES).canonical == Formula("x+1", MEASURES).canonical


@pytest.mark.parametrize(
    ("text", "values", "holds"),
    [
        ("a <= b", {"a": 1.0, "b": 1.0}, True),
        ("a < b", {"a": 1.0, "b": 1.0}, False),
        ("a != b", {"a": 1.0, "b": 1.0}, False),
        ("v0 >= 10*a", {"v0": 30.0, "a": 2.5}, True),
        ("0 < a < b", {"a": 1.0, "b": 0.5}, False),
        ("0 < a and a < 2 and b == 1", {"a": 1.0, "b": 1.0}, True),
        ("mode == 'eco'", {"mode": "eco"}, True),
        ("'eco' != mode", {"mode": "eco"}, False),
        ('mode != "sport" or a <= 1', {"mode": "sport", "a": 2.0}, False),
        ("3*a <= b", {"a": 0.1, "b": 0.3}, True),
        ("3*a > b", {"a": 0.1, "b": 0.3}, False),
        ("1/a < 5", {"a": 0.0}, False),
        ("1/a >= 5", {"a": 0.0}, False),
        ("1/a != 5", {"a": 0.0}, False),
        ("engine.mass > a", {"engine.mass": 2.0, "a": 1.0}, True),
    ],
)
def test_a_constraint_holds_or_not_in_a_set_and_in_a_population(text: str, values: dict[str, Any], holds: bool) -> None:
    constraint = Constraint(text, PARAMETERS)
    assert constraint.holds(values) is holds
    columns = {name: np.array([value] * 3) for name, value in values.items()}
    assert constraint(columns).tolist() == [holds] * 3
    assert set(constraint.names) == set(values)


@pytest.mark.parametrize(
    "text",
    [
        "a",
        "1 < 2",
        "a = b",
        "not a < b",
        "a <= c",
        "mode == eco",
        "mode == 'ecco'",
        "mode <= 'eco'",
        "mode == 1",
        "a == 'eco'",
        "mode == 'eco' == mode",
        "a in b",
        "a <= 'x",
        "'eco' == 'eco'",
        "a+" * 900 + "a < 1",
    ],
)
def test_a_faulty_constraint_is_refused(text: str) -> None:
    assert all(
        problem.field == "constraints[0]" and problem.remedy
        for problem in faults_of(Constraint, text, PARAMETERS, "constraints[0]")
    )


SIGNS = ". , + - * / ** ( ) < <= == != >= > = [ ] { } : := @ # \\ % _ ' \" \x00 ; \n"
NAMES = "a b v0 mode engine and or not in is if else lambda min max clip sqrt exp log True None await yield ä"
constants = ["'eco'", '"x"', "f'{a}'", "1", "0", "2.5", "1e9", "1e-300", "99999999999"]
words = st.sampled_from([*SIGNS.split(" "), *NAMES.split(" "), *constants])
texts = st.lists(words, max_size=60).map(" ".join) | st.lists(words, max_size=60).map("".join) | st.text(max_size=200)


@settings(deadline=None, max_examples=examples(200))
@given(text=texts)
@example("a**" * 60 + "a < 1")
def test_whatever_is_given_is_refused_or_evaluates(text: str) -> None:
    try:
        constraint = Constraint(text, PARAMETERS)
    except InvalidInputError:
        pass
    else:
        assert constraint.holds({"a": 2.0, "b": 0.0, "v0": -1e6, "mode": "eco", "engine.mass": 1e6}) in {True, False}
    try:
        formula = Formula(text, list(PARAMETERS))
    except InvalidInputError:
        return
    with contextlib.suppress(UndefinedError):
        assert math.isfinite(formula({"a": 2.0, "b": 0.0, "v0": -1e6, "mode": 1.0, "engine.mass": 1e6}))


numbers = st.sampled_from(["a", "b", "v0", "0", "1", "2.5", "1e-3", "(1e90*1e90)"])
arithmetic = st.recursive(
    numbers,
    lambda inner: (
        st.tuples(inner, st.sampled_from(["+", "-", "*", "/", "**"]), inner).map(lambda parts: f"({' '.join(parts)})")
        | st.tuples(st.sampled_from(["abs", "sqrt", "exp", "log", "-"]), inner).map(lambda parts: f"{parts[0]}({parts[1]})")
        | st.tuples(st.sampled_from(["min", "max"]), inner, inner).map(lambda parts: f"{parts[0]}({parts[1]}, {parts[2]})")
        | st.tuples(inner, inner, inner).map(lambda parts: f"clip({', '.join(parts)})")
    ),
    max_leaves=12,
)
comparisons = st.tuples(arithmetic, st.sampled_from(["<=", "<", ">=", ">", "==", "!="]), arithmetic).map(" ".join)
conditions = st.lists(comparisons | st.just("mode == 'eco'"), min_size=1, max_size=3).map(" and ".join)
grid = st.integers(-30, 30).map(lambda value: value / 10)
rows = st.tuples(grid, grid, st.floats(-1e6, 1e6), st.sampled_from(["eco", "sport"]))


@settings(deadline=None, max_examples=examples(150))
@given(text=conditions, population=st.lists(rows, min_size=1, max_size=9))
def test_a_population_is_judged_as_each_of_its_rows(text: str, population: list[tuple[float, float, float, str]]) -> None:
    constraint = Constraint(f"{text} and (a <= 5 or b <= 5)", PARAMETERS)
    keys = ("a", "b", "v0", "mode")
    columns = {key: np.array(column) for key, column in zip(keys, zip(*population, strict=True), strict=True)}
    alone = [constraint.holds(dict(zip(keys, row, strict=True))) for row in population]
    assert constraint(columns).tolist() == alone


linear = st.recursive(
    st.sampled_from(["a", "b", "v0", "0", "1", "2.5"]),
    lambda inner: (
        st.tuples(inner, st.sampled_from(["+", "-"]), inner).map(lambda parts: f"({' '.join(parts)})")
        | st.tuples(st.sampled_from(["2 * ", "-", "-0.5 * ", "+"]), inner).map(lambda parts: f"{parts[0]}({parts[1]})")
        | st.tuples(inner, st.sampled_from([" / 4", " * (1 - 3)"])).map("".join)
    ),
    max_leaves=6,
)
chains = st.tuples(linear, st.sampled_from(["<=", "<", ">=", ">", "=="]), linear, st.sampled_from(["<", ">="]), linear)


@settings(deadline=None, max_examples=examples(150))
@given(text=chains.map(" ".join), a=grid, b=grid, v0=grid)
def test_linear_comparisons_are_known_as_inequalities(text: str, a: float, b: float, v0: float) -> None:
    constraint = Constraint(f"{text} and a <= 99", PARAMETERS)
    values = {"a": a, "b": b, "v0": v0}
    sums = [
        sum(factor * values[name] for name, factor in each.coefficients.items()) - each.bound
        for each in constraint.inequalities
    ]
    if constraint.holds(values):
        assert max(sums) <= 1e-9
    elif all(abs(total) > 1e-9 for total in sums) and len(sums) == 3 + ("==" in text):  # a comparison of constants is none
        assert max(sums) > 0


def test_conditions_of_which_one_suffices_imply_no_inequality() -> None:
    assert Constraint("a <= b or b <= 1", PARAMETERS).inequalities == ()
    assert len(Constraint("a <= b and (a <= 1 or b <= 1) and a*b <= 1 and abs(a) < 3", PARAMETERS).inequalities) == 1
