"""Rows of a table by conditions on its columns."""

from typing import Any

import pytest
from tests.support.values import faults_of

from drivecal.api.tables.selection import selection
from drivecal.contracts.tables import Column

COLUMNS = [
    Column("outcome", "text"),
    Column("mode", "text"),
    Column("P1", "number"),
    Column("id", "integer"),
    Column("audited", "truth"),
    Column("histogram", "numbers"),
]
ROWS: list[dict[str, Any]] = [
    {"id": 1, "outcome": "reused", "mode": "a=b", "P1": 0.5, "audited": False, "histogram": []},
    {"id": 2, "outcome": "failed", "mode": "eco", "P1": None, "audited": True, "histogram": []},
    {"id": 3, "outcome": "simulated", "mode": "eco", "P1": 2.0, "audited": True, "histogram": []},
    {"id": 4, "outcome": None, "mode": "eco", "P1": -1.5, "audited": False, "histogram": []},
]


def kept(*conditions: str) -> list[int]:
    keeps = selection(conditions, COLUMNS)
    return [row["id"] for row in ROWS if keeps(row)]


def test_several_values_of_a_column_are_alternatives_and_everything_else_has_to_hold() -> None:
    assert kept() == [1, 2, 3, 4]
    assert kept("outcome=reused", "outcome=simulated") == [1, 3]
    assert kept("outcome=simulated", "mode=eco", "audited=true") == [3]
    assert kept("mode=a=b") == kept("mode = a=b ") == [1]
    assert kept("outcome=") == []


def test_a_range_holds_its_ends_and_no_missing_value() -> None:
    assert kept("P1>=0.5") == [1, 3]
    assert kept("P1>=-1.5", "P1<=0.5") == [1, 4]
    assert kept("id=3") == kept("id = 3") == [3]


@pytest.mark.parametrize(
    "condition",
    ["", "P1", "=3", "unknown=1", "histogram=1", "P1=much", "outcome>=a", "audited=1", "P1>=", "P1>2", "P1>=nan", "P1<=inf"],
)
def test_a_condition_that_cannot_be_read_is_named(condition: str) -> None:
    assert [problem.field for problem in faults_of(selection, ["outcome=reused", condition], COLUMNS)] == ["where[1]"]
