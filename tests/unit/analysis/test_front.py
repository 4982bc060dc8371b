"""Fronts: against pymoo's sorting and by what their definitions say."""

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from pymoo.util.nds.non_dominated_sorting import NonDominatedSorting
from tests.support.tree import PROJECT

from drivecal.analysis.front import by_weights, extremes, knee, non_dominated, scaled, winning_weights
from drivecal.plugins.ports import Floats


def points(*columns: int, least: int = 1) -> st.SearchStrategy[Floats]:
    """Points with many equal values, and points without."""
    shapes = st.tuples(st.integers(least, 25), st.sampled_from(columns))
    coarse, fine = st.integers(0, 5).map(float), st.floats(0, 1, width=32)
    return shapes.flatmap(
        lambda shape: arrays.arrays(np.float64, shape, elements=st.sampled_from([coarse, fine]).flatmap(lambda e: e))
    )


@given(points(1, 2, 3, 4))
def test_the_same_points_are_non_dominated_as_pymoo_says(front: Floats) -> None:
    expected = NonDominatedSorting().do(-front, only_non_dominated_front=True)
    assert set(np.flatnonzero(non_dominated(front))) == set(expected)


@given(points(2, 3), st.data())
def test_only_the_least_violating_points_are_kept(front: Floats, data: st.DataObject) -> None:
    violations = np.array(data.draw(st.lists(st.sampled_from([0.0, 0.0, 0.5, 1.0]), min_size=len(front), max_size=len(front))))
    kept, least = non_dominated(front, violations), violations == violations.min()
    assert not (kept & ~least).any()
    assert np.array_equal(kept[least], non_dominated(front[least]))


def test_no_points_are_no_front() -> None:
    assert non_dominated(np.empty((0, 2))).shape == (0,)


@pytest.mark.parametrize(
    "case", json.loads((PROJECT / "tests/unit/web/page/front/winners.json").read_text()), ids=lambda case: case["about"]
)
def test_the_server_names_the_winner_that_the_page_names(case: dict[str, Any]) -> None:
    signs = np.array([-1.0 if goal["direction"] == "minimise" else 1.0 for goal in case["goals"]])
    order, _ = by_weights(signs * np.array(case["objectives"]), np.array(case["weights"]))
    assert order[0] == case["winner"]


def test_winning_weights_of_many_objectives_are_not_computed() -> None:
    assert winning_weights(np.eye(4)) is None


def test_the_knee_lies_farthest_beyond_the_line_through_the_extremes() -> None:
    front = np.array([[0.0, 10.0], [6.0, 9.0], [9.0, 3.0], [10.0, 0.0]])
    assert knee(front) == 1
    assert extremes(front) == [3, 0]


@pytest.mark.parametrize(
    "front",
    [
        [[1.0, 2.0]],
        [[0.0, 1.0], [1.0, 0.0]],
        [[0.0, 1.0], [0.4, 0.4], [1.0, 0.0]],
        [[0.0, 1.0, 0.0], [0.5, 0.5, 0.0], [1.0, 0.0, 0.0]],
    ],
    ids=["point", "two", "concave", "a constant objective"],
)
def test_a_front_that_nowhere_bulges_has_no_knee(front: list[list[float]]) -> None:
    assert knee(np.array(front)) is None


@given(points(2, 3, least=2), st.integers(0, 2**32))
def test_a_point_wins_inside_of_its_region_and_nowhere_else(candidates: Floats, seed: int) -> None:
    front = np.unique(candidates[non_dominated(candidates)], axis=0)
    regions = winning_weights(front)
    assert regions is not None
    assert sum(region.share for region in regions) == pytest.approx(1.0, abs=1e-6)
    weights = np.random.default_rng(seed).dirichlet(np.ones(front.shape[1]), 20)
    worths = weights @ scaled(front).T
    for place, region in enumerate(regions):
        corners = np.array(region.corners).reshape(-1, front.shape[1])
        if len(corners):
            assert corners.sum(axis=1) == pytest.approx(np.ones(len(corners)))
            middle = corners.mean(axis=0) @ scaled(front).T
            assert middle[place] >= middle.max() - 1e-6
        winning = (worths.argmax(axis=1) == place) & (
            np.ptp(np.sort(worths, axis=1)[:, -2:], axis=1) > 1e-6 if len(front) > 1 else True
        )
        assert not winning.any() or region.share > 0
