"""The planner's compiled arithmetic, all in one module because numba's cache notices edits of this file only.

One fixed order of summation, no fast-math, ties to the lowest index: equal input gives equal bits, in planning and in re-evaluating
a stored planning state. Lateral and longitudinal plans are sampled once each; a candidate is a pair of them, numbered
longitudinal index * n_lateral + lateral index. Inner loops run over lateral plans, side by side in memory, so that they vectorise.

Arrays (float64, SI units, C order):
road (n, 10): s, x, y, heading, curvature (as from `domain.roads.reference_line`, every `SPACING`), desired speed, cosine and sine of the
    heading, change of curvature and of desired speed per metre until the next row
scene (8,): wanted lane's centre, lane width, last lane, half length and half width of the ego vehicle, lowest and highest allowed d,
    time step of the trajectory
scales (18,): see `cost.scales`
lateral_ends (2, n_lateral), longitudinal_ends (2, n_longitudinal): see `candidates`
ego (6,): s, s', s'', d, d', d''; start (8,): the same at the start of the plan, and the rest (s) of the previous lateral and
    longitudinal plan, 0 without a previous plan; neighbours (m, 6): see `ports.Observation`
quintics (8, n_lateral): six coefficients of d(t), end offset, horizon; quartics (7, n_longitudinal): five of s(t), end speed, horizon
memory (8, 2): the previous plan, its quintic in column 0 and its quartic in column 1; horizons of 0 without a previous plan
lateral (6, n_lateral), longitudinal (2, n_longitudinal), combined (7, n_longitudinal, n_lateral): features, rows named below
"""

from math import atan2, cos, hypot, sin
from typing import Any

import numpy as np
from numba import njit

compiled = njit(cache=True, error_model="numpy")
"""Python's error model checks every division for zero, and a loop that may raise is not vectorised."""

POINTS = 30
INTERVAL = 0.25
"""Seconds between the points at which candidates are judged, in the middle of thirty intervals: a horizon of 7.5 s."""

WIDTH = 32
"""Lateral plans, at most: rows of them in one array, at constant distances, need no checks whether they overlap before they are computed
with vector instructions. Rows are computed as a whole, what is beside the plans is never looked at: four vectors of 512 bits and no rest
take half the time of 24 plans alone. (Loops over a constant number would be unrolled instead.)"""
TOUCHING, CLEAR, AHEAD, ALONGSIDE, BEHIND = (row * WIDTH for row in range(5))
NEAR = 5 * WIDTH
"""Features of the neighbours for the candidates of one longitudinal plan, unscaled: rows of COLLISION, CLEARANCE, LEADER, CLOSING,
FOLLOWER."""
SPACING = 0.5
"""Distance between rows of the road, m. A power of two: multiplying by its inverse, as compilers do, gives the same bits as dividing."""

FEATURE_GRID = 256.0
"""Features are multiples of 1 / 256, exact in binary. Smaller differences cannot be felt. Without the grid, rounding errors would choose
between equal plans; with it such plans tie, and the tie goes to the same candidate for all weights."""

LATERAL_BASE, LATERAL_JERK, CENTRE, CONSISTENCY, ARRIVAL, BOUNDARY = range(6)
"""Rows of `lateral`: terminal offset and change of plan (base), P1, P3, P5, P6, P9."""
LONGITUDINAL_BASE, LONGITUDINAL_JERK = range(2)
"""Rows of `longitudinal`: speed error, acceleration and change of plan (base), P1."""
COLLISION, LATERAL_ACCELERATION, HEADING, CLEARANCE, LEADER, CLOSING, FOLLOWER = range(7)
"""Rows of `combined`: collision (base), P2, P4, P7, P8, P10, P11."""

# A plan starts from the previous plan if the vehicle deviates by less than this (m, m/s): feedback of every small deviation would make
# the plan, and the ride, as rough as the tracking. Beyond this it starts from the measured state.
LARGEST_DEVIATIONS = (1.5, 1.0, 0.4, 0.5)
SHORTEST_REST = 0.3
"""A shorter rest of a plan is no candidate, s."""

