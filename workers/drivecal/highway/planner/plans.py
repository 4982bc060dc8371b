"""Compiled plans: their polynomials, the road below them, what can be driven, and the trajectory of a candidate.

Arrays (float64, SI units, C order):
road (n, 10): s, x, y, heading, curvature (as from `domain.roads.reference_line`, every `SPACING`), cosine and sine of the heading, desired
    speed, change of curvature and of desired speed per metre until the next row
scene (8,): wanted lane's centre, lane width, last lane, half length and half width of the ego vehicle, lowest and highest allowed d,
    time step of the trajectory
lateral_ends (2, n_lateral): as from `lateral_ends`
ego (6,): s, s', s'', d, d', d''; start (8,): the same at the start of the plan, and the rest (s) of the previous lateral and
    longitudinal plan, 0 without a previous plan; neighbours (m, 6): see `ports.Observation`
quintics (8, n_lateral): six coefficients of d(t), end offset, horizon; quartics (7, n_longitudinal): five of s(t), end speed, horizon; the
    last plan in column 0, see `place_of`
memory (8, 2): the previous plan, its quintic in column 0 and its quartic in column 1; horizons of 0 without a previous plan
lateral (6, n_lateral), longitudinal (2, n_longitudinal), combined (7, n_longitudinal, n_lateral): features, rows as in `terms`
"""

from math import atan2, cos, hypot, sin
from typing import Any

import numpy as np

from drivecal.bundles.highway import Task
from drivecal.highway import geometry
from drivecal.highway.compilation import compiled_with
from drivecal.highway.geometry import point
from drivecal.highway.planner import cost
from drivecal.highway.planner.cost import LATEST_DECELERATION
from drivecal.plugins.ports import Floats

CENTRE_HORIZONS = (7.5, 6.5, 5.5, 4.7, 4.0, 3.2, 2.5)
"""Horizons to the centre of the wanted lane, s: from a leisurely lane change (0.4 m/s² at 7.5 s) to a swerve (3.5 m/s²)."""
OFFSETS = (0.2, -0.2, 0.5, -0.5)
OFFSET_HORIZONS = (6.5, 4.5, 3.0)
"""Offset from the centre of the wanted lane, m, and horizon, s."""
KEEPING_OFFSETS = (0.9, -0.9)
"""Evasive offsets if the task has no other lane, m."""
PREPARING_OFFSET = 0.4
"""Offset from the centre of the task's other lane, if it has any, towards the wanted lane, m."""
FURTHER_HORIZONS = (5.5, 3.0)
"""Horizons of both, s."""

_LONGITUDINAL_ENDS = (
    (7.5, 0.0),
    (6.7, 0.0),
    (6.0, 0.0),
    (5.3, 0.0),
    (4.4, 0.0),
    (3.2, 0.0),
    (7.5, -2.5),
    (7.5, -5.0),
    (4.5, 1.5),
    (4.5, -4.0),
    (2.5, -8.0),
)
"""(horizon in s, end speed relative to the desired speed in m/s): reach it calmly or quickly, go part of the way, overshoot to
escape a follower, slow down behind a vehicle, brake hard (5 m/s²)."""
LONGITUDINAL_ENDS: Floats = np.array(
    [(offset, horizon) for horizon, offset in (*_LONGITUDINAL_ENDS, _LONGITUDINAL_ENDS[0])]
).T.copy()
"""Ends of the longitudinal plans, shape (2, 12): rows end speed relative to the desired speed (m/s) and horizon (s). The last column is a
copy of the first for the rest of the previous plan, as in `lateral_ends`."""


