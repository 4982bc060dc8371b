"""Compiled features of candidates, by the terms of the cost: those of lateral plans, of longitudinal plans, and of both without traffic.

Eight lateral plans, or eight points in time, are computed side by side. Arrays: see `plans`; `work`: see `scratch`. Plans stand in the
order of `quintics` and `quartics`.
"""

from typing import Any

import numpy as np

from drivecal.highway.compilation import compiled_with
from drivecal.highway.planner import lanes, plans, scratch
from drivecal.highway.planner.lanes import LANES, absolute, bits, floor, larger, load, smaller, spread, store, where
from drivecal.highway.planner.plans import INTERVAL, LATERAL_PLANS, LONGITUDINAL_PLANS, POINTS, lateral_at, road_ahead
from drivecal.highway.planner.scratch import (
    BEND,
    BLOCK,
    BLOCKS,
    HEADINGS,
    IS_STRAIGHT,
    LATERAL,
    LEFTMOST,
    LONGITUDINAL,
    MEETING,
    MOTION,
    RIGHTMOST,
    ROW,
    ROWS,
    S1,
    SIDES,
    SLOWNESS,
    STRAIGHT_SIDES,
    TIME,
    TIMES,
    S,
)

compiled = compiled_with(lanes, plans, scratch, error_model="numpy")
inlined = compiled_with(lanes, plans, scratch, error_model="numpy", forceinline=True)

FEATURE_GRID = 256.0
"""Features are multiples of 1 / 256, exact in binary. Smaller differences cannot be felt. Without the grid, rounding errors would choose
between equal plans; with it such plans tie, and the tie goes to the same candidate for all weights."""

LATERAL_BASE, LATERAL_JERK, CENTRE, CONSISTENCY, ARRIVAL, BOUNDARY = range(6)
"""Rows of `lateral`: terminal offset and change of plan (base), P1, P3, P5, P6, P9."""
LONGITUDINAL_BASE, LONGITUDINAL_JERK = range(2)
"""Rows of `longitudinal`: speed error, acceleration and change of plan (base), P1."""
COLLISION, LATERAL_ACCELERATION, HEADING, CLEARANCE, LEADER, CLOSING, FOLLOWER = range(7)
"""Rows of `combined`: collision (base), P2, P4, P7, P8, P10, P11."""

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
SLOWEST = 1.0
"""Least speed for divisions, m/s."""


BETWEEN = 1e-9
"""Distance (in lanes) from the middle between two lanes beyond which multiplying by the inverse width gives the same lane as dividing."""


@inlined
def on_grid(raw: Any, scale: float) -> Any:
    """Returns the features of raw quantities: scaled, then rounded to the grid of features."""
    return floor(raw * (scale * FEATURE_GRID) + 0.5) * (1.0 / FEATURE_GRID)


@inlined
def nearest_lane(d: Any, lane_width: float, last_lane: float) -> Any:
    """Returns the numbers of the nearest lanes, floor(d / lane_width + 0.5) within those of the road."""
    position = d * (1.0 / lane_width) + 0.5
    lane = floor(position)
    if bits((position - lane < BETWEEN) | (position - lane > 1.0 - BETWEEN)):  # dividing takes several times as long
        lane = floor(d / lane_width + 0.5)
    return smaller(larger(lane, 0.0), last_lane)