CLEAR_SIDE = 2.0
CLEAR_TIME = 1.0
SHORTEST_CLEARANCE = 5.0
"""P7: half axes of the ellipse of clear space around a vehicle, between the bodies: 2 m, one second (at least 5 m)."""
ARRIVED, NOT_ARRIVED = 1.0, 1.8
"""P6: distances from the target lane's centre, m, around the marking at half a lane; time between them counts in part, without a jump. P6
concerns lane changes only: P3 and P9 judge offsets inside the lane."""
BOUNDARY_SPACE = 0.5
"""P9: m between the vehicle's side and the lane boundary."""
LARGEST_CHANGE = 0.5
"""P5: differences to the previous plan saturate around this, m: another decision counts once, however far it leads."""
ALONGSIDE_TIME = 0.5
SMALLEST_SIDE_GAP = 0.5
"""P10: vehicles within 0.5 s ahead and behind are alongside, fading out; smaller gaps count as this, m."""
IN_PATH_FADE = 0.6
SMALLEST_GAP = 1.0
LARGEST_URGENCY = 1.0
"""P8, P11: lateral clearance, m, at which a vehicle is out of the way; shorter gaps count as this, m; 1/s², TTC below 1 s."""
DRIFT_TIME = 1.0
"""Time constant, s, of the predicted decay of a neighbour's lateral speed; its longitudinal speed is predicted constant."""
SLOWEST, STANDSTILL = 1.0, 0.1
"""Least speed for divisions, and least speed with a meaningful course (below it, the road's heading is used), m/s."""

LARGEST_CURVATURE = 0.1
LARGEST_SIDE_ACCELERATION = 5.0
LARGEST_BRAKING, LARGEST_THRUST = 6.0, 4.0
"""Limits of feasible candidates, 1/m and m/s²."""


@compiled
def point_of(road: Any, s: float) -> tuple[float, float, float]:
    """x, y and heading of the reference line at arc length s: as in `domain.roads.pose_on`."""
    last = len(road) - 1
    if s < 0.0 or s > last * SPACING:
        row, ahead = (0, s) if s < 0.0 else (last, s - last * SPACING)
        return road[row, 1] + ahead * road[row, 6], road[row, 2] + ahead * road[row, 7], road[row, 3]
    row = min(int(s / SPACING), last - 1)
    u = s - road[row, 0]
    w = u / SPACING
    from_start, from_end = w * (1.0 - w) ** 2 * SPACING, w * w * (w - 1.0) * SPACING
    blend = w * w * (3.0 - 2.0 * w)
    x0, y0, x1, y1 = road[row, 1], road[row, 2], road[row + 1, 1], road[row + 1, 2]
    x = x0 + blend * (x1 - x0) + from_start * road[row, 6] + from_end * road[row + 1, 6]
    y = y0 + blend * (y1 - y0) + from_start * road[row, 7] + from_end * road[row + 1, 7]
    return x, y, road[row, 3] + u * (road[row, 4] + 0.5 * road[row, 8] * u)


@compiled
def road_ahead(road: Any, s: float) -> tuple[float, float, float]:
    """Curvature, its change by s, and the desired speed at s."""
    last = len(road) - 1
    if s < 0.0 or s > last * SPACING:
        return 0.0, 0.0, road[0 if s < 0.0 else last, 5]
    row = min(int(s / SPACING), last - 1)
    u = s - road[row, 0]
    return road[row, 4] + u * road[row, 8], road[row, 8], road[row, 5] + u * road[row, 9]


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
def fit(road: Any, lateral_ends: Any, longitudinal_ends: Any, start: Any, memory: Any, quintics: Any, quartics: Any) -> None:
    """Fits all plans from `start`. The last lateral and the last longitudinal plan continue the previous plan."""
    last = lateral_ends.shape[1] - 1
    for i in range(last + 1):
        fit_quintic(quintics, i, start[3], start[4], start[5], lateral_ends[0, i], lateral_ends[1, i])
    if start[6] > 0.0:
        fit_quintic(quintics, last, start[3], start[4], start[5], memory[6, 0], start[6])
    _, _, limit = road_ahead(road, start[0])
    last = longitudinal_ends.shape[1] - 1
    for j in range(last + 1):
        horizon = longitudinal_ends[1, j]
        _, _, desired = road_ahead(road, start[0] + start[1] * horizon)
        _, _, desired = road_ahead(road, start[0] + 0.5 * (start[1] + min(limit, desired)) * horizon)
        speed = max(min(limit, desired) + longitudinal_ends[0, j], 0.0)
        fit_quartic(quartics, j, start[0], start[1], start[2], speed, horizon)
    if start[7] > 0.0:
        fit_quartic(quartics, last, start[0], start[1], start[2], memory[5, 1], start[7])


