"""Regions of equal optima, and the sets that share the best objective."""

from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.cluster.hierarchy import fcluster, linkage
from tests.support.effort import examples

from drivecal.analysis.optima import one_per_region_first, regions
from drivecal.campaigns.results.front import regions_of
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


def test_every_region_is_seen_before_any_is_seen_twice() -> None:
    labels = [0, 0, 0, 1, 0, 2]
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
    assert regions_of(space, sets) == [0, 1, 0]
