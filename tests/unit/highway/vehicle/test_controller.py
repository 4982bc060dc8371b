"""The tracking controller: designed for the nominal vehicle, kept for every other one of Table 8's box."""

import itertools

import numpy as np
import pytest
from tests.unit.highway.vehicle.driving import Drive, critical_speed, curve, lane_change, straight

from drivecal.highway.vehicle.parameters import NOMINAL, TABLE_8, SingleTrackParameters, understeer_gradient

SPEEDS = (10.0, 20.0, 30.0, 40.0)
CORNERS = [SingleTrackParameters(*corner) for corner in itertools.product(*((p.minimum, p.maximum) for p in TABLE_8))]


@pytest.mark.parametrize("speed", SPEEDS)
def test_every_stable_corner_changes_lanes(speed: float) -> None:
    trajectory = lane_change(speed, 5.0, 20.0)
    for corner in CORNERS:
        if speed < (critical_speed(corner) or np.inf):  # stable without the controller
            run = Drive(trajectory, corner)
            assert run.stable, corner
            assert np.abs(run.across).max() < 1.0, corner
            assert np.abs(run.across[-20:]).max() < 0.15, corner


@pytest.mark.parametrize("speed", SPEEDS)
@pytest.mark.parametrize(("takes", "within"), [(3.0, 0.07), (5.0, 0.03)])
def test_a_lane_change_is_kept_within_centimetres(speed: float, takes: float, within: float) -> None:
    trajectory = lane_change(speed, takes, 16.0)
    run = Drive(trajectory)
    assert run.stable
    assert np.abs(run.across).max() < within
    assert np.abs(run.along).max() < 0.02
    assert np.abs(run.across[-10:]).max() < 0.005
    planned = np.abs(trajectory[:, 4] * speed**2).max()
    assert np.abs(run.dynamics[:, 2]).max() == pytest.approx(planned, rel=0.1)


@pytest.mark.parametrize("speed", SPEEDS)
def test_a_constant_radius_is_kept_without_ripple(speed: float) -> None:
    run = Drive(curve(speed, 2.0, 25.0))
    assert run.stable
    assert np.abs(run.across).max() < 0.05
    assert np.abs(run.across[-50:]).max() < 0.01
    settled = run.dynamics[-500:]
    assert settled[:, 2] == pytest.approx(2.0, abs=0.005)
    assert np.ptp(settled[:, 4]) < 1e-5
    assert settled[-1, 4] == pytest.approx((NOMINAL.wheelbase / speed**2 + understeer_gradient(NOMINAL)) * 2.0, rel=2e-3)


@pytest.mark.parametrize("speed", SPEEDS)
def test_an_initial_offset_decays_without_overshoot(speed: float) -> None:
    run = Drive(straight(speed, 15.0), start=np.array([0.0, 0.5, 0.0, speed]))
    assert run.across.min() > -0.03
    assert np.abs(run.across[-10:]).max() < 0.005


def test_a_planned_acceleration_is_followed() -> None:
    run = Drive(straight(20.0, 8.0, acceleration=1.5))
    assert np.abs(run.along).max() < 0.2
    assert run.dynamics[-1, 0] == pytest.approx(32.0, abs=0.05)
    assert run.dynamics[-1, 1] == pytest.approx(1.5, abs=0.01)


def test_a_position_error_is_made_up_for_without_overshoot() -> None:
    run = Drive(straight(30.0, 25.0), start=np.array([-2.0, 0.0, 0.0, 30.0]))
    assert run.along[0] < -1.9
    assert run.along.max() < 0.05
    assert abs(run.along[-1]) < 0.01


def test_braking_to_a_standstill_ends_at_rest() -> None:
    trajectory = straight(12.0, 10.0)
    time = trajectory[:, 0]
    speed = np.maximum(12.0 - 2.0 * time, 0.0)
    trajectory[:, 1] = np.where(time < 6.0, 12.0 * time - time**2, 36.0)
    trajectory[:, 5] = speed
    trajectory[:, 6] = np.where(time < 6.0, -2.0, 0.0)
    run = Drive(trajectory)
    assert run.stable
    assert run.dynamics[:, 0].min() >= 0.0
    assert run.dynamics[-1, 0] < 0.05
    assert run.poses[-1, 0] == pytest.approx(36.0, abs=0.3)
    assert np.abs(run.dynamics[:, 2:]).max() == 0.0


def test_a_small_jump_at_a_replanning_instant_is_smoothed() -> None:
    """5 cm to the side and 0.2 m/s faster: half a second later the acceleration has moved by less than a passenger notices."""
    trajectory = straight(30.0, 10.0)
    trajectory[30:, 2] += 0.05
    trajectory[30:, 5] += 0.2
    run = Drive(trajectory)
    lateral, longitudinal = run.dynamics[:, 2], run.dynamics[:, 1]
    assert np.abs(np.diff(lateral)).max() < 0.03
    assert np.abs(np.diff(longitudinal)).max() < 0.03
    assert np.abs(lateral).max() < 0.15