@compiled
def on_grid(raw: float, scale: float) -> float:
    """The feature of a raw quantity: scaled, then rounded to the grid of features."""
    return float(np.floor(raw * (scale * FEATURE_GRID) + 0.5) * (1.0 / FEATURE_GRID))


@compiled
def evaluate(
    road: Any, scene: Any, scales: Any, start: Any, neighbours: Any, memory: Any, elapsed: float, quintics: Any, quartics: Any,
    lateral: Any, longitudinal: Any, combined: Any,
) -> None:  # fmt: skip
    """Writes the features of all candidates, `WIDTH` lateral plans at most."""
    n_longitudinal = quartics.shape[1]
    motion = np.empty(POINTS * 3 * WIDTH)
    width = max(quintics.shape[1], WIDTH)
    look_aside(scene, scales, start, memory, elapsed, quintics, lateral, motion, width)
    s, s1 = np.empty((POINTS, n_longitudinal)), np.empty((POINTS, n_longitudinal))
    look_ahead(road, scales, start, quartics, motion, s, s1, longitudinal, combined, width)
    near = np.zeros(n_longitudinal * NEAR)
    moments, aside = np.empty((POINTS, 6)), np.empty(5 * WIDTH)
    survey(motion, s, s1, moments, quintics.shape[1])
    for m in range(len(neighbours)):
        look_at(scene, start, neighbours[m], motion, s, s1, moments, aside, near, width)
    n_lateral = quintics.shape[1]
    for j in range(n_longitudinal):
        at = j * NEAR
        for i in range(n_lateral):
            combined[COLLISION, j, i] = on_grid(near[at + TOUCHING + i], scales[15] / POINTS)
        for i in range(n_lateral):
            combined[CLEARANCE, j, i] = on_grid(near[at + CLEAR + i], scales[7] / POINTS)
        for i in range(n_lateral):
            combined[LEADER, j, i] = on_grid(near[at + AHEAD + i], scales[8])
        for i in range(n_lateral):
            combined[CLOSING, j, i] = on_grid(near[at + ALONGSIDE + i], scales[10] / POINTS)
        for i in range(n_lateral):
            combined[FOLLOWER, j, i] = on_grid(near[at + BEHIND + i], scales[11])