def lateral_ends(lane_width: float, wanted_lane: int, other_lane: int) -> Floats:
    """Ends of the lateral plans, shape (2, 24): rows offset d (m) and horizon (s).

    The last column is a copy of the first; the kernel replaces it by the rest of the previous plan, so that an unchanged plan is always
    a candidate. `other_lane` is the task's other lane (equal to `wanted_lane` in lane keeping).
    """
    wanted, other = wanted_lane * lane_width, other_lane * lane_width
    if other_lane == wanted_lane:
        further = [wanted + offset for offset in KEEPING_OFFSETS]
    else:
        further = [other, other + (PREPARING_OFFSET if wanted > other else -PREPARING_OFFSET)]
    ends = [(wanted, horizon) for horizon in CENTRE_HORIZONS]
    ends += [(wanted + offset, horizon) for offset in OFFSETS for horizon in OFFSET_HORIZONS]
    ends += [(offset, horizon) for offset in further for horizon in FURTHER_HORIZONS]
    return np.ascontiguousarray(np.array([*ends, ends[0]]).T)


def desired_speeds(task: Task, s: Floats) -> Floats:
    """Returns the desired speed (m/s) at arc lengths `s` (uniform, shape (n,)): the task's, lowered ahead of a lower speed such that
    `LATEST_DECELERATION` suffices. A higher speed begins at its knot. The first knot's speed also holds before it."""
    knots, speeds = np.array(task.speeds).T
    in_force = np.maximum(np.searchsorted(knots, s, side="right") - 1, 0)
    reachable = speeds[in_force] ** 2
    ahead = 2.0 * LATEST_DECELERATION * (s[-1] - s)
    # v²(s) <= v²(s') + 2 a (s' - s) for every s' ahead: a running minimum from the end of v² - 2 a (end - s).
    squared: Floats = np.minimum.accumulate((reachable - ahead)[::-1])[::-1] + ahead
    return np.sqrt(squared)


compiled = compiled_with(cost, geometry, error_model="numpy")
inlined = compiled_with(cost, geometry, error_model="numpy", forceinline=True)
"""Python's error model checks every division for zero, and a loop that may raise is not vectorised."""

LATERAL_PLANS, LONGITUDINAL_PLANS = 24, 12
"""Numbers of plans, see `lateral_ends` and `LONGITUDINAL_ENDS`."""
POINTS = 30
INTERVAL = 0.25
"""Seconds between the points at which candidates are judged, in the middle of thirty intervals: a horizon of 7.5 s."""

SPACING = 0.5
"""Distance between rows of the road, m. A power of two: multiplying by its inverse, as compilers do, gives the same bits as dividing."""

# A plan starts from the previous plan if the vehicle deviates by less than this (m, m/s): feedback of every small deviation would make
# the plan, and the ride, as rough as the tracking. Beyond this it starts from the measured state.
LARGEST_DEVIATIONS = (1.5, 1.0, 0.4, 0.5)
SHORTEST_REST = 0.3
"""A shorter rest of a plan is no candidate, s."""

STANDSTILL = 0.1
"""Least speed with a meaningful course, m/s; below it, the road's heading is used."""

LARGEST_CURVATURE = 0.1
LARGEST_SIDE_ACCELERATION = 5.0
LARGEST_BRAKING, LARGEST_THRUST = 6.0, 4.0
"""Limits of feasible candidates, 1/m and m/s²."""


@compiled
def road_ahead(road: Any, s: float) -> tuple[float, float, float]:
    """Curvature, its change by s, and the desired speed at s."""
    last = len(road) - 1
    if s < 0.0 or s > last * SPACING:
        return 0.0, 0.0, road[0 if s < 0.0 else last, 7]
    row = min(int(s / SPACING), last - 1)
    u = s - road[row, 0]
    return road[row, 4] + u * road[row, 8], road[row, 8], road[row, 7] + u * road[row, 9]


@compiled
def lateral_at(quintics: Any, i: int, t: float) -> tuple[float, float, float]:
    """d, d', d'' of lateral plan i at time t; it stays at its end."""
    if t >= quintics[7, i]:
        return quintics[6, i], 0.0, 0.0
    c0, c1, c2, c3, c4, c5 = (
        quintics[0, i], quintics[1, i], quintics[2, i], quintics[3, i], quintics[4, i], quintics[5, i],
    )  # fmt: skip
    d = c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5))))
    d1 = c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5)))
    return d, d1, 2.0 * c2 + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5))