@inlined
def look_aside(scene: Any, scales: Any, start: Any, memory: Any, elapsed: float, quintics: Any, work: Any) -> None:
    """Writes the features of lateral plans, their motion, and their least and largest d at each point."""
    wanted, lane_width, last_lane, half_width = scene[0], scene[1], scene[2], scene[4]
    edge = 0.5 * lane_width - half_width - BOUNDARY_SPACE
    consistency = scales[5] / POINTS if memory[7, 0] > 0.0 else 0.0
    for k in range(POINTS):
        work[MEETING + k], _, _ = lateral_at(memory, 0, (k + 0.5) * INTERVAL + elapsed)
    for block in range(BLOCKS):
        column = block * LANES
        c0, c1 = load(quintics, column), load(quintics, LATERAL_PLANS + column)
        c2, c3 = load(quintics, 2 * LATERAL_PLANS + column), load(quintics, 3 * LATERAL_PLANS + column)
        c4, c5 = load(quintics, 4 * LATERAL_PLANS + column), load(quintics, 5 * LATERAL_PLANS + column)
        end, horizon = load(quintics, 6 * LATERAL_PLANS + column), load(quintics, 7 * LATERAL_PLANS + column)
        jerks = offsets = changes = arrivals = shortfalls = spread(0.0)
        here = end
        for k in range(POINTS):
            t, planned = (k + 0.5) * INTERVAL, work[MEETING + k]
            moving = horizon > t
            here = c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5))))
            speed = c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5)))
            acceleration = 2.0 * c2 + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5))
            jerk = 6.0 * c3 + t * (24.0 * c4 + t * 60.0 * c5)
            here, jerk = where(moving, here, end), where(moving, jerk, 0.0)
            at = MOTION + block * BLOCK + k * 3 * LANES
            store(work, at, here)
            store(work, at + LANES, where(moving, speed, 0.0))
            store(work, at + 2 * LANES, where(moving, acceleration, 0.0))
            rightmost, leftmost = here, here
            if block > 0:
                rightmost = smaller(load(work, RIGHTMOST + k * LANES), here)
                leftmost = larger(load(work, LEFTMOST + k * LANES), here)
            store(work, RIGHTMOST + k * LANES, rightmost)
            store(work, LEFTMOST + k * LANES, leftmost)
            jerks = jerks + jerk * jerk
            offset = absolute(here - nearest_lane(here, lane_width, last_lane) * lane_width)
            offsets = offsets + offset * offset / (1.0 + offset * offset)
            missing = larger((offset - edge) / BOUNDARY_SPACE, 0.0)
            shortfalls = shortfalls + missing * missing
            change = (here - planned) * (here - planned)
            changes = changes + change / (1.0 + change * (1.0 / (LARGEST_CHANGE * LARGEST_CHANGE)))
            away = absolute(here - wanted) - ARRIVED
            if bits(away > 0.0):
                arrivals = arrivals + smaller(larger(away / (NOT_ARRIVED - ARRIVED), 0.0), 1.0)
        offset = absolute(here - wanted)
        at = LATERAL + column
        store(work, at + LATERAL_BASE * LATERAL_PLANS, scales[13] * 2.0 * offset * offset / (1.0 + offset))
        store(work, at + LATERAL_JERK * LATERAL_PLANS, on_grid(jerks, scales[1] / POINTS))
        store(work, at + CENTRE * LATERAL_PLANS, on_grid(offsets, scales[3] / POINTS))
        store(work, at + CONSISTENCY * LATERAL_PLANS, on_grid(changes, consistency))
        store(work, at + ARRIVAL * LATERAL_PLANS, on_grid(arrivals, scales[6] * INTERVAL))
        store(work, at + BOUNDARY * LATERAL_PLANS, on_grid(shortfalls, scales[9] / POINTS))
    changed = scales[16] if start[6] > 0.0 else 0.0
    for i in range(1, LATERAL_PLANS):  # all but the rest of the previous plan
        work[LATERAL + i] += changed
    for i in range(0, LATERAL_PLANS, LANES):
        store(work, LATERAL + i, on_grid(load(work, LATERAL + i), 1.0))


