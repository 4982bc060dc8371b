"""The planner's decision from the features of all candidates, in the planner's order of summation, without any bound."""

import numpy as np
import numpy.typing as npt
from tests.unit.highway.planner.considering import considered

from drivecal.domain.roads import Floats
from drivecal.highway.planner import plans
from drivecal.highway.planner.planner import FrenetPlanner
from drivecal.plugins.ports import Observation


def costs_of(lateral: Floats, longitudinal: Floats, combined: Floats, w: Floats) -> Floats:
    """Returns J of all candidates, shape (n_longitudinal, n_lateral); features: as from `considered`."""
    along = w[0] * longitudinal[0] + w[1] * longitudinal[1]
    cost = w[0] * lateral[0] + w[1] * lateral[1] + w[3] * lateral[2] + w[5] * lateral[3] + w[6] * lateral[4] + w[9] * lateral[5]
    costs: Floats = along[:, None] + cost
    for row, column in enumerate((0, 2, 4, 7, 8, 10, 11)):
        costs = costs + w[column] * combined[row]
    return costs


def cheapest(costs: Floats, infeasible: npt.NDArray[np.bool_]) -> int:
    """Returns the first of the cheapest candidates not known to be infeasible; -1 if there is none."""
    flat = np.where(infeasible | ~(costs.ravel() < np.inf), np.inf, costs.ravel())
    return int(np.argmin(flat)) if flat.min() < np.inf else -1


def decide(planner: FrenetPlanner, observation: Observation, weights: Floats) -> tuple[int, npt.NDArray[np.bool_]]:
    """Returns the candidate that `plan` is to take next, and the cheaper candidates that are infeasible."""
    costs = costs_of(*considered(planner, observation), weights)
    wanted, memory, start = planner._wanted(observation.time), planner._memory.copy(), np.empty(8)
    plans.start_at(observation.ego, memory, observation.time - planner._planned_at, start)
    quintics, quartics = np.empty((8, plans.LATERAL_PLANS)), np.empty((7, plans.LONGITUDINAL_PLANS))
    plans.fit(planner._road, planner._lateral_ends[wanted], start, memory, quintics, quartics)
    infeasible = np.zeros(costs.size, np.bool_)
    first = cheapest(costs, infeasible)
    candidate = first
    while candidate >= 0:
        column = plans.place_of(candidate % plans.LATERAL_PLANS, plans.LATERAL_PLANS)
        row = plans.place_of(candidate // plans.LATERAL_PLANS, plans.LONGITUDINAL_PLANS)
        if plans.is_feasible(planner._road, planner._scenes[wanted], quintics, quartics, column, row):
            return candidate, infeasible
        infeasible[candidate] = True
        candidate = cheapest(costs, infeasible)
    return first, infeasible