@compiled
def look_aside(
    scene: Any, scales: Any, start: Any, memory: Any, elapsed: float, quintics: Any, lateral: Any, motion: Any, width: int
) -> None:
    """Writes the features of lateral plans, and d, d', d'' of all of them at each point to `motion`, rows of `WIDTH`."""
    n_lateral = quintics.shape[1]
    wanted, lane_width, last_lane, half_width = scene[0], scene[1], scene[2], scene[4]
    plans, sums = np.ones(8 * WIDTH), np.zeros(5 * WIDTH)
    for row in range(8):
        for i in range(n_lateral):
            plans[row * WIDTH + i] = quintics[row, i]
    edge = 0.5 * lane_width - half_width - BOUNDARY_SPACE
    for k in range(POINTS):
        t = (k + 0.5) * INTERVAL
        planned, _, _ = lateral_at(memory, 0, t + elapsed)
        at = k * 3 * WIDTH
        for i in range(width):
            c0, c1, c2 = plans[i], plans[WIDTH + i], plans[2 * WIDTH + i]
            c3, c4, c5 = plans[3 * WIDTH + i], plans[4 * WIDTH + i], plans[5 * WIDTH + i]
            moving = t < plans[7 * WIDTH + i]
            here = c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5))))
            speed = c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5)))
            acceleration = 2.0 * c2 + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5))
            jerk = 6.0 * c3 + t * (24.0 * c4 + t * 60.0 * c5)
            here = here if moving else plans[6 * WIDTH + i]
            jerk = jerk if moving else 0.0
            motion[at + i] = here
            motion[at + WIDTH + i] = speed if moving else 0.0
            motion[at + 2 * WIDTH + i] = acceleration if moving else 0.0
            sums[i] += jerk * jerk
            lane = np.floor(here / lane_width + 0.5)
            lane = max(lane, 0.0)
            lane = min(lane, last_lane)
            offset = abs(here - lane * lane_width)
            sums[WIDTH + i] += offset * offset / (1.0 + offset * offset)
            missing = (offset - edge) / BOUNDARY_SPACE
            missing = max(missing, 0.0)
            sums[4 * WIDTH + i] += missing * missing
            change = (here - planned) * (here - planned)
            sums[2 * WIDTH + i] += change / (1.0 + change * (1.0 / (LARGEST_CHANGE * LARGEST_CHANGE)))
            away = (abs(here - wanted) - ARRIVED) / (NOT_ARRIVED - ARRIVED)
            away = max(away, 0.0)
            sums[3 * WIDTH + i] += min(away, 1.0)
    consistency = scales[5] / POINTS if memory[7, 0] > 0.0 else 0.0
    for i in range(n_lateral):
        offset = abs(motion[(POINTS - 1) * 3 * WIDTH + i] - wanted)
        changed = scales[16] if start[6] > 0.0 and i != n_lateral - 1 else 0.0
        lateral[LATERAL_BASE, i] = on_grid(scales[13] * 2.0 * offset * offset / (1.0 + offset) + changed, 1.0)
        lateral[LATERAL_JERK, i] = on_grid(sums[i], scales[1] / POINTS)
        lateral[CENTRE, i] = on_grid(sums[WIDTH + i], scales[3] / POINTS)
        lateral[CONSISTENCY, i] = on_grid(sums[2 * WIDTH + i], consistency)
        lateral[ARRIVAL, i] = on_grid(sums[3 * WIDTH + i], scales[6] * INTERVAL)
        lateral[BOUNDARY, i] = on_grid(sums[4 * WIDTH + i], scales[9] / POINTS)


