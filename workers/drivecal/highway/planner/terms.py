"""Compiled features of candidates, by the terms of the cost, and the layout of the planner's scratch memory.

The scratch memory `work` is one array of float64, shape (`size_for(m)`,) for m other vehicles, which each plan overwrites: allocating a
dozen arrays takes a tenth of a plan. Plans stand in blocks of `LANES` lateral plans in the order of `quintics` and `quartics` (arrays: see
`plans`), and points in time are filled up to whole `LANES`; what is beyond the last point is computed and never looked at. Eight lateral
plans, or eight points in time, are computed side by side.

Features without traffic come first; features of candidates that meet other vehicles (P7, P8, P10, P11 and the collision in the base) are
sums over the neighbours, and over the points in time of each. What would add nothing but zeros is left out: that changes no bit.
"""

from itertools import accumulate
from typing import Any

import numpy as np

from drivecal.highway import geometry
from drivecal.highway.compilation import compiled_with
from drivecal.highway.planner import cost, lanes, plans
from drivecal.highway.planner.cost import SCALES
from drivecal.highway.planner.lanes import LANES, absolute, bits, floor, larger, load, lowest_bit, smaller, spread, store, where
from drivecal.highway.planner.plans import INTERVAL, LATERAL_PLANS, LONGITUDINAL_PLANS, POINTS, lateral_at, road_ahead

compiled = compiled_with(cost, geometry, lanes, plans, error_model="numpy")
inlined = compiled_with(cost, geometry, lanes, plans, error_model="numpy", forceinline=True)

TIMES = 32
"""Points in time, filled up."""
EVERY = (1 << POINTS) - 1
"""Bits of all points."""
BLOCKS = LATERAL_PLANS // LANES

BLOCK = POINTS * 3 * LANES
"""Numbers of a block in `MOTION`: d, d' and d'' of each point."""
ROW = 4 * TIMES
S, S1, SLOWNESS, BEND = (column * TIMES for column in range(4))
"""Numbers of a longitudinal plan in `ROWS`: s, s', 1 / s', and the lateral acceleration in the road's curve."""
NEAR = 5 * LANES
TOUCHING, CLEAR, AHEAD, ALONGSIDE, BEHIND = (kind * LANES for kind in range(5))
"""Numbers of a block in `NEARS`, unscaled: COLLISION, CLEARANCE, LEADER, CLOSING and FOLLOWER."""
OTHER = 5 * TIMES + LANES
OTHER_S, OTHER_D, OTHER_D1, SPACE, ENOUGH, IS_SEEN = (column * TIMES for column in range(6))
OTHER_S1, LENGTH, BREADTH, FOLLOWING = (IS_SEEN + index for index in range(1, 5))
"""Numbers of another vehicle in `OTHERS`: s, d, d'; the least space at its side that a plan leaves, and its squared share of `CLEAR_SIDE`;
whether any plan comes near it; s'; distances of the centres at which the two touch; whether it is in the wanted lane."""

_SIZES = (
    TIMES,
    TIMES,
    BLOCKS * BLOCK,
    POINTS * LANES,
    POINTS * LANES,
    6 * LATERAL_PLANS,
    2 * LONGITUDINAL_PLANS,
    LATERAL_PLANS,
    LONGITUDINAL_PLANS * ROW,
    LONGITUDINAL_PLANS,
    LATERAL_PLANS,
    LATERAL_PLANS,
    LATERAL_PLANS,
    BLOCKS * NEAR,
    3 * TIMES,
    LANES,
)
(
    TIME,
    FADING,
    MOTION,
    RIGHTMOST,
    LEFTMOST,
    LATERAL,
    LONGITUDINAL,
    ASIDE,
    ROWS,
    IS_STRAIGHT,
    STRAIGHT_SIDES,
    SIDES,
    HEADINGS,
    NEARS,
    MEETING,
    COSTS,
    OTHERS,
) = accumulate(_SIZES, initial=0)
"""Times of the points; remaining share of a neighbour's lateral speed; motion of lateral plans, and their least and largest d by lane;
features of lateral and of longitudinal plans; costs of lateral plans; longitudinal plans, and whether the road is straight along them;
LATERAL_ACCELERATION on straight roads and along the row, HEADING; sums over the neighbours; a longitudinal plan's shortfall, share
alongside and urgency with a neighbour; costs of a block;
neighbours."""


