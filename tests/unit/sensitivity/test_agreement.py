"""When two influence maps say the same."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivecal.contracts.tables import InfluenceRow
from drivecal.sensitivity.agreement import agree, agreement


def row(lower: float | None = 0, upper: float | None = 1, *, intervals: int | None = 5, **given: Any) -> InfluenceRow:
    """Returns the row of a parameter from 0 to 1 in steps of 0.05, analysed in intervals of 0.2."""
    known: dict[str, Any] = {"scenario": "S1", "parameter": "P1", "influential": True, "space_lower": 0, "space_upper": 1}
    measured = None if intervals is None else [0.1] * intervals
    return InfluenceRow(**{**known, "lower": lower, "upper": upper, "n_values": 21, "s_rel_intervals": measured, **given})


NOTHING = row(None, None, influential=False)


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        (row(0.2, 0.8), row(0.4, 0.6), True),
        (row(0.2, 0.8), row(0.45, 0.8), False),
        (row(0.2, 0.8), row(0.2, 0.55), False),
        (row(0.2, 0.8), row(0.2 + 0.225, 0.8), True),  # an interval and half a grid step
        (row(0.2, 0.8, intervals=10), row(0.4, 0.8, intervals=5), True),  # the coarser analysis counts
        (row(0.2, 0.8, intervals=10), row(0.4, 0.8, intervals=10), False),
        (row(0.2, 0.8, intervals=None), row(0.2, 0.8, intervals=None), True),
        (row(0.2, 0.8, intervals=None), row(0.25, 0.8, intervals=None), False),
        (row(0.2, 0.8, intervals=None), row(0.25, 0.8), True),
        (NOTHING, NOTHING, True),
        (NOTHING, row(0.2, 0.2), False),
        (row(None, 0.5), row(None, 0.6), True),
        (row(None, 0.5), row(0, 0.5), False),
    ],
)
def test_bounds_may_differ_by_one_interval(first: InfluenceRow, second: InfluenceRow, *, expected: bool) -> None:
    assert agree(first, second, (first, second)) is expected
    assert agree(second, first, (first, second)) is expected


def test_what_only_one_map_knows_is_listed_and_not_counted() -> None:
    ours = [row(), row(parameter="P2"), row(scenario="S2")]
    theirs = [row(0.5, 1), row(parameter="P2"), row(parameter="P3")]
    result = agreement(ours, theirs)
    assert (result.pairs, result.agreeing, result.share) == (2, 1, 0.5)
    assert [tuple(each.lower for each in rows) for rows in result.differences] == [(0, 0.5)]
    assert (result.only_first, result.only_second) == ((("S2", "P1"),), (("S1", "P3"),))
    assert result.document()["differences"] == [
        {
            "scenario": "S1",
            "parameter": "P1",
            "first": {"influential": True, "lower": 0, "upper": 1, "unknown": False},
            "second": {"influential": True, "lower": 0.5, "upper": 1, "unknown": False},
        }
    ]


def test_the_intervals_of_a_campaign_are_parts_of_its_maps_range() -> None:
    narrow = row(0.2, 0.5, space_upper=0.5, n_values=11)  # the map is from 0 to 1
    assert agreement([narrow], [narrow.model_copy(update={"lower": 0.4})]).agreeing == 0
    assert agreement([narrow], [narrow.model_copy(update={"lower": 0.4})], [row(0.2)], [row(0.4)]).agreeing == 1
    assert agreement([narrow], [narrow.model_copy(update={"lower": 0.45})], [row(0.2)], [row(0.45)]).agreeing == 0


def test_maps_without_a_common_pair_have_no_share() -> None:
    assert agreement([row()], []).share is None


bounds = st.integers(0, 20).flatmap(lambda lower: st.tuples(st.just(lower / 20), st.integers(lower, 20).map(lambda i: i / 20)))


@given(st.lists(bounds.map(lambda ends: row(*ends)) | st.just(NOTHING), min_size=1, max_size=4))
def test_every_map_agrees_with_itself(rows: list[InfluenceRow]) -> None:
    named = [one.model_copy(update={"parameter": f"P{i}"}) for i, one in enumerate(rows)]
    assert agreement(named, named).share == 1