@compiled
def look_ahead(
    road: Any,
    scales: Any,
    start: Any,
    quartics: Any,
    motion: Any,
    s: Any,
    s1: Any,
    longitudinal: Any,
    combined: Any,
    width: int,
) -> None:
    """Writes the features of longitudinal plans, s and s' at each point, shape (POINTS, n_longitudinal), and LATERAL_ACCELERATION and
    HEADING of the candidates."""
    n_longitudinal, n_lateral = combined.shape[1], combined.shape[2]
    sums, bends, slownesses, moved = np.empty(WIDTH), np.empty(POINTS), np.empty(WIDTH), np.empty(4 * WIDTH)
    _, _, limit = road_ahead(road, start[0])
    straight_on = -1
    for j in range(n_longitudinal):
        error_sum, acceleration_sum, jerk_sum = 0.0, 0.0, 0.0
        straight = True
        c0, c1, c2, c3, c4 = quartics[0, j], quartics[1, j], quartics[2, j], quartics[3, j], quartics[4, j]
        cruise, end = quartics[5, j], quartics[6, j]
        for k in range(width):  # `longitudinal_at`, side by side; values beyond the last point are unused
            t = (k + 0.5) * INTERVAL
            beyond = max(t - end, 0.0)
            t = min(t, end)
            along = c0 + t * (c1 + t * (c2 + t * (c3 + t * c4)))
            speed = c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * 4.0 * c4))
            speed = cruise if beyond > 0.0 else speed
            moved[k] = along + beyond * cruise if beyond > 0.0 else along
            moved[WIDTH + k] = speed
            moved[2 * WIDTH + k] = 0.0 if beyond > 0.0 else 2.0 * c2 + t * (6.0 * c3 + t * 12.0 * c4)
            moved[3 * WIDTH + k] = 0.0 if beyond > 0.0 else 6.0 * c3 + t * 24.0 * c4
            slownesses[k] = 1.0 / max(speed, SLOWEST)
        for k in range(POINTS):
            along, speed, acceleration, jerk = moved[k], moved[WIDTH + k], moved[2 * WIDTH + k], moved[3 * WIDTH + k]
            s[k, j], s1[k, j] = along, speed
            curvature, _, desired = road_ahead(road, along)
            error = speed - min(limit, desired)
            error_sum += error * error
            acceleration_sum += acceleration * acceleration
            jerk_sum += jerk * jerk
            bends[k] = speed * speed * curvature
            straight = straight and bends[k] == 0.0
        changed = scales[17] if start[7] > 0.0 and j != n_longitudinal - 1 else 0.0
        base = (scales[12] * error_sum + scales[14] * acceleration_sum) / POINTS + changed
        longitudinal[LONGITUDINAL_BASE, j] = on_grid(base, 1.0)
        longitudinal[LONGITUDINAL_JERK, j] = on_grid(jerk_sum, scales[1] / POINTS)
        sums[:] = 0.0
        for k in range(0, POINTS, 5):  # five at a time: sums are loaded and stored less often
            row = (3 * k + 1) * WIDTH
            slow0, slow1, slow2 = slownesses[k], slownesses[k + 1], slownesses[k + 2]
            slow3, slow4 = slownesses[k + 3], slownesses[k + 4]
            for i in range(width):
                heading0 = motion[row + i] * slow0
                heading1 = motion[row + 3 * WIDTH + i] * slow1
                heading2 = motion[row + 6 * WIDTH + i] * slow2
                heading3 = motion[row + 9 * WIDTH + i] * slow3
                heading4 = motion[row + 12 * WIDTH + i] * slow4
                total = sums[i] + heading0 * heading0
                total += heading1 * heading1
                total += heading2 * heading2
                total += heading3 * heading3
                sums[i] = total + heading4 * heading4
        for i in range(n_lateral):
            combined[HEADING, j, i] = on_grid(sums[i], scales[4] / POINTS)
        if straight and straight_on >= 0:  # where the road is straight, speed makes no difference
            for i in range(n_lateral):
                combined[LATERAL_ACCELERATION, j, i] = combined[LATERAL_ACCELERATION, straight_on, i]
            continue
        sums[:] = 0.0
        for k in range(0, POINTS, 5):
            row = (3 * k + 2) * WIDTH
            bend0, bend1, bend2, bend3, bend4 = bends[k], bends[k + 1], bends[k + 2], bends[k + 3], bends[k + 4]
            for i in range(width):
                side0 = motion[row + i] + bend0
                side1 = motion[row + 3 * WIDTH + i] + bend1
                side2 = motion[row + 6 * WIDTH + i] + bend2
                side3 = motion[row + 9 * WIDTH + i] + bend3
                side4 = motion[row + 12 * WIDTH + i] + bend4
                total = sums[i] + side0 * side0
                total += side1 * side1
                total += side2 * side2
                total += side3 * side3
                sums[i] = total + side4 * side4
        for i in range(n_lateral):
            combined[LATERAL_ACCELERATION, j, i] = on_grid(sums[i], scales[2] / POINTS)
        if straight:
            straight_on = j


@compiled
def survey(motion: Any, s: Any, s1: Any, moments: Any, n_lateral: int) -> None:
    """Writes, for each point in time, the remaining share of a neighbour's lateral speed and the bounds of all
    plans: least and largest d, least and largest s, largest s'; shape (POINTS, 6)."""
    n_longitudinal = s.shape[1]
    for k in range(POINTS):
        at = 3 * WIDTH * k
        rightmost, leftmost = motion[at], motion[at]
        for i in range(1, n_lateral):
            rightmost, leftmost = min(rightmost, motion[at + i]), max(leftmost, motion[at + i])
        last, first, fastest = s[k, 0], s[k, 0], s1[k, 0]
        for j in range(1, n_longitudinal):
            last, first, fastest = min(last, s[k, j]), max(first, s[k, j]), max(fastest, s1[k, j])
        moments[k, 0] = np.exp(-((k + 0.5) * INTERVAL) / DRIFT_TIME)
        moments[k, 1], moments[k, 2], moments[k, 3], moments[k, 4], moments[k, 5] = rightmost, leftmost, last, first, fastest


