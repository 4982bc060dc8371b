"""Trajectories for the vehicle's tracker from points of a user's controller."""

from collections.abc import Mapping, Sequence
from math import ceil
from typing import Any

import numpy as np

from drivecal.domain.roads import Floats
from drivecal.highway.drive.control import Command, CommandControl, Control, RunView
from drivecal.highway.drive.controllers import Checked, ControllerError
from drivecal.highway.drive.geometry import NAMES
from drivecal.highway.drive.road import HighwayRoad
from drivecal.highway.vehicle.kernels import TRAJECTORY

STEP = 0.05
"""Seconds between rows of a trajectory."""
LONGEST = 10.0
"""Seconds of a trajectory that are looked at, unless more are needed."""
MOST_POINTS = 10_000
SLOWEST = 0.5
"""Speed (m/s) below which a trajectory has the road's heading."""
TRACK = NAMES.index("lane")


class ControllerTrajectories(Control):
    """The trajectories of a user's controller."""

    by = TRAJECTORY

    def __init__(self, controller: Checked, road: HighwayRoad, period: float) -> None:
        """`period`: seconds that each trajectory must cover."""
        self._controller, self._road, self.period = controller, road, period

    def begin(self, parameters: Mapping[str, Any]) -> None:
        self._controller.begin(parameters)

    def act(self, view: RunView) -> Command:
        signals = view.signals()
        points = checked_points(self._controller.step(signals)[0], self.period, signals[0])
        return trajectory_of(self._road, int(signals[TRACK]), points, self.period), 0.0, 0.0


def control_of(controller: Checked, output: Sequence[str], road: HighwayRoad, period: float) -> Control:
    """Returns a user's controller as what drives the vehicle. `output`: names of its commands; `period`: seconds between them."""
    if list(output) == ["trajectory"]:
        return ControllerTrajectories(controller, road, period)
    return CommandControl(controller, output, period)


def checked_points(answer: Any, needed: float, time: float) -> Floats:
    """Returns the points of a trajectory, shape (n, 3). Raises ControllerError."""
    try:
        points = np.asarray(answer, np.float64)
    except (TypeError, ValueError, OverflowError):
        points = np.zeros(0)
    fault = ""
    if points.ndim != 2 or points.shape[1:] != (3,) or not 2 <= len(points) <= MOST_POINTS:
        fault = f"is not a list of 2 to {MOST_POINTS:,} points of time, position and offset"
    elif not np.all(np.isfinite(points)) or np.max(np.abs(points)) > 1e7:
        fault = "has a number that is not finite, or beyond 1e7"
    elif np.any(np.diff(points[:, 0]) <= 1e-6):
        fault = "has times that do not increase"
    elif points[0, 0] > 1e-9 or points[-1, 0] < needed - 1e-9:
        fault = f"is from {points[0, 0]:g} to {points[-1, 0]:g} s; it must be from 0 to {needed:g} s at least"
    if fault:
        raise ControllerError(f"the controller's trajectory at {time:g} s {fault}")
    return points


def trajectory_of(road: HighwayRoad, track: int, points: Floats, needed: float = 0.0) -> Floats:
    """Returns the trajectory through points (n, 3) of time, position and offset from a track's centre, joined by cubic curves.

    It covers `needed` seconds at least. A last row beyond the last point goes straight on.
    """
    times = np.arange(max(ceil(min(points[-1, 0], max(needed, LONGEST)) / STEP - 1e-9), 1) + 1) * STEP
    s, offset = _joined(points[:, 0], points[:, 1:], times).T
    line = road.line
    centres, slopes = road.lanes[:, max(track, 0), 0], road.lanes[:, max(track, 0), 3]
    known = np.flatnonzero(~np.isnan(centres))
    centre, slope = np.zeros(len(s)), np.zeros(len(s))
    if len(known):
        centre = np.interp(s, line[known, 0], centres[known])
        slope = np.interp(s, line[known, 0], slopes[known], left=0.0, right=0.0)
    x, y, heading, curvature = (np.interp(s, line[:, 0], line[:, column]) for column in range(1, 5))
    beyond = s - np.clip(s, line[0, 0], line[-1, 0])
    curvature[beyond != 0.0] = 0.0
    d = centre + offset
    x += beyond * np.cos(heading) - d * np.sin(heading)
    y += beyond * np.sin(heading) + d * np.cos(heading)
    stretch = np.maximum(1.0 - curvature * d, 0.1)
    aside = np.gradient(offset, STEP)
    along, across = np.gradient(s, STEP) * stretch, aside + slope * np.gradient(s, STEP)
    speed = np.hypot(along, across)
    is_moving = speed > SLOWEST
    # The slope is that of several metres, and the curvature the line's: corners of the network's polylines are no curves.
    course = heading + np.where(is_moving, np.arctan2(across, along), 0.0)
    bend = curvature / stretch + np.where(is_moving, np.gradient(aside, STEP) / np.maximum(speed, SLOWEST) ** 2, 0.0)
    return np.ascontiguousarray(np.column_stack([times, x, y, course, bend, speed, np.gradient(speed, STEP)]))


def _joined(times: Floats, values: Floats, at: Floats) -> Floats:
    """Returns values at times of the cubic Hermite curves through points, whose slopes are central differences."""
    slopes = np.gradient(values, times, axis=0)
    row = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    length = (times[row + 1] - times[row])[:, None]
    u = (at - times[row])[:, None] / length
    first, last = values[row], values[row + 1]
    start, end = slopes[row] * length, slopes[row + 1] * length
    beyond = np.maximum(u - 1.0, 0.0)
    u = u - beyond
    blend = u * u * (3.0 - 2.0 * u)
    return np.asarray(first + blend * (last - first) + u * (1.0 - u) * ((1.0 - u) * start - u * end) + beyond * end)
