"""Trajectories for the vehicle's tracker: from points of a user's controller, and from the built-in planner."""

from collections.abc import Mapping, Sequence
from math import ceil
from typing import Any

import numpy as np

from drivecal.bundles.highway import Ego, HighwayScenario, PlannerController
from drivecal.bundles.highway_catalogue import PLANNER_PARAMETERS
from drivecal.domain.roads import Floats
from drivecal.domain.scenarios import EgoStart, Road, Scenario, SpeedKnot, Task
from drivecal.highway.drive.control import Command, CommandControl, Control, PlannerControl, RunView
from drivecal.highway.drive.controllers import Checked, ControllerError
from drivecal.highway.drive.geometry import NAMES
from drivecal.highway.drive.road import HighwayRoad
from drivecal.highway.manoeuvres import Manoeuvre
from drivecal.highway.planner.following import follow
from drivecal.highway.planner.planner import FrenetPlanner
from drivecal.highway.planner.plans import SPACING
from drivecal.highway.vehicle.kernels import TRAJECTORY
from drivecal.plugins.ports import Observation

STEP = 0.05
"""Seconds between rows of a trajectory."""
LONGEST = 10.0
"""Seconds of a trajectory that are looked at, unless more are needed."""
MOST_POINTS = 10_000
PLANNER_STEP = 0.1
"""Seconds between rows of the planner's trajectories."""
SLOWEST = 0.5
"""Speed (m/s) below which a trajectory has the road's heading."""
LANE_TOLERANCE = 0.5
"""Largest distance of a track from the planner's equally wide lanes, as a share of a lane's width."""
SAME = 1e-6
"""Largest difference (s) of times that are the same but for rounding."""
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


class PlannerTrajectories(PlannerControl):
    """The built-in planner on a corridor: its road has the corridor's reference line and as many lanes as go on to its left."""

    def __init__(
        self, section: PlannerController, scenario: HighwayScenario, road: HighwayRoad, start: tuple[float, float]
    ) -> None:
        """`start`: s and d of the ego vehicle."""
        self._on_corridor = _CorridorPlanner(_task(section, scenario.ego, road, start), road.line)
        super().__init__(self._on_corridor)
        self.period, self._values, self._has_levels = section.period, dict(section.values), bool(road.levels)

    def begin(self, parameters: Mapping[str, Any]) -> None:
        given = self._values | dict(parameters)
        super().begin([float(given[name]) for name in PLANNER_PARAMETERS])

    def act(self, view: RunView) -> Command:
        outlines = view.traffic.outlines
        if self._has_levels:  # without those above or below the road
            here = ~np.isnan(view.neighbours[:, 0])
            view.neighbours, outlines = view.neighbours[here], outlines[here]
        if view.lead > 0.0:
            view.neighbours = view.neighbours.copy()
            view.neighbours[:, :2] += view.lead * view.neighbours[:, 2:4]
        try:
            self._on_corridor.follow(view, outlines)
            return super().act(view)
        except ValueError as error:
            raise ControllerError(f"the planner failed at {view.time:g} s: {error}") from error


class _CorridorPlanner(FrenetPlanner):
    """The planner along a given line in the place of the scenario's, which slows down behind any leader."""

    def __init__(self, scenario: Scenario, line: Floats) -> None:
        super().__init__(scenario)
        changes = [np.diff(column, append=column[-1]) / SPACING for column in (line[:, 4], self._road[:, 5])]
        rows = min(len(line), len(self._road))
        columns = [line[:rows, :5], self._road[:rows, 5], np.cos(line[:rows, 3]), np.sin(line[:rows, 3])]
        self._road = np.ascontiguousarray(np.column_stack([*columns, *(change[:rows] for change in changes)]))
        self._wanted_speeds = self._road[:, 5].copy()
        self._follows = True

    def follow(self, observation: Observation, outlines: Floats) -> None:
        """Lowers the desired speed of the next plan behind a leader. `outlines` are the neighbours'."""
        scene = self._scenes[self._wanted(observation.time)]
        self._follows = follow(
            self._road, self._wanted_speeds, scene, observation.ego, observation.neighbours, outlines, self._follows
        )


def _task(section: PlannerController, ego: Ego, road: HighwayRoad, start: tuple[float, float]) -> Scenario:
    """Returns the planner's scenario: lanes of equal width that go on to the end, and the wish."""
    line, centres, widths, limits = road.line, road.lanes[:, :, 0], road.lanes[:, :, 1], road.lanes[:, :, 2]
    ahead = line[:, 0] >= start[0]
    nearest = np.nanargmin(np.where(np.isnan(centres), np.inf, np.abs(centres)), axis=1)
    rows = np.arange(len(line))
    width = float(np.median(widths[rows, nearest][ahead]))
    lanes = 1
    while np.all(np.nanmin(np.abs(centres[ahead] - lanes * width), axis=1) <= LANE_TOLERANCE * width):
        lanes += 1
    target = min(section.lane, lanes - 1)
    if section.lane >= lanes:
        raise ControllerError(f"the planner wants lane {section.lane}, but only {lanes} go on to the end of the route")
    wanted = limits[rows, nearest] if section.speed is None else np.full(len(line), section.speed)
    steps = np.flatnonzero(np.diff(wanted, prepend=wanted[0] - 1.0))
    knots = tuple(SpeedKnot(float(line[row, 0]), float(wanted[row])) for row in steps)
    first = min(max(round(start[1] / width), 0), lanes - 1)
    return Scenario(
        id="corridor",
        title="",
        rated_as=Manoeuvre.LANE_KEEPING,
        duration=1.0,
        step=PLANNER_STEP,
        network=b"",
        route=(),
        road=Road(line[:, :5], float(line[-1, 0]), lanes, width),
        ego=EgoStart(start[0], start[1], ego.speed, length=ego.length, width=ego.width),
        task=Task(first, target, knots),
    )
