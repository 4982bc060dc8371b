"""The planner of one scenario: prepares the kernel's arrays once, then calls the kernel once per plan."""

from collections.abc import Sequence

import numpy as np

from drivecal.bundles.highway import Scenario
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.roads import reference_line
from drivecal.highway.planner import kernel, plans, terms
from drivecal.highway.planner.cost import weights
from drivecal.highway.planner.plans import desired_speeds, lateral_ends
from drivecal.highway.planner.terms import size_for
from drivecal.plugins.ports import Floats, Observation

PERIOD = 0.2
"""Time between two plans, s."""
TRAJECTORY = 2.4
"""Length of the trajectory for the vehicle, s: the period and its controller's preview."""
CURB = 0.1
"""Distance that every candidate keeps from the road's edges, m."""


class FrenetPlanner:
    """Chooses the candidate of lowest cost every 0.2 s (Werling et al. 2010).

    A plan starts on the previous plan while the vehicle follows it closely (`plans.LARGEST_DEVIATIONS`), which gives a smooth path; else
    it starts at the vehicle.
    """

    period = PERIOD

    def __init__(self, scenario: Scenario) -> None:
        """Raises InvalidInputError if the scenario's step does not divide the planning period."""
        per_plan = round(PERIOD / scenario.step)
        if per_plan < 1 or abs(per_plan * scenario.step - PERIOD) > 1e-9:
            raise InvalidInputError(
                Problem(
                    "step", f"{scenario.step} s does not divide the planning period", f"give {PERIOD} s over a whole number"
                )
            )
        road, task, ego = scenario.road, scenario.task, scenario.ego
        line = reference_line(road, plans.SPACING)
        s, heading, curvature = line[:, 0], line[:, 3], line[:, 4]
        speeds = desired_speeds(task, s)
        changes = [np.diff(column, append=column[-1]) / plans.SPACING for column in (curvature, speeds)]
        self._road = np.ascontiguousarray(np.column_stack([line, np.cos(heading), np.sin(heading), speeds, *changes]))
        space = 0.5 * ego.width + CURB
        self._scenes, self._lateral_ends = [], []
        for wanted, other in ((task.start_lane, task.target_lane), (task.target_lane, task.start_lane)):
            geometry = [wanted * road.lane_width, road.lane_width, road.lanes - 1, 0.5 * ego.length, 0.5 * ego.width]
            self._scenes.append(np.array([*geometry, road.right_edge + space, road.left_edge - space, scenario.step]))
            self._lateral_ends.append(lateral_ends(road.lane_width, wanted, other))
        self._change_after = task.lane_change_after
        self._rows = round(TRAJECTORY / scenario.step) + 1

        self.chosen = -1
        """The candidate of the last plan that is driven: index = longitudinal index * LATERAL_PLANS + lateral index."""
        self._memory = np.zeros((8, 2))
        self._work = scratch_for(len(scenario.traffic))
        self._weights = np.zeros(12)
        self._planned_at = 0.0

    def reset(self, parameters: Sequence[float]) -> None:
        """Starts a new run with the values of P1..P11."""
        self._weights = weights(parameters)
        self._memory = np.zeros((8, 2))
        self._planned_at = 0.0
        self.chosen = -1

    def plan(self, observation: Observation) -> Floats:
        """Returns the trajectory to follow, shape (25, 7) at a step of 0.1 s: t, x, y, heading, curvature, speed, acceleration.

        Raises ValueError if the observation holds numbers that are not finite.
        """
        trajectory = np.empty((self._rows, 7))
        wanted = self._wanted(observation.time)
        self._make_room(observation)
        self.chosen = kernel.plan(
            self._road,
            self._scenes[wanted],
            self._lateral_ends[wanted],
            self._weights,
            observation.ego,
            observation.neighbours,
            observation.time - self._planned_at,
            self._memory,
            trajectory,
            self._work,
        )
        if self.chosen < 0:
            raise ValueError(f"no plan has a cost: the observation at {observation.time} s must hold finite numbers only")
        self._planned_at = observation.time
        return trajectory

    def _make_room(self, observation: Observation) -> None:
        """Lets the scratch memory hold the neighbours of an observation."""
        if len(self._work) < size_for(len(observation.neighbours)):
            self._work = scratch_for(len(observation.neighbours))

    def _wanted(self, time: float) -> int:
        """Returns 0 before the lane change, 1 after it."""
        return 1 if time >= self._change_after else 0


def scratch_for(others: int) -> Floats:
    """Returns scratch memory for plans with this number of other vehicles."""
    work = np.zeros(size_for(others))
    terms.prepare(work)
    return work
