"""Evaluated parameter sets are ranked under any weights."""

import random
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.values import COST, by_score, present

from drivecal.analysis.solutions import EvaluatedSet
from drivecal.domain.evaluations import CellScore


def _cells(scores: dict[int, dict[str, int | None]]) -> list[CellScore]:
    return [
        CellScore(number, scenario, score, None if score is None else score + 0.25, own=True, iteration=number, individual=0)
        for number, by_scenario in scores.items()
        for scenario, score in by_scenario.items()
    ]


def _ranking(cells: list[CellScore], weights: dict[str, float]) -> list[EvaluatedSet]:
    ranking = by_score(weights)
    ranking.add(cells)
    return ranking.best_first()


def test_a_set_without_a_result_in_a_weighted_scenario_is_not_ranked() -> None:
    cells = _cells({1: {"S1": 7, "S2": None}, 2: {"S1": 1, "S2": 1}})
    assert [item.parameter_set for item in _ranking(cells, {"S1": 1, "S2": 1})] == [2]
    assert [entry.parameter_set for entry in _ranking(cells, {"S1": 1, "S2": 0})] == [1, 2]


def test_a_set_names_scores_that_are_not_its_own_but_none_of_weight_zero() -> None:
    copy = CellScore(1, "S2", 3, 3.1, own=False, iteration=0, individual=0)
    for cell, weight, reused in ((copy, 1, ("S2",)), (replace(copy, predicted=True), 0, ())):
        (only,) = _ranking([*_cells({1: {"S1": 7}}), cell], {"S1": 1, "S2": weight})
        assert only.reused == reused


def test_equal_objectives_are_ordered_by_rating_then_by_discovery() -> None:
    cells = [
        CellScore(1, "S1", 6, 5.9, True, 0, 3),
        CellScore(2, "S1", 6, 6.2, True, 4, 0),
        CellScore(3, "S1", 6, 5.9, True, 0, 1),
        CellScore(4, "S1", 5, 5.4, True, 0, 0),
    ]
    ranking = by_score({"S1": 1})
    ranking.add(cells)
    assert [item.parameter_set for item in ranking.best_first()] == [2, 3, 1, 4]
    result = present(ranking.best())
    assert (result[0].parameter_set, result[1]) == (2, 3)


def test_a_set_met_again_keeps_the_place_of_its_discovery() -> None:
    cells = [CellScore(1, "S1", 6, 6.0, True, iteration, 2) for iteration in (5, 2, 7)]
    (only,) = _ranking(cells, {"S1": 1})
    assert (only.iteration, only.individual) == (2, 2)


def test_the_sets_own_result_counts_more_than_a_copy() -> None:
    copy = CellScore(1, "S1", 7, 6.8, own=False, iteration=0, individual=0)
    own = CellScore(1, "S1", 5, 5.1, own=True, iteration=3, individual=0)
    failed = CellScore(1, "S1", None, None, own=True, iteration=0, individual=0)
    assert [item.objective for item in _ranking([copy, own], {"S1": 1})] == [5.0]
    assert [entry.objective for entry in _ranking([own, copy], {"S1": 1})] == [5.0]
    assert [element.objective for element in _ranking([failed, copy], {"S1": 1})] == [7.0]


def test_nothing_evaluated_gives_no_ranking() -> None:
    assert by_score({"S1": 1}).best_first() == []
    assert by_score({"S1": 1}).best() is None


_scores = st.lists(st.lists(st.integers(0, 7), min_size=3, max_size=3), min_size=1, max_size=30)


@given(_scores, st.lists(st.floats(0.01, 100), min_size=3, max_size=3))
def test_the_objectives_are_those_of_numpy(scores: list[list[int]], weights: list[float]) -> None:
    names = ["S1", "S2", "S3"]
    cells = _cells({number: dict(zip(names, row, strict=True)) for number, row in enumerate(scores)})
    ranked = _ranking(cells, dict(zip(names, weights, strict=True)))
    expected = np.sort(np.array(scores) @ np.array(weights) / sum(weights))[::-1]
    assert [item.objective for item in ranked] == pytest.approx(expected.tolist(), abs=1e-9)


@given(_scores, st.randoms(use_true_random=False))
def test_the_standing_does_not_depend_on_the_order_of_answers(scores: list[list[int]], shuffle: random.Random) -> None:
    cells = _cells({number % 7: dict(zip(["S1", "S2", "S3"], row, strict=True)) for number, row in enumerate(scores)})
    mixed = cells.copy()
    shuffle.shuffle(mixed)
    ranking = by_score({"S1": 1, "S2": 2, "S3": 3})
    for cell in mixed:
        ranking.add([cell])
    assert ranking.best_first() == _ranking(cells, {"S1": 1, "S2": 2, "S3": 3})


def test_lower_objectives_are_better_on_a_scale_that_is_minimised() -> None:
    cells = [
        CellScore(1, "S1", 6.5, 6.5, True, 0, 0),
        CellScore(2, "S1", 2.25, 2.25, True, 0, 1),
        CellScore(3, "S1", 2.25 + 1e-12, 2.0, False, 0, 2),
        CellScore(4, "S1", 1.0, 1.0, False, 0, 3),
    ]
    ranking = by_score({"S1": 1}, COST)
    ranking.add(cells)
    assert [item.parameter_set for item in ranking.best_first()] == [4, 3, 2, 1], "of equal ones the better rating first"
    surest, doubtful = ranking.surest(), ranking.doubtful()
    assert (present(surest).parameter_set, present(doubtful).parameter_set) == (2, 4)
