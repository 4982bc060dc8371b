"""Thresholds of influence on s_rel, or on mu and sigma, and the tolerance of `auto`."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from drivecal.contracts.specification import SeparateThresholds
from drivecal.sensitivity.designs import Floats
from drivecal.sensitivity.thresholds import (
    Threshold,
    automatic,
    caveats,
    measures,
    miss_probability,
    tolerance_text,
    tolerated_changes,
    verdict,
)


def effects_of_changes(points: list[int], n: int, step: float) -> Floats:
    """Returns effects of `n` equal steps: the first steps change the score by `points`, alternately up and down."""
    changes = np.zeros(n)
    changes[: len(points)] = [change * (-1) ** number for number, change in enumerate(points)]
    return changes / 7 / step


def is_influential(effects: Floats, step: float, threshold: Threshold = "auto") -> bool:
    return verdict(measures(effects), np.full(len(effects), step), threshold).influential


def test_a_number_is_a_threshold_on_the_relative_sensitivity_and_reaching_it_counts() -> None:
    effects = np.array([0.3, 0.3, 0.3])
    assert is_influential(effects, 0.1, measures(effects).s_rel)
    assert not is_influential(effects, 0.1, 0.31)


@pytest.mark.parametrize(
    ("effects", "influential"),
    [([0.2, 0.2], True), ([-0.2, -0.2], True), ([0.5, -0.5], True), ([0.09, 0.09], False), ([0.2, -0.2], False)],
)
def test_separate_thresholds_look_at_the_magnitude_of_mu_and_at_sigma(effects: list[float], influential: bool) -> None:
    assert is_influential(np.array(effects), 0.1, SeparateThresholds(mu=0.1, sigma=0.4)) == influential


def test_the_threshold_that_was_applied_is_reported() -> None:
    apart = SeparateThresholds(mu=0.1, sigma=0.2)
    steps, result = np.full(3, 0.5), measures(np.array([0.1, 0.2, 0.3]))
    assert verdict(result, steps, apart).threshold == apart
    assert verdict(result, steps, 0.02).threshold == 0.02
    assert verdict(result, steps, "auto").threshold == automatic(steps)


@pytest.mark.parametrize("threshold", ["auto", 0.02, SeparateThresholds(mu=0.1, sigma=0.1)])
def test_where_nothing_is_known_influence_is_assumed(threshold: Threshold) -> None:
    result = verdict(measures(np.array([np.nan, 0.0])), np.array([0.1]), threshold)
    assert result.influential
    assert result.threshold is None


@given(st.integers(2, 100_000))
def test_tolerated_changes_are_a_binomial_quantile(n: int) -> None:
    assert tolerated_changes(n) == stats.binom.ppf(0.95, n, 0.01)


@pytest.mark.parametrize(("samples", "probability"), [(16, 0.5147), (20, 0.3917), (100, 0.0078)])
def test_auto_misses_a_tenth_of_changed_steps_as_often_as_it_says(samples: int, probability: float) -> None:
    assert miss_probability(samples, 0.1) == pytest.approx(probability, abs=0.001)
    assert f"{100 * probability:.0f} %" in tolerance_text(samples)
    named = [int(number) for number in re.findall(r"with (\d+) samples", tolerance_text(samples))]
    assert all(miss_probability(more, 0.1) <= probability / 2 < miss_probability(more - 1, 0.1) for more in named)
    assert len(named) == (probability > 0.01)


@given(st.integers(2, 2_000), st.floats(0, 1))
def test_the_probability_of_a_miss_is_binomial(n: int, rate: float) -> None:
    assert miss_probability(n, rate) == pytest.approx(stats.binom.cdf(stats.binom.ppf(0.95, n, 0.01), n, rate))


def test_readers_of_a_map_hear_of_the_misses_of_auto_alone() -> None:
    settings = {"design": "lines", "intervals": 10, "samples": 20, "threshold": 0.02, "seed": 1}
    assert caveats(settings) == []
    assert caveats(settings | {"threshold": {"mu": 0.1, "sigma": 0.1}}) == []
    assert caveats(settings | {"threshold": "auto"}) == [tolerance_text(20)]


def test_readers_of_a_map_hear_of_intervals_that_took_no_runs_if_there_may_be_any() -> None:
    settings = {"design": "lines", "intervals": 10, "samples": 20, "threshold": 0.02, "seed": 1, "sequential": True}
    assert len(caveats(settings)) == 1
    assert caveats(settings | {"design": "paper"}) == caveats(settings | {"sequential": False}) == []


@given(st.integers(2, 400), st.floats(0.001, 1))
def test_with_equal_steps_auto_tolerates_exactly_so_many_changes_of_one_point(n: int, step: float) -> None:
    tolerated = tolerated_changes(n)
    assert not is_influential(effects_of_changes([1] * tolerated, n, step), step)
    assert is_influential(effects_of_changes([1] * (tolerated + 1), n, step), step)


@given(st.lists(st.floats(0.01, 1), min_size=2, max_size=40).map(np.array), st.floats(0.01, 1))
def test_the_automatic_threshold_scales_with_the_box_not_the_direction(steps: Floats, width: float) -> None:
    assert automatic(width * steps) == pytest.approx(automatic(steps) / width)
    assert automatic(-steps) == automatic(steps)
