"""The planner of one scenario: prepares the kernel's arrays once, then calls the kernel once per plan."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.roads import reference_line
from drivecal.domain.scenarios import Scenario
from drivecal.highway.certification.kernels import NONE, contenders
from drivecal.highway.certification.nodes import Nodes
from drivecal.highway.planner import deciding, kernel, neighbours, plans, terms
from drivecal.highway.planner.candidates import desired_speeds, lateral_ends, longitudinal_ends
from drivecal.highway.planner.cost import scales, weights
from drivecal.highway.planner.scratch import size_for
from drivecal.highway.planner.spaces import HIGHWAY
from drivecal.plugins.ports import Observation

Floats = npt.NDArray[np.float64]

PERIOD = 0.2
"""Time between two plans, s."""
TRAJECTORY = 2.4
"""Length of the trajectory for the vehicle, s: the period and its controller's preview."""
CURB = 0.1
"""Distance that every candidate keeps from the road's edges, m."""
LOWEST = weights([float(parameter.lower) for parameter in HIGHWAY])
HIGHEST = weights([float(parameter.upper) for parameter in HIGHWAY])
"""Limits of the weights that a certificate covers, shape (12,): those of the parameters of Table 6."""
LEADERS = 48
"""Number of good candidates that decide, by comparison, whether another candidate could ever win."""
MARGIN = 1e-6
"""Margin of cost comparisons: a thousand times the rounding errors."""

_COMBINED = {terms.LATERAL_ACCELERATION: 2, terms.HEADING: 4, terms.CLEARANCE: 7, terms.LEADER: 8, terms.CLOSING: 10}
_COMBINED |= {terms.FOLLOWER: 11, terms.COLLISION: 0}
_LATERAL = {terms.LATERAL_BASE: 0, terms.LATERAL_JERK: 1, terms.CENTRE: 3, terms.CONSISTENCY: 5}
_LATERAL |= {terms.ARRIVAL: 6, terms.BOUNDARY: 9}
_LONGITUDINAL = {terms.LONGITUDINAL_BASE: 0, terms.LONGITUDINAL_JERK: 1}


