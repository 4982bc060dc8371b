"""The planner's compiled decisions: costs of candidates, and the choice among them.

One fixed order of summation, no fast-math, ties to the lowest index: equal input gives equal bits. Lateral and longitudinal plans are
sampled once each; a candidate is a pair of them, numbered longitudinal index * n_lateral + lateral index. Arrays: see `plans`; `work`: see
`terms`.

Features and weights are not negative, and rounding keeps order. So a cost whose features are not all computed yet is a bound: no candidate
above the cheapest feasible candidate so far is chosen, whatever its other features are. Blocks of eight candidates that are all above it
are left.
"""

from typing import Any

import numpy as np

from drivecal.highway import geometry
from drivecal.highway.compilation import compiled_with
from drivecal.highway.planner import cost, lanes, plans, terms
from drivecal.highway.planner.cost import SCALES
from drivecal.highway.planner.lanes import LANES, bits, load, lowest_bit, store
from drivecal.highway.planner.plans import (
    LATERAL_PLANS,
    LONGITUDINAL_PLANS,
    POINTS,
    fit,
    is_feasible,
    place_of,
    start_at,
    trace,
)
from drivecal.highway.planner.terms import (
    AHEAD,
    ALONGSIDE,
    ARRIVAL,
    ASIDE,
    BEHIND,
    BLOCKS,
    BOUNDARY,
    CENTRE,
    CLEAR,
    CONSISTENCY,
    COSTS,
    HEADINGS,
    IS_SEEN,
    LATERAL,
    LATERAL_BASE,
    LATERAL_JERK,
    LONGITUDINAL,
    LONGITUDINAL_BASE,
    LONGITUDINAL_JERK,
    NEAR,
    NEARS,
    OTHER,
    OTHERS,
    SIDES,
    TOUCHING,
    approach,
    foresee,
    look_ahead,
    look_along,
    look_aside,
    look_beside,
    on_grid,
)

compiled = compiled_with(cost, geometry, lanes, plans, terms, error_model="numpy")
inlined = compiled_with(cost, geometry, lanes, plans, terms, error_model="numpy", forceinline=True)

ALL = (1 << LANES) - 1
"""Bits of all lanes."""


@inlined
def aside_of(weights: Any, work: Any, i: int) -> Any:
    """Returns the costs of eight lateral plans, beginning with plan i."""
    at = LATERAL + i
    return (
        weights[0] * load(work, at + LATERAL_BASE * LATERAL_PLANS)
        + weights[1] * load(work, at + LATERAL_JERK * LATERAL_PLANS)
        + weights[3] * load(work, at + CENTRE * LATERAL_PLANS)
        + weights[5] * load(work, at + CONSISTENCY * LATERAL_PLANS)
        + weights[6] * load(work, at + ARRIVAL * LATERAL_PLANS)
        + weights[9] * load(work, at + BOUNDARY * LATERAL_PLANS)
    )


@inlined
def along_of(weights: Any, work: Any, j: int) -> float:
    """Returns the cost of the longitudinal plan in place j."""
    at = LONGITUDINAL + j
    along: float = (
        weights[0] * work[at + LONGITUDINAL_BASE * LONGITUDINAL_PLANS]
        + weights[1] * work[at + LONGITUDINAL_JERK * LONGITUDINAL_PLANS]
    )
    return along


@inlined
def near_of(work: Any, block: int) -> Any:
    """Returns COLLISION, CLEARANCE, LEADER, CLOSING and FOLLOWER of a block, with the neighbours so far."""
    at = NEARS + block * NEAR
    return (
        on_grid(load(work, at + TOUCHING), SCALES[15] / POINTS),
        on_grid(load(work, at + CLEAR), SCALES[7] / POINTS),
        on_grid(load(work, at + AHEAD), SCALES[8]),
        on_grid(load(work, at + ALONGSIDE), SCALES[10] / POINTS),
        on_grid(load(work, at + BEHIND), SCALES[11]),
    )


@inlined
def costs_of(weights: Any, along: float, work: Any, block: int) -> Any:
    """Returns J of a block along a longitudinal plan of cost `along`."""
    collision, clearance, leader, closing, follower = near_of(work, block)
    return (
        (along + load(work, ASIDE + block * LANES))
        + weights[0] * collision
        + weights[2] * load(work, SIDES + block * LANES)
        + weights[4] * load(work, HEADINGS + block * LANES)
        + weights[7] * clearance
        + weights[8] * leader
        + weights[10] * closing
        + weights[11] * follower
    )


@inlined
def prepare(
    road: Any, scene: Any, lateral_ends: Any, ego: Any, neighbours: Any, elapsed: float,
    memory: Any, quintics: Any, quartics: Any, work: Any,
) -> None:  # fmt: skip
    """Writes the plans, their features, and the neighbours' motion."""
    start = np.empty(8)
    start_at(ego, memory, elapsed, start)
    fit(road, lateral_ends, start, memory, quintics, quartics)
    look_aside(scene, start, memory, elapsed, quintics, work)
    look_ahead(road, start, quartics, work)
    foresee(scene, start, neighbours, work)


