"""Vectors of eight numbers against numpy, bit for bit."""

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numba import njit

from drivecal.highway.planner.lanes import LANES, absolute, bits, floor, larger, load, lowest_bit, smaller, spread, store, where

eight = st.lists(st.floats(-1e6, 1e6), min_size=2 * LANES, max_size=2 * LANES).map(np.array)


@njit(error_model="numpy")  # type: ignore[untyped-decorator]  # numba ships no types
def computed(numbers: Any, factor: float, results: Any) -> tuple[int, int]:
    x, y = load(numbers, 0), load(numbers, LANES)
    total = spread(0.0)
    for _ in range(3):
        total = total + factor * x - y / 3.0
        total = larger(total, 0.0)
    store(results, 0, where(total > 1.0, floor(total), smaller(absolute(x), 2.0)))
    store(results, LANES, x * y / (1.0 + y * y))
    return bits((x < y) | (total <= 0.0)), bits(x > y)


@given(eight, st.floats(-10, 10))
def test_each_lane_has_the_bits_of_single_numbers(numbers: np.ndarray, factor: float) -> None:
    results = np.empty(2 * LANES)
    below, above = computed(numbers, factor, results)
    x, y = numbers[:LANES], numbers[LANES:]
    total = np.zeros(LANES)
    for _ in range(3):
        total = np.maximum(total + factor * x - y / 3.0, 0.0)
    assert np.array_equal(results[:LANES], np.where(total > 1.0, np.floor(total), np.minimum(np.abs(x), 2.0)))
    assert np.array_equal(results[LANES:], x * y / (1.0 + y * y))
    assert [bool(below >> lane & 1) for lane in range(LANES)] == ((x < y) | (total <= 0.0)).tolist()
    assert [bool(above >> lane & 1) for lane in range(LANES)] == (x > y).tolist()


@njit  # type: ignore[untyped-decorator]  # as above
def places(number: int) -> list[int]:
    walked = []
    while number:
        walked.append(lowest_bit(number))
        number &= number - 1
    return walked


@given(st.sets(st.integers(0, 62), min_size=1))
def test_bits_are_walked_from_the_lowest(numbers: set[int]) -> None:
    assert places(sum(1 << number for number in numbers)) == sorted(numbers)