@compiled
def longitudinal_at(quartics: Any, j: int, t: float) -> tuple[float, float, float, float]:
    """s, s', s'', s''' of longitudinal plan j at time t; it keeps its end speed."""
    end = quartics[6, j]
    beyond = max(t - end, 0.0)
    t = min(t, end)
    c0, c1, c2, c3, c4 = quartics[0, j], quartics[1, j], quartics[2, j], quartics[3, j], quartics[4, j]
    s = c0 + t * (c1 + t * (c2 + t * (c3 + t * c4)))
    if beyond > 0.0:
        return s + beyond * quartics[5, j], quartics[5, j], 0.0, 0.0
    s1 = c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * 4.0 * c4))
    return s, s1, 2.0 * c2 + t * (6.0 * c3 + t * 12.0 * c4), 6.0 * c3 + t * 24.0 * c4


@compiled
def fit_quintic(quintics: Any, i: int, d: float, d1: float, d2: float, end: float, horizon: float) -> None:
    """Plan i: from (d, d', d'') to (end, 0, 0) in `horizon` seconds with the least jerk."""
    rest = end - (d + horizon * (d1 + 0.5 * horizon * d2))
    speed = -(d1 + horizon * d2)
    t = horizon
    quintics[0, i], quintics[1, i], quintics[2, i] = d, d1, 0.5 * d2
    quintics[3, i] = (10.0 * rest - t * (4.0 * speed + 0.5 * t * d2)) / (t * t * t)
    quintics[4, i] = (-15.0 * rest + t * (7.0 * speed + t * d2)) / (t * t * t * t)
    quintics[5, i] = (6.0 * rest - t * (3.0 * speed + 0.5 * t * d2)) / (t * t * t * t * t)
    quintics[6, i], quintics[7, i] = end, horizon


@compiled
def fit_quartic(quartics: Any, j: int, s: float, s1: float, s2: float, speed: float, horizon: float) -> None:
    """Plan j: from (s, s', s'') to the end speed without acceleration in `horizon` seconds with the least jerk."""
    rest = speed - s1 - horizon * s2
    quartics[0, j], quartics[1, j], quartics[2, j] = s, s1, 0.5 * s2
    quartics[3, j] = (3.0 * rest + horizon * s2) / (3.0 * horizon * horizon)
    quartics[4, j] = -(2.0 * rest + horizon * s2) / (4.0 * horizon * horizon * horizon)
    quartics[5, j], quartics[6, j] = speed, horizon


@compiled
def start_at(ego: Any, memory: Any, elapsed: float, start: Any) -> None:
    """Writes the start of the plan: on the previous plan if the vehicle is close to it, else as measured."""
    for index in range(6):
        start[index] = ego[index]
    start[6], start[7] = 0.0, 0.0
    if memory[7, 0] == 0.0:
        return
    d, d1, d2 = lateral_at(memory, 0, elapsed)
    s, s1, s2, _ = longitudinal_at(memory, 1, elapsed)
    if (
        abs(ego[0] - s) > LARGEST_DEVIATIONS[0]
        or abs(ego[1] - s1) > LARGEST_DEVIATIONS[1]
        or abs(ego[3] - d) > LARGEST_DEVIATIONS[2]
        or abs(ego[4] - d1) > LARGEST_DEVIATIONS[3]
    ):
        return
    start[0], start[1], start[2], start[3], start[4], start[5] = s, s1, s2, d, d1, d2
    aside, ahead = memory[7, 0] - elapsed, memory[6, 1] - elapsed
    start[6] = aside if aside >= SHORTEST_REST else 0.0
    start[7] = ahead if ahead >= SHORTEST_REST else 0.0


@compiled
def place_of(plan: int, plans: int) -> int:
    """Returns the column of a plan: the last plan is in column 0, because it is chosen most, and the others follow."""
    return plan + 1 if plan < plans - 1 else 0