@compiled
def look_at(
    scene: Any, start: Any, neighbour: Any, motion: Any, s: Any, s1: Any, moments: Any, aside: Any, near: Any, width: int
) -> None:
    """Adds the features of a neighbour for each candidate to `near`, shape (n_longitudinal * NEAR,). `aside` is scratch, rows of `WIDTH`:
    space between the sides, touching, squared ratio of space to wanted space, closing rate squared, how far in the path. `moments`: as from
    `survey`.

    A vehicle that follows in the lane where the ego vehicle is already means nothing: keeping its distance is its own affair. What
    would add nothing but zeros, by the space between the vehicle and the nearest of all plans, is left out: that changes no bit.
    """
    if neighbour[0] < start[0] and abs(neighbour[1] - start[3]) < 0.5 * scene[1]:
        return
    n_longitudinal = s.shape[1]
    length = scene[3] + 0.5 * neighbour[4]
    breadth = scene[4] + 0.5 * neighbour[5]
    in_target_lane = abs(neighbour[1] - scene[0]) < 0.5 * scene[1]
    for k in range(POINTS):
        t = (k + 0.5) * INTERVAL
        fading = moments[k, 0]
        other_d = neighbour[1] + neighbour[3] * DRIFT_TIME * (1.0 - fading)
        other_d1 = neighbour[3] * fading
        other_s = neighbour[0] + neighbour[2] * t
        # Rounding keeps order: a bound of the nearest, foremost or fastest plan holds for the others.
        space = max(moments[k, 1] - other_d, other_d - moments[k, 2]) - breadth
        out_of_path = space >= IN_PATH_FADE
        fastest = moments[k, 5]
        if out_of_path:
            gap = max(other_s - moments[k, 4], moments[k, 3] - other_s) - length
            if gap >= max(CLEAR_TIME * fastest, SHORTEST_CLEARANCE, ALONGSIDE_TIME * max(fastest, SLOWEST)):
                continue
        enough = space * space * (1.0 / (CLEAR_SIDE * CLEAR_SIDE)) if space > 0.0 else 0.0
        row = 3 * WIDTH * k
        looked = in_path = closing = False
        for j in range(n_longitudinal):
            ahead = other_s - s[k, j]
            gap = max(abs(ahead) - length, 0.0)
            clear = max(CLEAR_TIME * s1[k, j], SHORTEST_CLEARANCE)
            approach = s1[k, j] - neighbour[2] if ahead > 0.0 else neighbour[2] - s1[k, j]
            matters = not out_of_path and approach > 0.0 and (ahead > 0.0 or in_target_lane)
            reach = ALONGSIDE_TIME * max(s1[k, j], SLOWEST)
            if gap >= max(clear, reach) and not matters:
                continue
            if not looked:
                looked = True
                for i in range(width):
                    beside = abs(other_d - motion[row + i]) - breadth
                    touching = 1.0 if beside < 0.0 else 0.0
                    beside = max(beside, 0.0)
                    aside[i] = beside
                    aside[WIDTH + i] = touching
                    aside[2 * WIDTH + i] = beside * beside * (1.0 / (CLEAR_SIDE * CLEAR_SIDE))
            at = j * NEAR
            if gap < clear:
                shortfall = 1.0 - (gap / clear) * (gap / clear)
                if not enough >= shortfall:
                    for i in range(width):
                        missing = shortfall - aside[2 * WIDTH + i]
                        near[at + CLEAR + i] += max(missing, 0.0)
            if gap < reach:
                if not closing:
                    closing = True
                    for i in range(width):
                        slower = motion[row + WIDTH + i] - other_d1
                        towards = slower if other_d - motion[row + i] > 0.0 else -slower
                        towards = max(towards, 0.0)
                        rate = towards / max(aside[i], SMALLEST_SIDE_GAP)
                        aside[3 * WIDTH + i] = rate * rate
                alongside = 1.0 - gap / reach
                for i in range(width):
                    near[at + ALONGSIDE + i] += alongside * aside[3 * WIDTH + i]
            if gap == 0.0 and not space >= 0.0:
                for i in range(width):
                    near[at + TOUCHING + i] += aside[WIDTH + i]
            if matters:
                if not in_path:
                    in_path = True
                    for i in range(width):
                        path = 1.0 - aside[i] / IN_PATH_FADE
                        aside[4 * WIDTH + i] = max(path, 0.0)
                rate = approach / max(gap, SMALLEST_GAP)
                urgency = min(rate * rate, LARGEST_URGENCY)
                side = at + (AHEAD if ahead > 0.0 else BEHIND)
                for i in range(width):
                    value = urgency * aside[4 * WIDTH + i]
                    near[side + i] = max(near[side + i], value)


