"""The reference comfort scale."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivecal.highway.comfort.metrics import comfort_metrics
from drivecal.highway.comfort.reference import LANE_KEEPING, MOTION, REFERENCE, Criterion, Manoeuvre, criteria, rate
from drivecal.plugins import registry

COMFORTABLE = {criterion.metric: criterion.comfortable for criterion in MOTION + LANE_KEEPING}

measurements = st.fixed_dictionaries(
    {c.metric: st.floats(0.0, 2.0 * c.unacceptable, allow_nan=False) for c in MOTION + LANE_KEEPING}
)


def test_a_drive_that_is_comfortable_in_everything_is_rated_seven() -> None:
    assert rate(Manoeuvre.LANE_KEEPING, COMFORTABLE).rating == 7.0
    assert rate(Manoeuvre.LANE_KEEPING, dict.fromkeys(COMFORTABLE, 0.0)).score == 7


@pytest.mark.parametrize("criterion", MOTION + LANE_KEEPING, ids=lambda criterion: criterion.metric)
def test_one_unacceptable_metric_is_enough_for_zero(criterion: Criterion) -> None:
    rating = rate(Manoeuvre.LANE_KEEPING, COMFORTABLE | {criterion.metric: criterion.unacceptable})
    assert (rating.rating, rating.score) == (0.0, 0)


def test_a_rating_worked_out_by_hand() -> None:
    # z = (1.95 - 0.9) / 2.1 = 0.5 and (1.55 - 0.6) / 1.9 = 0.5: 7 (1 - (2 / 16)^(1/4)) = 7 (1 - 0.594604) = 2.837775
    metrics = COMFORTABLE | {"peak_lateral_acceleration_mps2": 1.95, "peak_longitudinal_jerk_mps3": 1.55}
    rating = rate(Manoeuvre.LANE_CHANGE, metrics)
    assert rating.rating == pytest.approx(2.837775, abs=1e-6)
    assert rating.score == 3


@pytest.mark.parametrize(
    ("share", "score"), [(0.5 / 7 - 1e-9, 7), (0.5 / 7 + 1e-9, 6), (6.5 / 7 - 1e-9, 1), (6.5 / 7 + 1e-9, 0)]
)
def test_the_score_is_the_rating_rounded_half_up(share: float, score: int) -> None:
    metrics = COMFORTABLE | {"peak_lateral_acceleration_mps2": 0.9 + 2.1 * share}
    assert rate(Manoeuvre.LANE_CHANGE, metrics).score == score


def test_offset_and_steering_count_in_lane_keeping_only() -> None:
    hunting = COMFORTABLE | {"offset_rms_m": 1.0, "offset_overshoot_m": 1.0, "steering_reversals_per_minute": 100.0}
    assert rate(Manoeuvre.LANE_CHANGE, hunting).score == 7
    assert rate(Manoeuvre.SPEED_CHANGE, hunting).score == 7
    assert rate(Manoeuvre.LANE_KEEPING, hunting).score == 0


@given(measurements, st.sampled_from(list(Manoeuvre)), st.sampled_from(MOTION + LANE_KEEPING), st.floats(1.0, 2.0))
def test_more_of_anything_never_rates_better(
    metrics: dict[str, float], manoeuvre: Manoeuvre, criterion: Criterion, factor: float
) -> None:
    rating = rate(manoeuvre, metrics)
    worse = rate(manoeuvre, metrics | {criterion.metric: metrics[criterion.metric] * factor})
    assert 0.0 <= worse.rating <= rating.rating <= 7.0
    assert abs(rating.score - rating.rating) <= 0.5


def test_every_criterion_is_measured() -> None:
    measured = comfort_metrics(np.zeros((100, 5)), np.zeros(10))
    for manoeuvre in Manoeuvre:
        assert {criterion.metric for criterion in criteria(manoeuvre)} <= set(measured)


def test_a_metric_that_is_missing_or_not_finite_is_no_rating() -> None:
    with pytest.raises(KeyError):
        rate(Manoeuvre.LANE_CHANGE, {})
    with pytest.raises(ValueError, match="peak_lateral_jerk_mps3"):
        rate(Manoeuvre.LANE_CHANGE, COMFORTABLE | {"peak_lateral_jerk_mps3": math.nan})


def test_the_evaluator_is_found_by_its_entry_point_and_rates_on_this_scale() -> None:
    evaluator = registry.evaluator("reference")
    assert evaluator is REFERENCE
    metrics = COMFORTABLE | {"peak_lateral_acceleration_mps2": 2.0}
    assert evaluator.rate(Manoeuvre.LANE_CHANGE, metrics) == rate(Manoeuvre.LANE_CHANGE, metrics)