@compiled
def fit(road: Any, lateral_ends: Any, start: Any, memory: Any, quintics: Any, quartics: Any) -> None:
    """Fits all plans from `start`. The last lateral and the last longitudinal plan continue the previous plan, and come first."""
    for i in range(LATERAL_PLANS):
        fit_quintic(quintics, place_of(i, LATERAL_PLANS), start[3], start[4], start[5], lateral_ends[0, i], lateral_ends[1, i])
    if start[6] > 0.0:
        fit_quintic(quintics, 0, start[3], start[4], start[5], memory[6, 0], start[6])
    _, _, limit = road_ahead(road, start[0])
    for j in range(LONGITUDINAL_PLANS):
        horizon = LONGITUDINAL_ENDS[1, j]
        _, _, desired = road_ahead(road, start[0] + start[1] * horizon)
        _, _, desired = road_ahead(road, start[0] + 0.5 * (start[1] + min(limit, desired)) * horizon)
        speed = max(min(limit, desired) + LONGITUDINAL_ENDS[0, j], 0.0)
        fit_quartic(quartics, place_of(j, LONGITUDINAL_PLANS), start[0], start[1], start[2], speed, horizon)
    if start[7] > 0.0:
        fit_quartic(quartics, 0, start[0], start[1], start[2], memory[5, 1], start[7])


@inlined
def motion_at(
    road: Any, quintics: Any, quartics: Any, i: int, j: int, t: float
) -> tuple[float, float, float, float, float, float, float]:
    """s, d, d', speed along the road, curvature of the path, speed, acceleration of candidate (i, j) at time t.

    Frenet's formulas as in `geometry.frenet_motion`, solved for velocity and acceleration.
    """
    d, d1, d2 = lateral_at(quintics, i, t)
    s, s1, s2, _ = longitudinal_at(quartics, j, t)
    curvature, bend, _ = road_ahead(road, s)
    stretch = 1.0 - curvature * d
    forward = s1 * stretch
    tangential = s2 * stretch - s1 * (bend * s1 * d + 2.0 * curvature * d1)
    normal = d2 + curvature * s1 * s1 * stretch
    speed = hypot(forward, d1) if d1 != 0.0 else abs(forward)
    if speed < STANDSTILL:
        return s, d, 0.0, forward, curvature, speed, tangential
    path = (forward * normal - d1 * tangential) / (speed * speed * speed)
    return s, d, d1, forward, path, speed, (forward * tangential + d1 * normal) / speed


@compiled
def is_feasible(road: Any, scene: Any, quintics: Any, quartics: Any, i: int, j: int) -> bool:
    """Returns False if a candidate turns, brakes or accelerates too hard, drives backwards, or leaves the road farther than it is off."""
    lowest, highest = min(scene[5], quintics[0, i]), max(scene[6], quintics[0, i])
    for k in range(POINTS):
        _, d, _, forward, curvature, speed, acceleration = motion_at(road, quintics, quartics, i, j, (k + 0.5) * INTERVAL)
        if (
            forward < 0.0
            or not lowest <= d <= highest
            or abs(curvature) > LARGEST_CURVATURE
            or abs(curvature) * speed * speed > LARGEST_SIDE_ACCELERATION
            or not -LARGEST_BRAKING <= acceleration <= LARGEST_THRUST
        ):
            return False
    return True


@compiled
def trace(road: Any, quintics: Any, quartics: Any, i: int, j: int, step: float, trajectory: Any) -> None:
    """Writes candidate (i, j) as the Cartesian trajectory of `ports.Planner.plan`, shape (rows, 7)."""
    before, cosine, sine = 0.0, 1.0, 0.0
    for row in range(len(trajectory)):
        t = row * step
        s, d, d1, forward, curvature, speed, acceleration = motion_at(road, quintics, quartics, i, j, t)
        x, y, heading, _, _ = point(road, s)
        if heading != before:
            before, cosine, sine = heading, cos(heading), sin(heading)
        trajectory[row, 0] = t
        trajectory[row, 1] = x - d * sine
        trajectory[row, 2] = y + d * cosine
        trajectory[row, 3] = heading + (atan2(d1, forward) if d1 != 0.0 else 0.0)
        trajectory[row, 4], trajectory[row, 5], trajectory[row, 6] = curvature, speed, acceleration