@compiled
def costs_of(lateral: Any, longitudinal: Any, combined: Any, weights: Any, costs: Any) -> None:
    """J of all candidates, shape (n_longitudinal, n_lateral), from their features and the weights (12,) of base and P1..P11."""
    n_longitudinal, n_lateral = combined.shape[1], combined.shape[2]
    for j in range(n_longitudinal):
        along = weights[0] * longitudinal[LONGITUDINAL_BASE, j] + weights[1] * longitudinal[LONGITUDINAL_JERK, j]
        for i in range(n_lateral):
            aside = (
                weights[0] * lateral[LATERAL_BASE, i]
                + weights[1] * lateral[LATERAL_JERK, i]
                + weights[3] * lateral[CENTRE, i]
                + weights[5] * lateral[CONSISTENCY, i]
                + weights[6] * lateral[ARRIVAL, i]
                + weights[9] * lateral[BOUNDARY, i]
            )
            costs[j, i] = (
                (along + aside)
                + weights[0] * combined[COLLISION, j, i]
                + weights[2] * combined[LATERAL_ACCELERATION, j, i]
                + weights[4] * combined[HEADING, j, i]
                + weights[7] * combined[CLEARANCE, j, i]
                + weights[8] * combined[LEADER, j, i]
                + weights[10] * combined[CLOSING, j, i]
                + weights[11] * combined[FOLLOWER, j, i]
            )


@compiled
def cheapest(costs: Any, infeasible: Any) -> int:
    """Returns the lowest index among the cheapest candidates not known to be infeasible; -1 if none is left."""
    best = -1
    lowest = np.inf
    flat = costs.ravel()
    for candidate in range(len(flat)):
        if flat[candidate] < lowest and not infeasible[candidate]:
            best, lowest = candidate, flat[candidate]
    return best


@compiled
def motion_at(
    road: Any, quintics: Any, quartics: Any, i: int, j: int, t: float
) -> tuple[float, float, float, float, float, float, float]:
    """s, d, d', speed along the road, curvature of the path, speed, acceleration of candidate (i, j) at time t.

    Frenet's formulas as in `domain.roads.to_frenet`, solved for velocity and acceleration.
    """
    d, d1, d2 = lateral_at(quintics, i, t)
    s, s1, s2, _ = longitudinal_at(quartics, j, t)
    curvature, bend, _ = road_ahead(road, s)
    stretch = 1.0 - curvature * d
    forward = s1 * stretch
    tangential = s2 * stretch - s1 * (bend * s1 * d + 2.0 * curvature * d1)
    normal = d2 + curvature * s1 * s1 * stretch
    speed = hypot(forward, d1)
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
    for row in range(len(trajectory)):
        t = row * step
        s, d, d1, forward, curvature, speed, acceleration = motion_at(road, quintics, quartics, i, j, t)
        x, y, heading = point_of(road, s)
        trajectory[row, 0] = t
        trajectory[row, 1] = x - d * sin(heading)
        trajectory[row, 2] = y + d * cos(heading)
        trajectory[row, 3] = heading + (atan2(d1, forward) if d1 != 0.0 else 0.0)
        trajectory[row, 4], trajectory[row, 5], trajectory[row, 6] = curvature, speed, acceleration


