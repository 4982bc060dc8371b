"""Constraints of a space: the names that they read, the sets that they allow, and errors that name them."""

from __future__ import annotations

from decimal import Decimal
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.values import faults_of

from drivecal.domain.constraints import ChangeFrom, ChangeLimit, Constraint, Constraints
from drivecal.domain.errors import InvalidInputError
from drivecal.domain.parameters import Indices, Parameter, ParameterSet, ParameterSpace

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

rows = st.tuples(*(st.integers(0, last) for last in LAST.tolist()))
populations: st.SearchStrategy[Indices] = st.lists(rows, min_size=1, max_size=8).map(np.array)


def holds(row: list[int]) -> bool:
    values = SPACE.parameter_set(row).floats
    a, b, n = (float(values[name]) for name in ("a", "b", "n"))
    return a <= b and a + n * 0.5 >= 1 and (values["mode"] != "winter" or n > 0) and n != 0


LIMITS = [("changes", 2.0), ("largest", 0.15), ("sum", 0.4), ("sum", 1.5)]


@pytest.mark.parametrize(("kind", "most"), LIMITS)
def test_repair_and_samples_keep_limits_of_change_and_constraints(kind: Any, most: float) -> None:
    numbers = [Parameter.from_step(f"p{place}", Decimal(0), Decimal(1), Decimal("0.01")) for place in range(6)]
    space = ParameterSpace((*numbers, Parameter.choice("mode", ["a", "b", "c"])))
    reference = space.parameter_set([50, 40, 50, 50, 50, 50, 1])
    limit = ChangeLimit(ChangeFrom.between(kind, space, reference), most)
    constraints = Constraints(space, {"p0 >= p1": lambda columns: columns["p0"] >= columns["p1"]}, (limit,))
    generator = np.random.default_rng(1)
    rows = np.stack([generator.integers(0, each.n_values, 200) for each in space.searched], axis=1)
    region = constraints.whole_region
    for made in (region.repair(rows), region.sample(200, generator)):
        assert constraints.feasible(made).all()
        assert max(limit.change.of(each) for each in space.parameter_sets(made)) <= most + 1e-9
        assert len(np.unique(made, axis=0)) > 20
    near = region.sample(5, generator)
    assert (region.repair(near) == near).all(), "feasible sets stay"


def test_the_names_of_constraints_are_what_their_functions_read() -> None:
    assert set().union(*CONSTRAINTS.read.values()) == {"a", "b", "n", "held", "mode"}
    some = Constraints(SPACE, {"a <= b": LISTED["a <= b"], "all": lambda values: np.ones(len(dict(values)["a"]), dtype=bool)})
    assert some.read == {"a <= b": {"a", "b"}, "all": {*SPACE.names, "held"}}


@given(populations)
def test_feasible_rows_are_those_that_keep_every_constraint(population: Indices) -> None:
    assert CONSTRAINTS.feasible(population).tolist() == [holds(row) for row in population.tolist()]


def test_constraints_that_leave_nothing_are_named() -> None:
    never = Constraints(SPACE, LISTED | {"a > 11": lambda values: values["a"] > 11})
    (problem,) = faults_of(never.region, 0 * LAST, LAST)
    assert problem.field == "constraints"
    assert "a > 11" in problem.message
    assert "a <= b" not in problem.message
    conflict = {"a < 5": lambda values: values["a"] < 5, "a > 6": lambda values: values["a"] > 6}
    with pytest.raises(InvalidInputError, match="a < 5, a > 6"):
        Constraints(SPACE, conflict).region(0 * LAST, LAST)


def test_a_set_that_breaks_constraints_is_refused_with_each_of_them() -> None:
    values: dict[str, Decimal | str] = {"a": Decimal(7), "b": Decimal(6), "n": Decimal(-1), "mode": "winter"}
    refused = faults_of(CONSTRAINTS.check, ParameterSet.of(values | {"held": Decimal("0.5")}), "baseline")
    assert [problem.field for problem in refused] == ["baseline", "baseline"]
    assert ["a <= b" in problem.message for problem in refused] == [True, False]
    CONSTRAINTS.check(ParameterSet.of(values | {"a": Decimal(2), "mode": "eco", "held": Decimal("0.5")}), "baseline")
