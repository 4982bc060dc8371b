"""Features of all candidates of a plan, which the planner itself looks at only as far as they decide."""

from typing import Any

import numpy as np

from drivecal.domain.roads import Floats
from drivecal.highway.compilation import compiled_with
from drivecal.highway.planner import cost, kernel, lanes, plans, terms
from drivecal.highway.planner.kernel import look, near_of, prepare
from drivecal.highway.planner.lanes import LANES, store
from drivecal.highway.planner.planner import FrenetPlanner
from drivecal.highway.planner.plans import LATERAL_PLANS, LONGITUDINAL_PLANS, place_of
from drivecal.plugins.ports import Observation

compiled = compiled_with(cost, lanes, plans, terms, kernel, error_model="numpy")
COMBINED = {terms.LATERAL_ACCELERATION: 2, terms.HEADING: 4, terms.CLEARANCE: 7, terms.LEADER: 8, terms.CLOSING: 10}
COMBINED |= {terms.FOLLOWER: 11, terms.COLLISION: 0}
LATERAL_ROWS = {terms.LATERAL_BASE: 0, terms.LATERAL_JERK: 1, terms.CENTRE: 3, terms.CONSISTENCY: 5}
LATERAL_ROWS |= {terms.ARRIVAL: 6, terms.BOUNDARY: 9}
LONGITUDINAL_ROWS = {terms.LONGITUDINAL_BASE: 0, terms.LONGITUDINAL_JERK: 1}


@compiled
def consider(
    road: Any, scene: Any, lateral_ends: Any, ego: Any, neighbours: Any, elapsed: float,
    memory: Any, work: Any, lateral: Any, longitudinal: Any, combined: Any,
) -> None:  # fmt: skip
    """Writes the features of all candidates, and to `work`."""
    quintics, quartics = np.empty((8, LATERAL_PLANS)), np.empty((7, LONGITUDINAL_PLANS))
    prepare(
        road, scene, lateral_ends, ego, neighbours, elapsed, memory, quintics, quartics, work
    )  # fmt: skip
    for i in range(LATERAL_PLANS):
        work[terms.ASIDE + i] = 0.0
        for row in range(6):
            lateral[row, i] = work[terms.LATERAL + row * LATERAL_PLANS + place_of(i, LATERAL_PLANS)]
    weights, known = np.zeros(12), 0
    for j in range(LONGITUDINAL_PLANS):
        place = place_of(j, LONGITUDINAL_PLANS)
        for row in range(2):
            longitudinal[row, j] = work[terms.LONGITUDINAL + row * LONGITUDINAL_PLANS + place]
        _, known = look(weights, len(neighbours), place, np.inf, known, work)
        for block in range(terms.BLOCKS):
            near, at = near_of(work, block), terms.NEARS + block * terms.NEAR
            store(work, at + terms.TOUCHING, near[0])
            store(work, at + terms.CLEAR, near[1])
            store(work, at + terms.AHEAD, near[2])
            store(work, at + terms.ALONGSIDE, near[3])
            store(work, at + terms.BEHIND, near[4])
        for i in range(LATERAL_PLANS):
            column = place_of(i, LATERAL_PLANS)
            at = terms.NEARS + column // LANES * terms.NEAR + column % LANES
            combined[terms.COLLISION, j, i] = work[at + terms.TOUCHING]
            combined[terms.LATERAL_ACCELERATION, j, i] = work[terms.SIDES + column]
            combined[terms.HEADING, j, i] = work[terms.HEADINGS + column]
            combined[terms.CLEARANCE, j, i] = work[at + terms.CLEAR]
            combined[terms.LEADER, j, i] = work[at + terms.AHEAD]
            combined[terms.CLOSING, j, i] = work[at + terms.ALONGSIDE]
            combined[terms.FOLLOWER, j, i] = work[at + terms.BEHIND]


def considered(planner: FrenetPlanner, observation: Observation) -> tuple[Floats, Floats, Floats]:
    """Features of lateral plans (6, n_lateral), of longitudinal ones (2, n_longitudinal), and of pairs (7, n_longitudinal, n_lateral)."""
    lateral, longitudinal = np.zeros((6, LATERAL_PLANS)), np.zeros((2, LONGITUDINAL_PLANS))
    combined = np.zeros((7, LONGITUDINAL_PLANS, LATERAL_PLANS))
    wanted = planner._wanted(observation.time)
    planner._make_room(observation)
    consider(
        planner._road, planner._scenes[wanted], planner._lateral_ends[wanted], observation.ego, observation.neighbours,
        observation.time - planner._planned_at, planner._memory, planner._work, lateral, longitudinal, combined,
    )  # fmt: skip
    return lateral, longitudinal, combined


def features_of(planner: FrenetPlanner, observation: Observation) -> Floats:
    """Features of all candidates, shape (n_candidates, 12): base, then the terms P1..P11. Plans nothing."""
    lateral, longitudinal, combined = considered(planner, observation)
    features = np.zeros((LONGITUDINAL_PLANS, LATERAL_PLANS, 12))
    for row, column in LONGITUDINAL_ROWS.items():
        features[:, :, column] += longitudinal[row][:, None]
    for row, column in LATERAL_ROWS.items():
        features[:, :, column] += lateral[row]
    for row, column in COMBINED.items():
        features[:, :, column] += combined[row]
    return features.reshape(-1, 12)
