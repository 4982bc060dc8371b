"""Trajectories as a planner gives them: rows every 0.1 s of (t, x, y, heading, curvature, speed, acceleration), shape (n, 7). How a
vehicle drives them, and the speed up to which it is stable by itself."""

import math
from collections.abc import Callable

import numpy as np

from drivecal.highway.vehicle.model import SingleTrackModel
from drivecal.highway.vehicle.parameters import NOMINAL, SingleTrackParameters, understeer_gradient
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


def straight(speed: float, duration: float, acceleration: float = 0.0) -> Floats:
    """Straight on."""
    return _along(speed, np.zeros_like, duration, acceleration)


def curve(speed: float, lateral_acceleration: float, duration: float, entry: float = 3.0) -> Floats:
    """Straight for a second, a clothoid-like entry of `entry` seconds, then a constant radius."""

    def curvature(time: Floats) -> Floats:
        u = np.clip((time - 1.0) / entry, 0.0, 1.0)
        return lateral_acceleration / speed**2 * u * u * (3.0 - 2.0 * u)

    return _along(speed, curvature, duration)


def lane_change(speed: float, takes: float, duration: float, width: float = 3.75) -> Floats:
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


def critical_speed(parameters: SingleTrackParameters) -> float | None:
    """Returns the speed (m/s) above which an oversteering vehicle is unstable without a controller, sqrt(-wheelbase / K_us).

    Returns None for an understeering or neutral vehicle, which is stable at every speed. At the critical speed the determinant of the yaw
    and side-slip dynamics changes its sign (Rajamani, Section 3.3; Mitschke and Wallentowitz, Dynamik der Kraftfahrzeuge, Chapter 20).
    """
    gradient = understeer_gradient(parameters)
    return math.sqrt(-parameters.wheelbase / gradient) if gradient < 0.0 else None
