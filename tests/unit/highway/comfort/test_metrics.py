"""The comfort metrics of a run."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drivecal.highway.comfort import metrics
from drivecal.highway.comfort.metrics import comfort_metrics
from drivecal.plugins.ports import Floats

TIME = np.arange(2000) / 100.0

signals = st.integers(1, 300).flatmap(
    lambda n: arrays(np.float64, n, elements=st.floats(-10.0, 10.0, allow_subnormal=False), fill=st.nothing())
)


def motion(lateral: Floats | None = None, longitudinal: Floats | None = None, steering: Floats | None = None) -> Floats:
    dynamics = np.zeros((TIME.size, 5))
    dynamics[:, 0] = 30.0
    for column, series in ((1, longitudinal), (2, lateral), (4, steering)):
        if series is not None:
            dynamics[:, column] = series
    return dynamics


def test_nothing_is_measured_of_a_drive_straight_on() -> None:
    assert set(comfort_metrics(motion(), np.zeros(200)).values()) == {0.0}


def test_a_constant_acceleration_is_its_own_peak() -> None:
    metrics = comfort_metrics(motion(lateral=np.full(2000, -1.5)), np.zeros(200))
    assert metrics["peak_lateral_acceleration_mps2"] == pytest.approx(1.5)
    assert metrics["peak_lateral_jerk_mps3"] == 0.0
    assert metrics["lateral_acceleration_rms_mps2"] == pytest.approx(1.5)
    assert metrics["peak_longitudinal_acceleration_mps2"] == 0.0


def test_a_jump_counts_as_if_it_took_half_a_second() -> None:
    """A new plan that moves the acceleration by 0.3 m/s^2 at once is a jerk of 0.6 m/s^3, not of 30."""
    metrics = comfort_metrics(motion(lateral=np.where(TIME < 10.0, 0.0, 0.3)), np.zeros(200))
    assert metrics["peak_lateral_jerk_mps3"] == pytest.approx(0.6)


@given(signals, st.integers(2, 60))
def test_peaks_agree_with_their_definition(signal: Floats, window: int) -> None:
    window_used = min(window, signal.size)
    averages = np.convolve(signal, np.full(window_used, 1.0 / window_used), mode="valid")
    steps = np.diff(signal) * 100.0
    reach = min(window_used, steps.size)
    jerks = np.convolve(steps, np.full(reach, 1.0 / reach), mode="valid") if reach else np.zeros(1)
    acceleration, jerk = metrics.peaks(signal, window, 100.0)
    assert acceleration == pytest.approx(np.abs(averages).max(), abs=1e-9)
    assert jerk == pytest.approx(np.abs(jerks).max(), abs=1e-9)


def test_offset_is_measured_without_its_sign() -> None:
    metrics = comfort_metrics(motion(), np.where(np.arange(200) < 100, -0.4, 0.0))
    assert metrics["offset_rms_m"] == pytest.approx(0.4 * math.sqrt(0.5))
    assert metrics["offset_peak_m"] == 0.4


@pytest.mark.parametrize(
    ("offset", "expected"),
    [
        ([0.5, 0.3, 0.1, 0.0, 0.0], 0.0),
        ([0.5, 0.2, -0.08, -0.02, 0.0], 0.08),
        ([-0.5, -0.2, 0.2, -0.15, 0.0], 0.2),
        ([0.04, -0.09, 0.02, -0.03, 0.0], 0.0),
        ([0.5, *[0.0] * 12, -0.3, -0.5], 0.0),
    ],
    ids=["comes back", "swings through", "swings twice", "never left", "leaves again, to the other side"],
)
def test_overshoot_is_what_goes_beyond_the_centre_on_the_way_back(offset: list[float], expected: float) -> None:
    for sign in (1.0, -1.0):
        metrics = comfort_metrics(motion(), sign * np.array(offset))
        assert metrics["offset_overshoot_m"] == pytest.approx(expected)


@pytest.mark.parametrize("step", [0.2, 0.1, 0.05, 0.01])
def test_an_excursion_ends_after_the_same_time_at_any_step(step: float) -> None:
    for centred, expected in ((0.7, 0.3), (1.3, 0.0)):
        offset = np.repeat([0.3, 0.0, -0.3], [round(seconds / step) for seconds in (1.0, centred, 1.0)])
        assert comfort_metrics(motion(), offset, step)["offset_overshoot_m"] == expected


@pytest.mark.parametrize(
    ("amplitude", "expected"), [(0.004, 2 * 0.5 * 60), (0.0004, 0.0)], ids=["every half period", "below the gap"]
)
def test_steering_reversals_are_counted_above_the_gap(amplitude: float, expected: float) -> None:
    steering = amplitude * np.sin(2.0 * math.pi * 0.5 * TIME)
    metrics = comfort_metrics(motion(steering=steering), np.zeros(200))
    assert metrics["steering_reversals_per_minute"] == pytest.approx(expected)


@given(signals)
def test_reversals_agree_with_a_count_of_turning_points(angle: Floats) -> None:
    """Once more by taking turning points in turn and dropping swings below the gap."""
    gap, count, direction, extreme = 1.0, 0, 0, angle[0]
    low = high = angle[0]
    for value in angle[1:]:
        if direction == 0:
            low, high = min(low, value), max(high, value)
            if high - value >= gap or value - low >= gap:
                direction, extreme = (-1 if high - value >= gap else 1), value
        elif direction * (value - extreme) > 0:
            extreme = value
        elif direction * (extreme - value) >= gap:
            count, direction, extreme = count + 1, -direction, value
    assert metrics.reversals(angle, gap) == count


def test_motion_sickness_is_the_dose_of_the_weighted_acceleration() -> None:
    """At 0.2 Hz the standard's factor is 0.992; the filter's settling takes its share of the first periods."""
    seconds = TIME.size / 100.0
    metrics = comfort_metrics(motion(lateral=np.sin(2.0 * math.pi * 0.2 * TIME)), np.zeros(200))
    assert metrics["iso2631_lateral_msdv_mps15"] == pytest.approx(0.992 * math.sqrt(0.5 * seconds), rel=0.2)
    assert metrics["iso2631_longitudinal_msdv_mps15"] == 0.0


def test_horizontal_vibration_is_the_root_of_both_squares() -> None:
    wave = np.sin(2.0 * math.pi * 1.0 * TIME)
    metrics = comfort_metrics(motion(lateral=3.0 * wave, longitudinal=4.0 * wave), np.zeros(200))
    weighted = metrics["iso2631_lateral_rms_mps2"] / 3.0
    assert metrics["iso2631_longitudinal_rms_mps2"] == pytest.approx(4.0 * weighted)
    assert metrics["iso2631_horizontal_rms_mps2"] == pytest.approx(5.0 * weighted)
    assert weighted == pytest.approx(1.011 * math.sqrt(0.5), rel=0.02)


def test_metrics_are_plain_floats_and_the_run_may_be_a_view() -> None:
    wide = np.random.default_rng(1).normal(size=(2000, 8))
    metrics = comfort_metrics(wide[:, 1:6], wide[:200, 0])
    assert {type(value) for value in metrics.values()} == {float}
    assert metrics == comfort_metrics(wide[:, 1:6].copy(), wide[:200, 0].copy())


def test_a_run_without_rows_cannot_be_measured() -> None:
    with pytest.raises(ValueError, match="empty"):
        comfort_metrics(np.zeros((0, 5)), np.zeros(3))
    with pytest.raises(ValueError, match="empty"):
        comfort_metrics(np.zeros((100, 5)), np.zeros(0))