def size_for(others: int) -> int:
    """Returns the size of the scratch memory for this number of other vehicles."""
    return OTHERS + others * OTHER


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
    """Returns the numbers of the nearest lanes, floor(d / lane_width + 0.5) within the road."""
    position = d * (1.0 / lane_width) + 0.5
    lane = floor(position)
    if bits((position - lane < BETWEEN) | (position - lane > 1.0 - BETWEEN)):  # dividing takes several times as long
        lane = floor(d / lane_width + 0.5)
    return smaller(larger(lane, 0.0), last_lane)


@inlined
def look_aside(scene: Any, start: Any, memory: Any, elapsed: float, quintics: Any, work: Any) -> None:
    """Writes the features of lateral plans, their motion, and their least and largest d at each point."""
    wanted, lane_width, last_lane, half_width = scene[0], scene[1], scene[2], scene[4]
    edge = 0.5 * lane_width - half_width - BOUNDARY_SPACE
    consistency = SCALES[5] / POINTS if memory[7, 0] > 0.0 else 0.0
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
        store(work, at + LATERAL_BASE * LATERAL_PLANS, SCALES[13] * 2.0 * offset * offset / (1.0 + offset))
        store(work, at + LATERAL_JERK * LATERAL_PLANS, on_grid(jerks, SCALES[1] / POINTS))
        store(work, at + CENTRE * LATERAL_PLANS, on_grid(offsets, SCALES[3] / POINTS))
        store(work, at + CONSISTENCY * LATERAL_PLANS, on_grid(changes, consistency))
        store(work, at + ARRIVAL * LATERAL_PLANS, on_grid(arrivals, SCALES[6] * INTERVAL))
        store(work, at + BOUNDARY * LATERAL_PLANS, on_grid(shortfalls, SCALES[9] / POINTS))
    changed = SCALES[16] if start[6] > 0.0 else 0.0
    for i in range(1, LATERAL_PLANS):  # all but the rest of the previous plan
        work[LATERAL + i] += changed
    for i in range(0, LATERAL_PLANS, LANES):
        store(work, LATERAL + i, on_grid(load(work, LATERAL + i), 1.0))


@inlined
def look_ahead(road: Any, start: Any, quartics: Any, work: Any) -> None:
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
        changed = SCALES[17] if start[7] > 0.0 and j > 0 else 0.0
        base = (SCALES[12] * error_sum + SCALES[14] * acceleration_sum) / POINTS + changed
        at = LONGITUDINAL + j
        work[at + LONGITUDINAL_BASE * LONGITUDINAL_PLANS] = np.floor(base * FEATURE_GRID + 0.5) * (1.0 / FEATURE_GRID)
        jerk_sum = np.floor(jerk_sum * (SCALES[1] / POINTS * FEATURE_GRID) + 0.5) * (1.0 / FEATURE_GRID)
        work[at + LONGITUDINAL_JERK * LONGITUDINAL_PLANS] = jerk_sum


@inlined
def look_along(work: Any, j: int, block: int, known: int) -> int:
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
        sides = on_grid(sides, SCALES[2] / POINTS)
        store(work, SIDES + column, sides)
        if is_straight:
            store(work, STRAIGHT_SIDES + column, sides)
            known |= 1 << block
    store(work, HEADINGS + column, on_grid(headings, SCALES[4] / POINTS))
    return known


@compiled
def prepare(work: Any) -> None:
    """Writes what is the same for all plans."""
    for k in range(TIMES):
        work[TIME + k] = (k + 0.5) * INTERVAL
        work[FADING + k] = np.exp(-((k + 0.5) * INTERVAL) / DRIFT_TIME)


