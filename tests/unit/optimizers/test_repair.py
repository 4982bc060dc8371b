"""Constraints kept by repair: always feasible, pure, near, and resumable with every optimizer."""

from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.effort import examples

from drivecal.domain.constraints import Constraint, Constraints
from drivecal.domain.errors import InvalidInputError
from drivecal.domain.parameters import Indices, Parameter, ParameterSet, ParameterSpace
from drivecal.optimizers.repair import Repair

SPACE = ParameterSpace(
    (
        Parameter.from_step("a", Decimal(0), Decimal(10), None),
        Parameter.from_step("b", Decimal(0), Decimal(10), Decimal("0.1")),
        Parameter.integer("n", Decimal(-5), Decimal(5)),
        Parameter.choice("mode", ["eco", "sport", "winter"]),
        Parameter.from_step("held", Decimal(0), Decimal(1), Decimal("0.5")),
    ),
    {"held": Decimal("0.5")},
)
LISTED: dict[str, Constraint] = {
    "a <= b": lambda values: values["a"] <= values["b"],
    "a + n * held >= 1": lambda values: values["a"] + values["n"] * values["held"] >= 1,
    "mode != winter or n > 0": lambda values: (values["mode"] != "winter") | (values["n"] > 0),
    "a / n is no number": lambda values: np.isfinite(values["a"] / values["n"]),
}
CONSTRAINTS = Constraints(SPACE, LISTED)
LAST = SPACE.n_values - 1
REPAIR = Repair(SPACE.n_values, SPACE.kinds, CONSTRAINTS.feasible, CONSTRAINTS.anchors(0 * LAST, LAST))

rows = st.tuples(*(st.integers(0, last) for last in LAST.tolist()))
populations: st.SearchStrategy[Indices] = st.lists(rows, min_size=1, max_size=8).map(np.array)


def holds(row: list[int]) -> bool:
    values = SPACE.parameter_set(row).floats
    a, b, n = (float(values[name]) for name in ("a", "b", "n"))
    return a <= b and a + n * 0.5 >= 1 and (values["mode"] != "winter" or n > 0) and n != 0


def test_the_names_of_constraints_are_what_their_functions_read() -> None:
    assert CONSTRAINTS.names == {"a", "b", "n", "held", "mode"}
    assert Constraints(SPACE, {"a <= b": LISTED["a <= b"]}).names == {"a", "b"}
    assert Constraints(SPACE, {"all": lambda values: np.ones(len(dict(values)["a"]), dtype=bool)}).names == set(SPACE.names) | {
        "held"
    }
    assert Constraints(SPACE).names == frozenset()


@given(populations)
def test_feasible_rows_are_those_that_keep_every_constraint(population: Indices) -> None:
    assert CONSTRAINTS.feasible(population).tolist() == [holds(row) for row in population.tolist()]


@given(populations, st.data())
@settings(deadline=None, max_examples=examples(20))
def test_repair_is_feasible_idempotent_and_a_pure_function_of_the_row(population: Indices, data: st.DataObject) -> None:
    repaired = REPAIR(population)
    assert CONSTRAINTS.feasible(repaired).all()
    assert (repaired >= 0).all()
    assert (repaired <= LAST).all()
    kept = CONSTRAINTS.feasible(population)
    assert repaired[kept].tolist() == population[kept].tolist()
    assert REPAIR(repaired).tolist() == repaired.tolist()
    order = data.draw(st.permutations(range(len(population))))
    assert REPAIR(population[order]).tolist() == repaired[order].tolist()
    assert REPAIR(population[:1]).tolist() == repaired[:1].tolist()


@given(populations)
@settings(deadline=None, max_examples=examples(20))
def test_a_replacement_is_no_farther_than_the_nearest_anchor(population: Indices) -> None:
    def away(others: Indices, row: Indices) -> float:
        shares = (others - row) / LAST
        shares[..., 3] = others[..., 3] != row[3]
        return float((shares**2).sum(axis=-1).min())

    anchors = CONSTRAINTS.anchors(0 * LAST, LAST)
    for row, repaired in zip(population, REPAIR(population), strict=True):
        assert away(repaired, row) <= away(anchors, row) + 1e-12


def test_a_row_beyond_one_border_moves_to_it() -> None:
    square = ParameterSpace(tuple(Parameter.from_step(name, Decimal(0), Decimal(10), Decimal("0.1")) for name in "ab"))
    constraints = Constraints(square, {"a <= b": lambda values: values["a"] <= values["b"]})
    repair = Repair(
        square.n_values, square.kinds, constraints.feasible, constraints.anchors(np.array([0, 0]), np.array([100, 100]))
    )
    (moved,) = repair(np.array([[60, 50]])).tolist()
    assert moved[0] <= moved[1]
    assert max(abs(moved[0] - 60), abs(moved[1] - 50)) <= 10


def test_constraints_that_leave_nothing_are_named() -> None:
    never = Constraints(SPACE, LISTED | {"a > 11": lambda values: values["a"] > 11})
    with pytest.raises(InvalidInputError) as refused:
        never.anchors(0 * LAST, LAST)
    (problem,) = refused.value.problems
    assert problem.field == "constraints"
    assert "a > 11" in problem.message
    assert "a <= b" not in problem.message
    assert not never.allow_any(0 * LAST, LAST)
    conflict = {"a < 5": lambda values: values["a"] < 5, "a > 6": lambda values: values["a"] > 6}
    with pytest.raises(InvalidInputError, match="a < 5, a > 6"):
        Constraints(SPACE, conflict).anchors(0 * LAST, LAST)


def test_a_set_that_breaks_constraints_is_refused_with_each_of_them() -> None:
    values: dict[str, Decimal | str] = {"a": Decimal(7), "b": Decimal(6), "n": Decimal(-1), "mode": "winter"}
    with pytest.raises(InvalidInputError) as refused:
        CONSTRAINTS.check(ParameterSet.of(values | {"held": Decimal("0.5")}), "baseline")
    assert [problem.field for problem in refused.value.problems] == ["baseline", "baseline"]
    assert ["a <= b" in problem.message for problem in refused.value.problems] == [True, False]
    CONSTRAINTS.check(ParameterSet.of(values | {"a": Decimal(2), "mode": "eco", "held": Decimal("0.5")}), "baseline")
