"""Compiled features of candidates that meet other vehicles: P7, P8, P10, P11 and the collision in the base.

Sums run over the neighbours, and over the points in time of each. What would add nothing but zeros is left out: that changes no bit.
Arrays: see `plans`; `work`: see `scratch`.
"""

from typing import Any

import numpy as np

from drivecal.highway.compilation import compiled_with
from drivecal.highway.planner import lanes, plans, scratch, terms
from drivecal.highway.planner.lanes import LANES, absolute, bits, larger, load, lowest_bit, smaller, store, where
from drivecal.highway.planner.plans import INTERVAL, LONGITUDINAL_PLANS, POINTS
from drivecal.highway.planner.scratch import (
    AHEAD,
    ALONGSIDE,
    BEHIND,
    BLOCK,
    BREADTH,
    CLEAR,
    ENOUGH,
    EVERY,
    FADING,
    FOLLOWING,
    IS_SEEN,
    LEFTMOST,
    LENGTH,
    MEETING,
    MOTION,
    NEAR,
    NEARS,
    OTHER,
    OTHER_D,
    OTHER_D1,
    OTHER_S,
    OTHER_S1,
    OTHERS,
    RIGHTMOST,
    ROW,
    ROWS,
    S1,
    SPACE,
    TIME,
    TIMES,
    TOUCHING,
    S,
)
from drivecal.highway.planner.terms import (
    ALONGSIDE_TIME,
    CLEAR_SIDE,
    CLEAR_TIME,
    DRIFT_TIME,
    IN_PATH_FADE,
    LARGEST_URGENCY,
    SHORTEST_CLEARANCE,
    SLOWEST,
    SMALLEST_GAP,
    SMALLEST_SIDE_GAP,
)

compiled = compiled_with(lanes, plans, scratch, terms, error_model="numpy")
inlined = compiled_with(lanes, plans, scratch, terms, error_model="numpy", forceinline=True)


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