@inlined
def look_ahead(road: Any, scales: Any, start: Any, quartics: Any, work: Any) -> None:
    """Writes the features of longitudinal plans, and their motion."""
    _, _, limit = road_ahead(road, start[0])
    for j in range(LONGITUDINAL_PLANS):
        c0, c1, c2, c3, c4 = quartics[0, j], quartics[1, j], quartics[2, j], quartics[3, j], quartics[4, j]
        cruise, end = quartics[5, j], quartics[6, j]
        row, accelerations, jerks = ROWS + j * ROW, MEETING, MEETING + TIMES
        for k in range(0, TIMES, LANES):  # `longitudinal_at`, side by side
            beyond = larger(load(work, TIME + k) - end, 0.0)
            t = smaller(load(work, TIME + k), end)
            cruising = beyond > 0.0
            along = c0 + t * (c1 + t * (c2 + t * (c3 + t * c4)))
            speed = where(cruising, cruise, c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * 4.0 * c4)))
            store(work, row + S + k, where(cruising, along + beyond * cruise, along))
            store(work, row + S1 + k, speed)
            store(work, row + SLOWNESS + k, 1.0 / larger(speed, SLOWEST))
            store(work, accelerations + k, where(cruising, 0.0, 2.0 * c2 + t * (6.0 * c3 + t * 12.0 * c4)))
            store(work, jerks + k, where(cruising, 0.0, 6.0 * c3 + t * 24.0 * c4))
        error_sum, acceleration_sum, jerk_sum, is_straight = 0.0, 0.0, 0.0, True
        for k in range(POINTS):
            speed, acceleration, jerk = work[row + S1 + k], work[accelerations + k], work[jerks + k]
            curvature, _, desired = road_ahead(road, work[row + S + k])
            error = speed - min(limit, desired)
            error_sum += error * error
            acceleration_sum += acceleration * acceleration
            jerk_sum += jerk * jerk
            bend = speed * speed * curvature
            work[row + BEND + k] = bend
            is_straight = is_straight and bend == 0.0
        work[IS_STRAIGHT + j] = 1.0 if is_straight else 0.0
        changed = scales[17] if start[7] > 0.0 and j > 0 else 0.0
        base = (scales[12] * error_sum + scales[14] * acceleration_sum) / POINTS + changed
        at = LONGITUDINAL + j
        work[at + LONGITUDINAL_BASE * LONGITUDINAL_PLANS] = np.floor(base * FEATURE_GRID + 0.5) * (1.0 / FEATURE_GRID)
        jerk_sum = np.floor(jerk_sum * (scales[1] / POINTS * FEATURE_GRID) + 0.5) * (1.0 / FEATURE_GRID)
        work[at + LONGITUDINAL_JERK * LONGITUDINAL_PLANS] = jerk_sum


@inlined
def look_along(scales: Any, work: Any, j: int, block: int, known: int) -> int:
    """Writes HEADING and LATERAL_ACCELERATION of a block along a longitudinal plan.

    `known`: bits of the blocks whose LATERAL_ACCELERATION on a straight road is known, where speed makes no difference. Returns them.
    """
    row, column = ROWS + j * ROW, block * LANES
    headings, sides = spread(0.0), spread(0.0)
    is_straight = work[IS_STRAIGHT + j] > 0.0
    if is_straight and known >> block & 1:
        for k in range(POINTS):
            heading = load(work, MOTION + block * BLOCK + k * 3 * LANES + LANES) * work[row + SLOWNESS + k]
            headings = headings + heading * heading
        store(work, SIDES + column, load(work, STRAIGHT_SIDES + column))
    else:
        for k in range(POINTS):
            at = MOTION + block * BLOCK + k * 3 * LANES
            heading = load(work, at + LANES) * work[row + SLOWNESS + k]
            headings = headings + heading * heading
            side = load(work, at + 2 * LANES) + work[row + BEND + k]
            sides = sides + side * side
        sides = on_grid(sides, scales[2] / POINTS)
        store(work, SIDES + column, sides)
        if is_straight:
            store(work, STRAIGHT_SIDES + column, sides)
            known |= 1 << block
    store(work, HEADINGS + column, on_grid(headings, scales[4] / POINTS))
    return known
