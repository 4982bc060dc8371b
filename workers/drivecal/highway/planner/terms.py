"""Compiled features of candidates, by the terms of the cost. Inner loops run over lateral plans, side by side in memory, so that they
vectorise. Arrays: see `plans`."""

from typing import Any

import numpy as np

from drivecal.highway.compilation import compiled_with
from drivecal.highway.planner import plans
from drivecal.highway.planner.plans import INTERVAL, POINTS, lateral_at, road_ahead

compiled = compiled_with(plans, error_model="numpy")

WIDTH = 32
"""Lateral plans, at most: rows of them in one array, at constant distances, need no checks whether they overlap before they are computed
with vector instructions. Rows are computed as a whole, what is beside the plans is never looked at: four vectors of 512 bits and no rest
take half the time of 24 plans alone. (Loops over a constant number would be unrolled instead.)"""
DEPTH = 16
"""Longitudinal plans, at most, likewise."""
TOUCHING, CLEAR, AHEAD, ALONGSIDE, BEHIND = (row * WIDTH for row in range(5))
NEAR = 5 * WIDTH
"""Features of the neighbours for the candidates of one longitudinal plan, unscaled: rows of COLLISION, CLEARANCE, LEADER, CLOSING,
FOLLOWER."""
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


@compiled
def on_grid(raw: float, scale: float) -> float:
    """The feature of a raw quantity: scaled, then rounded to the grid of features."""
    return float(np.floor(raw * (scale * FEATURE_GRID) + 0.5) * (1.0 / FEATURE_GRID))


