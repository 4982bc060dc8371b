"""Evaluated parameter sets are ranked under any weights."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivecal.campaigns.solutions import Scored, alternatives, rank


def _cells(scores: dict[int, dict[str, int | None]]) -> list[Scored]:
    return [
        Scored(number, scenario, score, None if score is None else score + 0.25, iteration=number, individual=0)
        for number, by_scenario in scores.items()
        for scenario, score in by_scenario.items()
    ]


def test_the_objective_is_the_weighted_sum_with_weights_normalised_to_one() -> None:
    (only,) = rank(_cells({1: {"S1": 6, "S2": 3}}), {"S1": 2, "S2": 1})
    assert only.objective == pytest.approx(5.0)
    assert only.scores == {"S1": 6, "S2": 3}


def test_a_set_without_a_result_in_a_weighted_scenario_is_not_ranked() -> None:
    cells = _cells({1: {"S1": 7, "S2": None}, 2: {"S1": 1, "S2": 1}})
    assert [one.parameter_set for one in rank(cells, {"S1": 1, "S2": 1})] == [2]
    assert [one.parameter_set for one in rank(cells, {"S1": 1, "S2": 0})] == [1, 2]


def test_equal_objectives_are_ordered_by_rating_then_by_discovery() -> None:
    cells = [
        Scored(1, "S1", 6, 5.9, 0, 3),
        Scored(2, "S1", 6, 6.2, 4, 0),
        Scored(3, "S1", 6, 5.9, 0, 1),
        Scored(4, "S1", 5, 5.4, 0, 0),
    ]
    ranked = rank(cells, {"S1": 1})
    assert [one.parameter_set for one in ranked] == [2, 3, 1, 4]
    assert alternatives(ranked) == 3


def test_a_set_met_again_keeps_the_place_of_its_discovery() -> None:
    cells = [Scored(1, "S1", 6, 6.0, 5, 2), Scored(1, "S1", 6, 6.0, 2, 9), Scored(1, "S1", 6, 6.0, 7, 0)]
    (only,) = rank(cells, {"S1": 1})
    assert (only.iteration, only.individual) == (2, 9)


def test_nothing_evaluated_gives_no_ranking() -> None:
    assert rank([], {"S1": 1}) == []
    assert alternatives([]) == 0


@given(
    st.lists(st.lists(st.integers(0, 7), min_size=3, max_size=3), min_size=1, max_size=30),
    st.lists(st.floats(0.01, 100), min_size=3, max_size=3),
)
def test_the_order_is_that_of_numpy(scores: list[list[int]], weights: list[float]) -> None:
    names = ["S1", "S2", "S3"]
    cells = _cells({number: dict(zip(names, row, strict=True)) for number, row in enumerate(scores)})
    ranked = rank(cells, dict(zip(names, weights, strict=True)))
    expected = np.sort(np.array(scores) @ np.array(weights) / sum(weights))[::-1]
    assert [one.objective for one in ranked] == pytest.approx(expected.tolist(), abs=1e-9)
