"""Trajectories as a planner gives them: rows every 0.1 s of (t, x, y, heading, curvature, speed, acceleration), shape (n, 7)."""

from collections.abc import Callable

import numpy as np
import pytest

from drivecal.highway.vehicle.model import SingleTrackModel
from drivecal.highway.vehicle.parameters import NOMINAL, SingleTrackParameters
from drivecal.plugins.ports import Floats

ROWS = 0.1
FINE = 1e-3


def _along(speed: float, curvature: Callable[[Floats], Floats], duration: float, acceleration: float = 0.0) -> Floats:
    """A path by its curvature over time, integrated finely by the trapezoidal rule."""
    time = np.arange(round(duration / FINE) + 1, dtype=np.float64) * FINE
    v: Floats = speed + acceleration * time
    kappa = curvature(time)

    def integral(rate: Floats) -> Floats:
        return np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * FINE)])

    heading = integral(v * kappa)
    x, y = integral(v * np.cos(heading)), integral(v * np.sin(heading))
    rows = np.column_stack([time, x, y, heading, kappa, v, np.full_like(time, acceleration)])
    return np.ascontiguousarray(rows[:: round(ROWS / FINE)])


def _straight(speed: float, duration: float, acceleration: float = 0.0) -> Floats:
    return _along(speed, np.zeros_like, duration, acceleration)


def _curve(speed: float, lateral_acceleration: float, duration: float, entry: float = 3.0) -> Floats:
    """Straight for a second, a clothoid-like entry of `entry` seconds, then a constant radius."""

    def curvature(time: Floats) -> Floats:
        u = np.clip((time - 1.0) / entry, 0.0, 1.0)
        return lateral_acceleration / speed**2 * u * u * (3.0 - 2.0 * u)

    return _along(speed, curvature, duration)


def _lane_change(speed: float, takes: float, duration: float, width: float = 3.75) -> Floats:
    """A quintic lane change to the left at constant speed, a second after the start."""

    def curvature(time: Floats) -> Floats:
        u = np.clip((time - 1.0) / takes, 0.0, 1.0)
        slope = width / takes * 30.0 * u**2 * (1.0 - u) ** 2 / speed
        change = width / takes**2 * 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u)
        return change / (speed**2 * np.sqrt(1.0 - slope**2))

    return _along(speed, curvature, duration)


class Drive:
    """A whole trajectory driven in steps of 0.1 s: what `follow` answered, dynamics, and errors across and along the trajectory (m)."""

    def __init__(self, trajectory: Floats, parameters: SingleTrackParameters = NOMINAL, start: Floats | None = None) -> None:
        steps = trajectory.shape[0] - 1
        model = SingleTrackModel(parameters)
        x, y, heading, speed = start if start is not None else trajectory[0, [1, 2, 3, 5]]
        model.start(float(x), float(y), float(heading), float(speed))
        self.dynamics = np.zeros((10 * steps, 5))
        self.poses = np.zeros((steps, 8))
        self.stable = True
        for k in range(steps):
            self.stable = model.follow(trajectory, k * ROWS, ROWS, self.dynamics[10 * k : 10 * k + 10]) and self.stable
            self.poses[k] = model.pose
        dx, dy = self.poses[:, 0] - trajectory[1:, 1], self.poses[:, 1] - trajectory[1:, 2]
        cosine, sine = np.cos(trajectory[1:, 3]), np.sin(trajectory[1:, 3])
        self.across = dy * cosine - dx * sine
        self.along = dx * cosine + dy * sine


@pytest.fixture(scope="session")
def straight() -> Callable[..., Floats]:
    """Straight on: (speed, duration, acceleration=0)."""
    return _straight


@pytest.fixture(scope="session")
def curve() -> Callable[..., Floats]:
    """Into a curve: (speed, lateral acceleration, duration, entry=3)."""
    return _curve


@pytest.fixture(scope="session")
def lane_change() -> Callable[..., Floats]:
    """A lane change to the left: (speed, how long it takes, duration, width=3.75)."""
    return _lane_change


@pytest.fixture(scope="session")
def drive() -> type[Drive]:
    """Drives a trajectory."""
    return Drive