@inlined
def look(weights: Any, others: int, j: int, limit: float, known: int, work: Any) -> tuple[int, int]:
    """Writes the features of the candidates along a longitudinal plan, block by block until all costs of a block are above the limit.

    `others`: number of neighbours. Returns the bits of the blocks below it, whose features are complete, and `known` as of `look_along`.
    """
    along, left = along_of(weights, work, j), 0
    for block in range(BLOCKS):
        costs = along + load(work, ASIDE + block * LANES)
        if bits(costs > limit) == ALL:
            continue
        known = look_along(work, j, block, known)
        costs = costs + weights[2] * load(work, SIDES + block * LANES) + weights[4] * load(work, HEADINGS + block * LANES)
        if bits(costs > limit) == ALL:
            continue
        left |= 1 << block
        for kind in range(0, NEAR, LANES):
            store(work, NEARS + block * NEAR + kind, 0.0)
    for m in range(others):
        if not left:
            break
        if work[OTHERS + m * OTHER + IS_SEEN] == 0.0:
            continue
        points = approach(work, m, j)
        if not points[0] | points[1] | points[2] | points[3]:
            continue
        for block in range(BLOCKS):
            if left >> block & 1:
                look_beside(work, m, block, points)
                if bits(costs_of(weights, along, work, block) > limit) == ALL:
                    left &= ~(1 << block)
    return left, known


@compiled
def choose(
    road: Any, scene: Any, lateral_ends: Any, weights: Any, ego: Any, neighbours: Any,
    elapsed: float, memory: Any, quintics: Any, quartics: Any, work: Any,
) -> int:  # fmt: skip
    """Returns the candidate to drive, -1 if no cost is a number. Writes the plans.

    The cheapest feasible candidate is driven, of equal ones the first; if none is feasible, the cheapest of all: braking and steering at
    the limit is the vehicle's affair then. A negative weight allows no bounds.
    """
    prepare(
        road, scene, lateral_ends, ego, neighbours, elapsed, memory, quintics, quartics, work
    )  # fmt: skip
    for i in range(0, LATERAL_PLANS, LANES):
        store(work, ASIDE + i, aside_of(weights, work, i))
    is_bounded = True
    for weight in weights:
        is_bounded = is_bounded and weight >= 0.0
    chosen, limit, cheapest, lowest, known = -1, np.inf, -1, np.inf, 0
    for j in range(LONGITUDINAL_PLANS):
        left, known = look(weights, len(neighbours), j, limit if is_bounded else np.inf, known, work)
        along = along_of(weights, work, j)
        while left:
            block = lowest_bit(left)
            left &= left - 1
            costs = costs_of(weights, along, work, block)
            store(work, COSTS, costs)
            open_lanes = bits(costs <= limit)
            while open_lanes:
                best, candidate, cost = 0, -1, np.inf
                rest = open_lanes
                while rest:
                    lane = lowest_bit(rest)
                    rest &= rest - 1
                    place = block * LANES + lane
                    number = (j - 1 if j > 0 else LONGITUDINAL_PLANS - 1) * LATERAL_PLANS
                    number += place - 1 if place > 0 else LATERAL_PLANS - 1
                    if work[COSTS + lane] < cost or (work[COSTS + lane] == cost and number < candidate):
                        best, candidate, cost = lane, number, work[COSTS + lane]
                open_lanes &= ~(1 << best)
                if candidate < 0 or cost > limit or (cost == limit and candidate > chosen):
                    break
                if cost < lowest or (cost == lowest and candidate < cheapest):
                    cheapest, lowest = candidate, cost
                if is_feasible(road, scene, quintics, quartics, block * LANES + best, j):
                    chosen, limit = candidate, cost
    return chosen if chosen >= 0 else cheapest


@compiled
def plan(
    road: Any, scene: Any, lateral_ends: Any, weights: Any, ego: Any, neighbours: Any,
    elapsed: float, memory: Any, trajectory: Any, work: Any,
) -> int:  # fmt: skip
    """Makes a plan: writes the trajectory and the new memory. Returns the chosen candidate, -1 if no cost is a number."""
    quintics, quartics = np.empty((8, LATERAL_PLANS)), np.empty((7, LONGITUDINAL_PLANS))
    chosen = choose(
        road, scene, lateral_ends, weights, ego, neighbours, elapsed, memory, quintics, quartics, work
    )  # fmt: skip
    if chosen < 0:
        return -1
    i, j = place_of(chosen % LATERAL_PLANS, LATERAL_PLANS), place_of(chosen // LATERAL_PLANS, LONGITUDINAL_PLANS)
    trace(road, quintics, quartics, i, j, scene[7], trajectory)
    for index in range(8):
        memory[index, 0] = quintics[index, i]
    for index in range(7):
        memory[index, 1] = quartics[index, j]
    return chosen