@inlined
def foresee(scene: Any, start: Any, neighbours: Any, work: Any) -> None:
    """Writes the motion of all neighbours, and which of them matter.

    A vehicle that follows in the lane where the ego vehicle is already does not matter: keeping its distance is its own affair.
    """
    right, left = MEETING, MEETING + TIMES
    for k in range(POINTS):
        rightmost, leftmost = work[RIGHTMOST + k * LANES], work[LEFTMOST + k * LANES]
        for lane in range(1, LANES):
            rightmost = min(rightmost, work[RIGHTMOST + k * LANES + lane])
            leftmost = max(leftmost, work[LEFTMOST + k * LANES + lane])
        work[right + k], work[left + k] = rightmost, leftmost
    for k in range(POINTS, TIMES):
        work[right + k], work[left + k] = 0.0, 0.0
    for m in range(len(neighbours)):
        other = OTHERS + m * OTHER
        if neighbours[m, 0] < start[0] and abs(neighbours[m, 1] - start[3]) < 0.5 * scene[1]:
            work[other + IS_SEEN] = 0.0
            continue
        breadth = scene[4] + 0.5 * neighbours[m, 5]
        length = scene[3] + 0.5 * neighbours[m, 4]
        work[other + OTHER_S1], work[other + LENGTH], work[other + BREADTH] = neighbours[m, 2], length, breadth
        work[other + FOLLOWING] = 1.0 if abs(neighbours[m, 1] - scene[0]) < 0.5 * scene[1] else 0.0
        near = 0
        for k in range(0, TIMES, LANES):
            fading = load(work, FADING + k)
            other_d = neighbours[m, 1] + neighbours[m, 3] * DRIFT_TIME * (1.0 - fading)
            other_s = neighbours[m, 0] + neighbours[m, 2] * load(work, TIME + k)
            # Rounding keeps order: a bound of the nearest plan holds for the others.
            space = larger(load(work, right + k) - other_d, other_d - load(work, left + k)) - breadth
            store(work, other + OTHER_S + k, other_s)
            store(work, other + OTHER_D + k, other_d)
            store(work, other + OTHER_D1 + k, neighbours[m, 3] * fading)
            store(work, other + SPACE + k, space)
            store(work, other + ENOUGH + k, where(space > 0.0, space * space * (1.0 / (CLEAR_SIDE * CLEAR_SIDE)), 0.0))
            near |= bits(space < IN_PATH_FADE)
            for j in range(LONGITUDINAL_PLANS):
                if near:
                    break
                s, speed = load(work, ROWS + j * ROW + S + k), load(work, ROWS + j * ROW + S1 + k)
                reach = larger(larger(CLEAR_TIME * speed, SHORTEST_CLEARANCE), ALONGSIDE_TIME * larger(speed, SLOWEST))
                near |= bits(absolute(other_s - s) - length < reach)
        work[other + IS_SEEN] = 1.0 if near else 0.0