@compiled
def evaluate(
    road: Any, scene: Any, scales: Any, start: Any, neighbours: Any, memory: Any, elapsed: float, quintics: Any, quartics: Any,
    lateral: Any, longitudinal: Any, combined: Any,
) -> None:  # fmt: skip
    """Writes the features of all candidates, of `WIDTH` lateral and `DEPTH` longitudinal plans at most."""
    n_longitudinal = quartics.shape[1]
    motion = np.empty(POINTS * 3 * WIDTH)
    width, depth = max(quintics.shape[1], WIDTH), max(n_longitudinal, DEPTH)
    look_aside(scene, scales, start, memory, elapsed, quintics, lateral, motion, width)
    s, s1 = np.zeros((POINTS, DEPTH)), np.zeros((POINTS, DEPTH))
    look_ahead(road, scales, start, quartics, motion, s, s1, longitudinal, combined, width)
    near = np.zeros(n_longitudinal * NEAR)
    moments, aside, by_plan = np.empty((POINTS, 6)), np.empty(5 * WIDTH), np.empty(5 * DEPTH)
    survey(motion, s, s1, moments, quintics.shape[1], n_longitudinal)
    for m in range(len(neighbours)):
        look_at(scene, start, neighbours[m], motion, s, s1, moments, aside, by_plan, near, width, depth, n_longitudinal)
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
    """Writes the features of longitudinal plans, s and s' at each point, shape (POINTS, DEPTH), and LATERAL_ACCELERATION and
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
def survey(motion: Any, s: Any, s1: Any, moments: Any, n_lateral: int, n_longitudinal: int) -> None:
    """Writes, for each point in time, the remaining share of a neighbour's lateral speed and the bounds of all
    plans: least and largest d, least and largest s, largest s'; shape (POINTS, 6)."""
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
    scene: Any, start: Any, neighbour: Any, motion: Any, s: Any, s1: Any, moments: Any, aside: Any, by_plan: Any, near: Any,
    width: int, depth: int, n_longitudinal: int,
) -> None:  # fmt: skip
    """Adds the features of a neighbour for each candidate to `near`, shape (n_longitudinal * NEAR,). `moments`: as from `survey`.

    Scratch: `aside`, rows of `WIDTH`: space between the sides, touching, squared ratio of space to wanted space, closing rate squared, how
    far in the path; `by_plan`, rows of `DEPTH`: shortfall of clear space beside, how far alongside, urgency, gap, how far ahead, of
    longitudinal plans; the first three mean nothing up to 0. A vehicle that follows in the lane where the ego vehicle is already means
    nothing: keeping its distance is its own affair. What would add nothing but zeros is left out: that changes no bit.
    """
    if neighbour[0] < start[0] and abs(neighbour[1] - start[3]) < 0.5 * scene[1]:
        return
    length = scene[3] + 0.5 * neighbour[4]
    breadth = scene[4] + 0.5 * neighbour[5]
    other_s1 = neighbour[2]
    following = 1.0 if abs(neighbour[1] - scene[0]) < 0.5 * scene[1] else 0.0
    for k in range(POINTS):
        fading = moments[k, 0]
        other_d = neighbour[1] + neighbour[3] * DRIFT_TIME * (1.0 - fading)
        other_d1 = neighbour[3] * fading
        other_s = neighbour[0] + other_s1 * ((k + 0.5) * INTERVAL)
        # Rounding keeps order: a bound of the nearest, foremost or fastest plan holds for the others.
        space = max(moments[k, 1] - other_d, other_d - moments[k, 2]) - breadth
        out_of_path = space >= IN_PATH_FADE
        fastest = moments[k, 5]
        if out_of_path:
            gap = max(other_s - moments[k, 4], moments[k, 3] - other_s) - length
            if gap >= max(CLEAR_TIME * fastest, SHORTEST_CLEARANCE, ALONGSIDE_TIME * max(fastest, SLOWEST)):
                continue
        enough = space * space * (1.0 / (CLEAR_SIDE * CLEAR_SIDE)) if space > 0.0 else 0.0
        for j in range(depth):
            ahead, speed = other_s - s[k, j], s1[k, j]
            gap = max(abs(ahead) - length, 0.0)
            ratio = gap / max(CLEAR_TIME * speed, SHORTEST_CLEARANCE)
            approach = speed - other_s1 if ahead > 0.0 else other_s1 - speed
            rate = approach / max(gap, SMALLEST_GAP)
            urgency = min(rate * rate, LARGEST_URGENCY)
            urgency = urgency if approach > 0.0 else 0.0
            by_plan[j] = 1.0 - ratio * ratio
            by_plan[DEPTH + j] = 1.0 - gap / (ALONGSIDE_TIME * max(speed, SLOWEST))
            by_plan[2 * DEPTH + j] = urgency if ahead > 0.0 else urgency * following
            by_plan[3 * DEPTH + j] = gap
            by_plan[4 * DEPTH + j] = ahead
        row = 3 * WIDTH * k
        looked = in_path = closing = False
        for j in range(n_longitudinal):
            shortfall, alongside, urgency = by_plan[j], by_plan[DEPTH + j], by_plan[2 * DEPTH + j]
            is_short, is_alongside = shortfall > enough, alongside > 0.0
            is_urgent = urgency > 0.0 and not out_of_path
            if not (is_short or is_alongside or is_urgent):
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
            if is_short:
                for i in range(width):
                    missing = shortfall - aside[2 * WIDTH + i]
                    near[at + CLEAR + i] += max(missing, 0.0)
            if is_alongside:
                if not closing:
                    closing = True
                    for i in range(width):
                        slower = motion[row + WIDTH + i] - other_d1
                        towards = slower if other_d - motion[row + i] > 0.0 else -slower
                        towards = max(towards, 0.0)
                        rate = towards / max(aside[i], SMALLEST_SIDE_GAP)
                        aside[3 * WIDTH + i] = rate * rate
                for i in range(width):
                    near[at + ALONGSIDE + i] += alongside * aside[3 * WIDTH + i]
                if by_plan[3 * DEPTH + j] == 0.0 and not space >= 0.0:
                    for i in range(width):
                        near[at + TOUCHING + i] += aside[WIDTH + i]
            if is_urgent:
                if not in_path:
                    in_path = True
                    for i in range(width):
                        path = 1.0 - aside[i] / IN_PATH_FADE
                        aside[4 * WIDTH + i] = max(path, 0.0)
                side = at + (AHEAD if by_plan[4 * DEPTH + j] > 0.0 else BEHIND)
                for i in range(width):
                    value = urgency * aside[4 * WIDTH + i]
                    near[side + i] = max(near[side + i], value)
