"""The planner's compiled decisions: costs of candidates, and the choice among them.

One fixed order of summation, no fast-math, ties to the lowest index: equal input gives equal bits, in planning and in re-evaluating
a stored planning state. Lateral and longitudinal plans are sampled once each; a candidate is a pair of them, numbered
longitudinal index * n_lateral + lateral index. Arrays: see `plans`.
"""

from typing import Any

import numpy as np

from drivecal.highway.compilation import compiled_with
from drivecal.highway.planner import plans, terms
from drivecal.highway.planner.plans import fit, is_feasible, start_at, trace
from drivecal.highway.planner.terms import (
    ARRIVAL,
    BOUNDARY,
    CENTRE,
    CLEARANCE,
    CLOSING,
    COLLISION,
    CONSISTENCY,
    FOLLOWER,
    HEADING,
    LATERAL_ACCELERATION,
    LATERAL_BASE,
    LATERAL_JERK,
    LEADER,
    LONGITUDINAL_BASE,
    LONGITUDINAL_JERK,
    evaluate,
)

compiled = compiled_with(plans, terms, error_model="numpy")


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