@inlined
def approach(work: Any, m: int, j: int) -> tuple[int, int, int, int, int]:
    """Writes how a longitudinal plan meets neighbour m, and returns the bits of the points at which it matters.

    That is where the clear space falls short, the two are alongside, they close in with the neighbour ahead, or with it behind, and where
    they overlap.
    """
    row, other = ROWS + j * ROW, OTHERS + m * OTHER
    length, other_s1, following = work[other + LENGTH], work[other + OTHER_S1], work[other + FOLLOWING]
    shorts = alongs = leads = follows = overlaps = 0
    for k in range(0, TIMES, LANES):
        speed = load(work, row + S1 + k)
        ahead = load(work, other + OTHER_S + k) - load(work, row + S + k)
        gap = larger(absolute(ahead) - length, 0.0)
        ratio = gap / larger(CLEAR_TIME * speed, SHORTEST_CLEARANCE)
        shortfall = 1.0 - ratio * ratio
        alongside = 1.0 - gap / (ALONGSIDE_TIME * larger(speed, SLOWEST))
        is_ahead = ahead > 0.0
        closing = where(is_ahead, speed - other_s1, other_s1 - speed)
        rate = closing / larger(gap, SMALLEST_GAP)
        urgency = where(closing > 0.0, smaller(rate * rate, LARGEST_URGENCY), 0.0)
        urgency = where(is_ahead, urgency, urgency * following)
        urgency = where(load(work, other + SPACE + k) < IN_PATH_FADE, urgency, 0.0)
        store(work, MEETING + k, shortfall)
        store(work, MEETING + TIMES + k, alongside)
        store(work, MEETING + 2 * TIMES + k, urgency)
        urgents, aheads = bits(urgency > 0.0), bits(is_ahead)
        shorts |= bits(shortfall > load(work, other + ENOUGH + k)) << k
        alongs |= bits(alongside > 0.0) << k
        leads |= (urgents & aheads) << k
        follows |= (urgents & ~aheads) << k
        overlaps |= bits(gap <= 0.0) << k
    return shorts & EVERY, alongs & EVERY, leads & EVERY, follows & EVERY, overlaps & EVERY


@inlined
def space_at(work: Any, first: int, other: int, k: int, breadth: float) -> Any:
    """Returns the space (m) between the sides of a neighbour and of the plans of a block at a point; below 0 they overlap."""
    return absolute(work[other + OTHER_D + k] - load(work, first + k * 3 * LANES)) - breadth


@inlined
def look_beside(work: Any, m: int, block: int, points: tuple[int, int, int, int, int]) -> None:
    """Adds neighbour m to the sums of a block. `points`: as from `approach`, which wrote how the longitudinal plan meets it."""
    shorts, alongs, leads, follows, overlaps = points
    at, first, other = NEARS + block * NEAR, MOTION + block * BLOCK, OTHERS + m * OTHER
    breadth = work[other + BREADTH]
    clear, closing, touching = load(work, at + CLEAR), load(work, at + ALONGSIDE), load(work, at + TOUCHING)
    while shorts:
        k = lowest_bit(shorts)
        shorts &= shorts - 1
        space = larger(space_at(work, first, other, k, breadth), 0.0)
        clear = clear + larger(work[MEETING + k] - space * space * (1.0 / (CLEAR_SIDE * CLEAR_SIDE)), 0.0)
    while alongs:
        k = lowest_bit(alongs)
        alongs &= alongs - 1
        away = work[other + OTHER_D + k] - load(work, first + k * 3 * LANES)
        slower = load(work, first + k * 3 * LANES + LANES) - work[other + OTHER_D1 + k]
        towards = larger(where(away > 0.0, slower, -1.0 * slower), 0.0)
        rate = towards / larger(larger(absolute(away) - breadth, 0.0), SMALLEST_SIDE_GAP)
        closing = closing + work[MEETING + TIMES + k] * (rate * rate)
    while overlaps:
        k = lowest_bit(overlaps)
        overlaps &= overlaps - 1
        touching = touching + where(space_at(work, first, other, k, breadth) < 0.0, 1.0, 0.0)
    store(work, at + CLEAR, clear)
    store(work, at + ALONGSIDE, closing)
    store(work, at + TOUCHING, touching)
    ahead, behind = load(work, at + AHEAD), load(work, at + BEHIND)
    while leads:
        k = lowest_bit(leads)
        leads &= leads - 1
        space = larger(space_at(work, first, other, k, breadth), 0.0)
        ahead = larger(ahead, work[MEETING + 2 * TIMES + k] * larger(1.0 - space / IN_PATH_FADE, 0.0))
    while follows:
        k = lowest_bit(follows)
        follows &= follows - 1
        space = larger(space_at(work, first, other, k, breadth), 0.0)
        behind = larger(behind, work[MEETING + 2 * TIMES + k] * larger(1.0 - space / IN_PATH_FADE, 0.0))
    store(work, at + AHEAD, ahead)
    store(work, at + BEHIND, behind)
