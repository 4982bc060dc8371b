"""Constraints of a manifest that leave nothing, or seem to."""

from collections.abc import Mapping
from typing import Any

import pytest
from tests.support.values import faults_of

from drivecal.bundles.checks import checked
from drivecal.bundles.expressions import Constraint
from drivecal.domain.constraints import MOST_OPERATIONS


def constrained(constraints: list[str], **sections: Any) -> dict[str, Any]:
    """A manifest with two numbers, a choice, and constraints on them."""
    return {
        "problem": "p",
        "parameters": {"x": {"lower": 0, "upper": 1}, "y": {"lower": 0, "upper": 1}, "mode": {"choices": ["eco", "sport"]}},
        "constraints": constraints,
        "simulator": {"kind": "python", "file": "model.py"},
        "scenarios": {"s": {}},
        "measures": {"m": "1"},
        "scores": {"cost": {"formula": "m", "direction": "minimise", "range": [0, 1]}},
    } | sections


@pytest.mark.parametrize(
    ("constraints", "left"),
    [
        (["x + y >= 1"], True),
        (["x >= 2"], False),
        (["x >= 0.6", "x + y <= 0.5"], False),
        (["mode == 'eco'", "mode == 'sport'"], False),
        (["x*x + y*y <= 0.0004"], True),  # a corner
    ],
)
def test_constraints_that_leave_nothing_are_refused_with_what_was_tried(constraints: list[str], *, left: bool) -> None:
    if left:
        assert checked(constrained(constraints)).constraints == tuple(constraints)
        return
    [problem] = faults_of(checked, constrained(constraints))
    assert problem.field == "constraints"
    assert "65,536" in problem.message
    assert "baseline" in problem.remedy


@pytest.mark.slow
def test_the_search_behind_long_constraints_tries_fewer_sets(monkeypatch: pytest.MonkeyPatch) -> None:
    """A push of a hundred long constraints kept the server at them for a quarter of an hour."""
    longest = "x + y >= 3" + " or x + y >= 3" * 60
    sets: list[int] = []
    evaluate = Constraint.__call__

    def counted(self: Constraint, columns: Mapping[str, Any]) -> Any:
        sets.append(len(columns["x"]))
        return evaluate(self, columns)

    monkeypatch.setattr(Constraint, "__call__", counted)
    [problem] = faults_of(checked, constrained([f"{longest} or x >= {number}" for number in range(3, 103)]))
    assert "778 sets" in problem.message
    assert "baseline" in problem.remedy
    words = 7 * 61 + 4
    assert sum(sets) >= 32 * 100
    assert sum(sets) * words <= MOST_OPERATIONS + 2 * 3 * 100 * words  # the middle and two corners, for the names as well


def test_a_baseline_proves_that_constraints_leave_something() -> None:
    baseline = {"x": 0.123456789, "y": 0.5, "mode": "eco"}
    assert checked(constrained(["x == 0.123456789", "y == 0.5"], baseline=baseline)).baseline == baseline
