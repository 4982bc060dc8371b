"""The plant and its trackers of commands: steering angle, curvature, path."""

import math

import numpy as np
import pytest

from drivecal.highway.vehicle import kernels, single_track
from drivecal.highway.vehicle.model import SingleTrackModel
from drivecal.highway.vehicle.parameters import NOMINAL, understeer_gradient

NO_PATH = np.zeros((2, 7))


def vehicle(speed: float = 25.0) -> SingleTrackModel:
    model = SingleTrackModel(NOMINAL)
    model.start(0.0, 0.0, 0.0, speed)
    return model


def drive(model: SingleTrackModel, dynamics: np.ndarray, acceleration: float = 0.0, **lateral: float) -> bool:
    """Drives by a `steering` angle or a `curvature`."""
    ((by, value),) = lateral.items()
    kind = {"steering": kernels.STEERING, "curvature": kernels.CURVATURE}[by]
    status: int = kernels.drive(*model.arrays, kind, value, acceleration, NO_PATH, 0.0, len(dynamics), dynamics)
    return status == kernels.FOLLOWED


def arc(radius: float, speed: float, seconds: float) -> np.ndarray:
    """Returns a left curve that starts at the origin, as a trajectory."""
    times = np.arange(0.0, seconds + 0.05, 0.05)
    angles = speed * times / radius
    columns = [times, radius * np.sin(angles), radius * (1 - np.cos(angles)), angles]
    return np.column_stack([*columns, np.full(len(times), 1 / radius), np.full(len(times), speed), np.zeros(len(times))])


def test_a_steering_angle_gives_its_steady_curvature() -> None:
    model = vehicle()
    dynamics = np.zeros((500, 5))
    assert drive(model, dynamics, steering=0.01)
    curvature = 0.01 / (NOMINAL.wheelbase + understeer_gradient(NOMINAL) * 25.0**2)
    assert model.pose[5] / model.pose[3] == pytest.approx(curvature, rel=1e-3)
    assert dynamics[-1, 4] == pytest.approx(0.01, rel=1e-6)
    assert dynamics[-1, 3] == model.pose[5]


def test_an_acceleration_is_reached_after_a_lag_and_cut_off() -> None:
    for wanted, reached in ((2.0, 2.0), (-20.0, -9.0), (20.0, 4.0)):
        model = vehicle()
        dynamics = np.zeros((100, 5))
        assert drive(model, dynamics, wanted, steering=0.0)
        assert dynamics[-1, 1] == pytest.approx(reached, rel=0.01)
        assert dynamics[14, 1] == pytest.approx(reached * (1 - math.exp(-1)), rel=0.02)


def test_brakes_hold_a_standing_vehicle() -> None:
    model = vehicle(2.0)
    assert drive(model, np.zeros((300, 5)), -5.0, steering=0.0)
    assert model.pose[3] == pytest.approx(0, abs=1e-9)
    assert model.pose[0] == pytest.approx(0.7, abs=0.3)


@pytest.mark.parametrize(("speed", "curvature"), [(25.0, 0.001), (25.0, -0.004), (3.0, 0.05), (1.0, -0.05)])
def test_a_curvature_is_reached_from_its_command(speed: float, curvature: float) -> None:
    model = vehicle(speed)
    assert drive(model, np.zeros((300, 5)), curvature=curvature)
    assert model.pose[5] / model.pose[3] == pytest.approx(curvature, rel=0.05 if speed < 5 else 0.02)


@pytest.mark.parametrize(("radius", "speed"), [(400.0, 25.0), (12.0, 2.0)])
def test_a_path_is_kept_whatever_the_acceleration(radius: float, speed: float) -> None:
    model = vehicle(speed)
    path = arc(radius, speed, 12.0)
    for tenth in range(100):
        rows = np.zeros((10, 5))
        assert kernels.drive(*model.arrays, kernels.PATH, 0.0, 0.0, path, 0.1 * tenth, 10, rows) == kernels.FOLLOWED
    x, y = model.pose[:2]
    assert abs(math.hypot(x, y - radius) - radius) < 0.1


def test_an_unstable_vehicle_keeps_its_last_valid_state() -> None:
    model = vehicle(40.0)
    dynamics = np.full((300, 5), np.nan)
    assert not drive(model, dynamics, steering=0.4)
    assert np.isfinite(dynamics).all()
    assert np.abs(dynamics[:, 2]).max() <= single_track.ADHESION_LIMIT
    assert not drive(vehicle(), np.zeros((10, 5)), curvature=float("nan"))


def test_steps_may_be_cut_anywhere() -> None:
    whole, parts = vehicle(), vehicle()
    assert drive(whole, np.zeros((100, 5)), 1.0, curvature=0.002)
    for _ in range(10):
        assert drive(parts, np.zeros((10, 5)), 1.0, curvature=0.002)
    assert whole.pose.tolist() == parts.pose.tolist()
