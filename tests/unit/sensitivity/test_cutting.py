"""Cuts of influential intervals, and their reversal."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivecal.sensitivity.scenario import Region, cut, interval_edges, most_confirmations

flags = st.lists(st.booleans(), min_size=1, max_size=20)


def cut_values(influential: list[bool], edges: list[int]) -> set[int]:
    result: set[int] = set()
    for region in cut(0, influential):
        lower, upper = region.bounds(np.array(edges))
        result |= set(range(lower, upper + 1))
    return result


@pytest.mark.parametrize(
    ("influential", "regions"),
    [
        ("#", []),
        ("..", [("whole", 2)]),
        ("..#.", [("below", 2), ("above", 1)]),
        ("#..#", []),
        (".#..#", [("below", 1)]),
        ("##..", [("above", 2)]),
    ],
)
def test_intervals_are_cut_up_to_the_first_influential_one(influential: str, regions: list[tuple[str, int]]) -> None:
    result = cut(3, [mark == "#" for mark in influential])
    assert [(region.side, region.intervals) for region in result] == regions
    assert all(region.column == 3 for region in result)


@given(flags, st.data())
def test_more_influence_never_cuts_more(influential: list[bool], data: st.DataObject) -> None:
    edges = [3 * number for number in range(len(influential) + 1)]
    more = [item or data.draw(st.booleans()) for item in influential]
    assert cut_values(more, edges) <= cut_values(influential, edges)


@given(flags)
def test_no_value_of_an_influential_interval_is_cut(influential: list[bool]) -> None:
    edges = [3 * number for number in range(len(influential) + 1)]
    kept = {value for number, one in enumerate(influential) if one for value in range(edges[number], edges[number + 1] + 1)}
    assert not kept & cut_values(influential, edges)


def test_half_of_a_refuted_region_is_given_back_until_none_is_left() -> None:
    region, sizes = Region(1, "above", 9), []
    left: Region | None = region
    while left is not None:
        sizes.append(left.intervals)
        assert (left.column, left.side) == (1, "above")
        left = left.given_back()
    assert sizes == [9, 4, 2, 1]
    assert Region(0, "whole", 9).given_back() is None


@pytest.mark.parametrize("intervals", range(1, 9))
def test_the_announced_confirmations_are_the_most_there_can_be(intervals: int) -> None:
    def rounds(region: Region | None) -> int:
        return 0 if region is None else 1 + rounds(region.given_back())

    counts = [
        sum(map(rounds, cut(0, list(marks)))) + any(marks)  # after the global analysis the whole range
        for marks in product([False, True], repeat=intervals)
    ]
    assert most_confirmations(intervals) == max(counts)


def test_where_intervals_are_as_fine_as_the_grid_a_region_can_be_a_single_value() -> None:
    edges = interval_edges(5, 4)
    assert cut(0, [False, True, True, True])[0].bounds(edges) == (0, 0)