@compiled
def consider(
    road: Any, scene: Any, scales: Any, lateral_ends: Any, longitudinal_ends: Any, ego: Any, neighbours: Any, elapsed: float,
    memory: Any, quintics: Any, quartics: Any, lateral: Any, longitudinal: Any, combined: Any,
) -> None:  # fmt: skip
    """Writes plans and features of all candidates; changes nothing else."""
    start = np.empty(8)
    start_at(ego, memory, elapsed, start)
    fit(road, lateral_ends, longitudinal_ends, start, memory, quintics, quartics)
    evaluate(road, scene, scales, start, neighbours, memory, elapsed, quintics, quartics, lateral, longitudinal, combined)


@compiled
def plan(
    road: Any, scene: Any, scales: Any, lateral_ends: Any, longitudinal_ends: Any, weights: Any, ego: Any, neighbours: Any,
    elapsed: float, memory: Any, lateral: Any, longitudinal: Any, combined: Any, infeasible: Any, trajectory: Any, state: Any,
) -> int:  # fmt: skip
    """Makes a plan: writes features, infeasible candidates (n,), the trajectory, the new memory, and to `state`, shape (24 + 6 m,),
    all that decided besides the weights. Returns the chosen candidate, -1 if no cost is a number."""
    n_lateral, n_longitudinal = lateral_ends.shape[1], longitudinal_ends.shape[1]
    state[0], state[1] = scene[0], elapsed
    state[2:8] = ego
    state[8:24] = memory.ravel()
    state[24:] = neighbours.ravel()
    quintics, quartics = np.empty((8, n_lateral)), np.empty((7, n_longitudinal))
    consider(
        road, scene, scales, lateral_ends, longitudinal_ends, ego, neighbours, elapsed,
        memory, quintics, quartics, lateral, longitudinal, combined,
    )  # fmt: skip
    chosen = choose(road, scene, weights, quintics, quartics, lateral, longitudinal, combined, infeasible)
    if chosen < 0:
        return -1
    i, j = chosen % n_lateral, chosen // n_lateral
    trace(road, quintics, quartics, i, j, scene[7], trajectory)
    for index in range(8):
        memory[index, 0] = quintics[index, i]
    for index in range(7):
        memory[index, 1] = quartics[index, j]
    return chosen


@compiled
def decide(
    road: Any, scene: Any, scales: Any, lateral_ends: Any, longitudinal_ends: Any, weights: Any, state: Any,
    lateral: Any, longitudinal: Any, combined: Any, infeasible: Any,
) -> int:  # fmt: skip
    """Returns the choice of `plan` in a `state` that it wrote; writes features and infeasible candidates."""
    quintics, quartics = np.empty((8, lateral_ends.shape[1])), np.empty((7, longitudinal_ends.shape[1]))
    consider(
        road, scene, scales, lateral_ends, longitudinal_ends, state[2:8], state[24:].reshape(-1, 6), state[1],
        state[8:24].reshape(8, 2), quintics, quartics, lateral, longitudinal, combined,
    )  # fmt: skip
    return choose(road, scene, weights, quintics, quartics, lateral, longitudinal, combined, infeasible)


@compiled
def choose(
    road: Any,
    scene: Any,
    weights: Any,
    quintics: Any,
    quartics: Any,
    lateral: Any,
    longitudinal: Any,
    combined: Any,
    infeasible: Any,
) -> int:
    """Returns the candidate to drive, -1 if no cost is a number. Writes which candidates are infeasible.

    Candidates are checked in the order of their cost until a candidate is feasible; if none is, the cheapest is driven all the same:
    braking and steering at the limit is the vehicle's affair then.
    """
    n_longitudinal, n_lateral = combined.shape[1], combined.shape[2]
    costs = np.empty((n_longitudinal, n_lateral))
    costs_of(lateral, longitudinal, combined, weights, costs)
    infeasible[:] = False
    cheapest_of_all = cheapest(costs, infeasible)
    if cheapest_of_all < 0:
        return -1
    chosen = cheapest_of_all
    while chosen >= 0 and not is_feasible(road, scene, quintics, quartics, chosen % n_lateral, chosen // n_lateral):
        infeasible[chosen] = True
        chosen = cheapest(costs, infeasible)
    return chosen if chosen >= 0 else cheapest_of_all
