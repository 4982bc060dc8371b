"""Regions of equal optima, and the sets that share the best objective."""

from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.cluster.hierarchy import fcluster, linkage
from tests.support.effort import examples

from drivecal.analysis.optima import one_per_region_first, regions, to_nearest
from drivecal.campaigns.results.optima import Alternatives, beside
from drivecal.domain.parameters import Parameter, ParameterSpace


@given(seed=st.integers(0, 500), n=st.integers(2, 25))
@settings(max_examples=examples(40))
def test_regions_are_those_of_single_linkage(seed: int, n: int) -> None:
    points = np.random.default_rng(seed).random((n, 4)) ** 2
    ours = regions(points, 0.2)
    theirs = fcluster(linkage(points / 2.0, "single"), 0.2, "distance")  # root mean square over 4 axes
    assert len(set(zip(ours.tolist(), theirs.tolist(), strict=True))) == len(set(ours.tolist())) == len(set(theirs.tolist()))


def test_regions_are_numbered_in_the_order_of_their_first_points() -> None:
    points = np.array([[0.9], [0.1], [0.91], [0.5], [0.12]])
    assert regions(points, 0.05).tolist() == [0, 1, 0, 2, 1]
    assert regions(np.zeros((0, 3))).tolist() == []


def test_each_set_has_the_distance_of_the_nearest_other() -> None:
    away = to_nearest(np.array([[0.0, 0.0], [1.0, 1.0]]), np.array([[0.0, 0.2], [0.5, 0.5]]))
    assert np.allclose([np.nan if distance is None else distance for distance in away], [0.2 / np.sqrt(2), 0.5])
    assert to_nearest(np.array([[0.3]]), np.zeros((0, 1))) == [None]


def test_every_region_is_seen_before_any_is_seen_twice() -> None:
    labels = np.array([0, 0, 0, 1, 0, 2])
    assert one_per_region_first(labels, 3) == [0, 3, 5]
    assert one_per_region_first(labels, 5) == [0, 3, 5, 1, 2]
    assert one_per_region_first(labels, 50) == [0, 3, 5, 1, 2, 4]


@pytest.mark.parametrize("choices", ["abcdefghijk", "acdefghijkb"])
def test_another_choice_is_the_whole_range_away_wherever_it_is_listed(choices: str) -> None:
    space = ParameterSpace(
        (Parameter.from_step("gain", Decimal(0), Decimal(1), Decimal("0.1")), Parameter.choice("mode", choices))
    )
    grid = [(5, choices.index("a")), (5, choices.index("b")), (6, choices.index("a"))]
    sets = [space.parameter_set(row) for row in grid]
    known = beside(space, sets, sets[1:])
    assert known.regions.tolist() == [0, 1, 0]
    away = [known.shown(0, 1)[0].to_worse, *to_nearest(known.best[:1], known.best[1:2])]
    assert away == pytest.approx([0.1 / np.sqrt(2), np.sqrt(0.5)])


def test_slices_of_many_optima_are_those_of_all() -> None:
    generator = np.random.default_rng(2)
    best, worse = generator.random((9, 3)), generator.random((5, 3))
    known = Alternatives(best, worse, regions(best))
    assert len(known) == 9
    assert [*known.shown(0, 4), *known.shown(4, 8), *known.shown(8, 12)] == known.shown(0, 9)
    assert known.shown(20, 30) == []