class FrenetPlanner:
    """Chooses the candidate of lowest cost every 0.2 s (Werling et al. 2010).

    A plan starts on the previous plan while the vehicle follows it closely (`plans.LARGEST_DEVIATIONS`), which gives a smooth path; else
    it starts at the vehicle. The features of the last plan stay readable: J = features @ weights.
    """

    period = PERIOD
    grid = 1.0 / terms.FEATURE_GRID
    n_values = len(deciding.TERM)

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
        self._road = np.ascontiguousarray(np.column_stack([line, speeds, np.cos(heading), np.sin(heading), *changes]))
        space = 0.5 * ego.width + CURB
        self._scenes, self._lateral_ends = [], []
        for wanted, other in ((task.start_lane, task.target_lane), (task.target_lane, task.start_lane)):
            geometry = [wanted * road.lane_width, road.lane_width, road.lanes - 1, 0.5 * ego.length, 0.5 * ego.width]
            self._scenes.append(np.array([*geometry, road.right_edge + space, road.left_edge - space, scenario.step]))
            self._lateral_ends.append(lateral_ends(road.lane_width, wanted, other))
        self._change_after = task.lane_change_after
        self._longitudinal_ends = longitudinal_ends()
        self._scales = scales()
        self._rows = round(TRAJECTORY / scenario.step) + 1

        n_lateral, n_longitudinal = self._lateral_ends[0].shape[1], self._longitudinal_ends.shape[1]
        self.n_lateral, self.n_candidates = n_lateral, n_lateral * n_longitudinal
        self._lateral = np.zeros((6, n_lateral))
        self._longitudinal = np.zeros((2, n_longitudinal))
        self._combined = np.zeros((7, n_longitudinal, n_lateral))
        self._by_term = np.zeros((self.n_candidates, 12))
        self.infeasible: npt.NDArray[np.bool_] = np.zeros(self.n_candidates, dtype=np.bool_)
        """Candidates of the last plan that are cheaper than the chosen candidate but cannot be driven, shape (n_candidates,)."""
        self.chosen = -1
        """The candidate of the last plan that is driven: index = longitudinal index * n_lateral + lateral index."""
        self._memory = np.zeros((8, 2))
        self.state = np.zeros(24 + 6 * len(scenario.traffic))
        """See `drivecal.plugins.ports.CertifiablePlanner`: as from `kernel.plan`."""
        self._decided = self.state
        """State of the last plan or decision."""
        self._work = scratch_for(self.state)
        self._weights = np.zeros(12)
        self._asked: tuple[tuple[float, ...], Floats, bool] = ((), self._weights, False)
        """The last parameters, their weights, and whether a certificate may cover them."""
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
        return self._plan(observation, -1)

    def repeat(self, observation: Observation, chosen: int) -> Floats:
        """See `drivecal.plugins.ports.CertifiablePlanner`."""
        return self._plan(observation, chosen)

    def _plan(self, observation: Observation, known: int) -> Floats:
        trajectory = np.empty((self._rows, 7))
        wanted = self._wanted(observation.time)
        if len(self.state) != 24 + observation.neighbours.size:
            self.state = np.zeros(24 + observation.neighbours.size)
        self._decided = self.state
        self._make_room(self.state)
        self.chosen = kernel.plan(
            self._road,
            self._scenes[wanted],
            self._scales,
            self._lateral_ends[wanted],
            self._longitudinal_ends,
            self._weights,
            observation.ego,
            observation.neighbours,
            observation.time - self._planned_at,
            self._memory,
            self.infeasible,
            trajectory,
            self.state,
            self._work,
            known,
        )
        if self.chosen < 0:
            raise ValueError(f"no plan has a cost: the observation at {observation.time} s must hold finite numbers only")
        self._planned_at = observation.time
        return trajectory

    def features(self, observation: Observation | None = None) -> Floats:
        """Returns the features of all candidates of the last plan, or of a plan from this observation, shape (n_candidates, 12): base, then
        the terms P1..P11. Plans nothing.

        `plan` takes the candidate of lowest `features @ cost.weights(parameters)` that is feasible.
        """
        if observation is None:
            self._consider(self._decided)
        else:
            rows = [[self._scenes[self._wanted(observation.time)][0], observation.time - self._planned_at], observation.ego]
            self._consider(np.concatenate([*rows, self._memory.ravel(), observation.neighbours.ravel()]))
        n_longitudinal, n_lateral = self._combined.shape[1:]
        features = np.zeros((n_longitudinal, n_lateral, 12))
        for row, column in _LONGITUDINAL.items():
            features[:, :, column] += self._longitudinal[row][:, None]
        for row, column in _LATERAL.items():
            features[:, :, column] += self._lateral[row]
        for row, column in _COMBINED.items():
            features[:, :, column] += self._combined[row]
        return features.reshape(-1, 12)

    def decide(self, state: Floats, parameters: Sequence[float]) -> int:
        """See `drivecal.plugins.ports.CertifiablePlanner`."""
        wanted = self._wanted_in(state)
        self._decided = state
        self._make_room(state)
        self.chosen = kernel.decide(
            self._road,
            self._scenes[wanted],
            self._scales,
            self._lateral_ends[wanted],
            self._longitudinal_ends,
            self._weights_of(parameters)[0],
            state,
            self.infeasible,
            self._work,
        )
        return self.chosen

    def contenders(self, infeasible: npt.NDArray[np.bool_]) -> tuple[npt.NDArray[np.int64], Floats]:
        """See `drivecal.plugins.ports.CertifiablePlanner`; with the parameters of the built-in spaces."""
        self._consider(self._decided)
        deciding.by_term(self._lateral, self._longitudinal, self._combined, self._by_term)
        rivals = contenders(self._by_term, LOWEST, HIGHEST, infeasible, self.chosen, LEADERS, MARGIN)
        values = np.empty((len(rivals), self.n_values))
        deciding.values_of(self._lateral, self._longitudinal, self._combined, rivals, values)
        return rivals, values

    def walk(self, nodes: Nodes, parameters: Sequence[float], node: int) -> int:
        """See `drivecal.plugins.ports.CertifiablePlanner`."""
        weights_of, allowed = self._weights_of(parameters)
        if not allowed:
            return NONE
        return deciding.walk(
            weights_of,
            node,
            nodes.grid,
            nodes.packed,
            nodes.candidate,
            nodes.row_start,
            nodes.row_count,
            nodes.beside_start,
            nodes.beside_count,
            nodes.places,
            nodes.values,
            nodes.first_child,
            nodes.next_sibling,
            nodes.decision,
        )

    def _consider(self, state: Floats) -> None:
        """Computes the features of all candidates in a state."""
        wanted = self._wanted_in(state)
        self._make_room(state)
        kernel.consider(
            self._road,
            self._scenes[wanted],
            self._scales,
            self._lateral_ends[wanted],
            self._longitudinal_ends,
            state[2:8],
            state[24:].reshape(-1, 6),
            state[1],
            state[8:24].reshape(8, 2),
            self._work,
            self._lateral,
            self._longitudinal,
            self._combined,
        )

    def _make_room(self, state: Floats) -> None:
        """Lets the scratch memory hold the neighbours of a state."""
        if len(self._work) < size_for((len(state) - 24) // 6):
            self._work = scratch_for(state)

    def _weights_of(self, parameters: Sequence[float]) -> tuple[Floats, bool]:
        asked = tuple(parameters)
        if asked != self._asked[0]:  # many questions about the same set follow each other
            values = weights(parameters)
            self._asked = asked, values, bool(((values >= LOWEST) & (values <= HIGHEST)).all())
        return self._asked[1:]

    def _wanted(self, time: float) -> int:
        """Returns 0 before the lane change, 1 after it."""
        return 1 if time >= self._change_after else 0

    def _wanted_in(self, state: Floats) -> int:
        return 0 if state[0] == self._scenes[0][0] else 1


def scratch_for(state: Floats) -> Floats:
    """Returns scratch memory for plans with as many neighbours as a state has."""
    work = np.zeros(size_for((len(state) - 24) // 6))
    neighbours.prepare(work)
    return work
