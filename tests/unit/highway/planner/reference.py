"""The planner written out once more, candidate by candidate and point by point in plain Python: the oracle of the compiled one.

It shares the constants with it (candidate ends, magnitudes), not a formula: polynomials come from their boundary conditions by linear
algebra, the Cartesian motion of a candidate from differences of its path.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import atan2, exp, hypot, pi

import numpy as np
from numpy.polynomial import Polynomial
from tests.support.roads import to_cartesian

from drivecal.bundles.highway import Scenario
from drivecal.domain.roads import Floats, reference_line
from drivecal.highway.planner import cost, plans, terms
from drivecal.highway.planner.planner import CURB
from drivecal.plugins.ports import Observation

TIMES = [(k + 0.5) * plans.INTERVAL for k in range(plans.POINTS)]
DIFFERENCE = 1e-4


@dataclass(frozen=True)
class Curve:
    """A polynomial in time / horizon that goes on with its end speed (m/s) after `horizon` seconds."""

    polynomial: Polynomial
    horizon: float
    end_speed: float = 0.0

    def __call__(self, t: float, order: int = 0) -> float:
        """The value (order 0) or a derivative at time t."""
        if t >= self.horizon:
            goes_on = [self.polynomial(1.0) + (t - self.horizon) * self.end_speed, self.end_speed, 0.0, 0.0]
            return float(goes_on[order])
        return float(self.polynomial.deriv(order)(t / self.horizon) / self.horizon**order)


def curve(start: Sequence[float], end: Sequence[tuple[int, float]], horizon: float, end_speed: float = 0.0) -> Curve:
    """The polynomial with the derivatives `start` (order 0, 1, 2) now and `end` (order, value) at the horizon."""
    size = 3 + len(end)
    rows, values = [], []
    for order, value in enumerate(start):
        rows.append(np.array([float(power == order) * np.prod(np.arange(1, order + 1)) for power in range(size)]))
        values.append(value * horizon**order)
    for order, value in end:
        rows.append(
            np.array([np.prod(np.arange(power - order + 1, power + 1)) * float(power >= order) for power in range(size)])
        )
        values.append(value * horizon**order)
    return Curve(Polynomial(np.linalg.solve(np.array(rows), np.array(values))), horizon, end_speed)


class ReferencePlanner:
    """As `planner.FrenetPlanner`: reset, plan; what it considered stays in `raw`, `features`, `costs`."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.line = reference_line(scenario.road)
        self.desired = plans.desired_speeds(scenario.task, self.line[:, 0])

    def reset(self, parameters: Sequence[float]) -> None:
        p1, *others = parameters
        self.weights = [1.0, 10 ** (p1 / 10)] + [p / term.middle for p, term in zip(others, cost.TERMS[1:], strict=True)]
        self.before: tuple[float, Curve, Curve] | None = None

    def plan(self, observation: Observation) -> int:
        """The chosen candidate."""
        self.start = self.where_to_start(observation)
        self.fit(observation)
        self.raw = np.array([self.candidate(i, j, observation) for j in range(len(self.along)) for i in range(len(self.aside))])
        self.features = np.floor(self.raw * terms.FEATURE_GRID + 0.5) / terms.FEATURE_GRID
        self.costs = [sum(w * c for w, c in zip(self.weights, row, strict=True)) for row in self.features]
        order = sorted(range(len(self.costs)), key=lambda index: (self.costs[index], index))
        feasible = (index for index in order if self.is_feasible(index % len(self.aside), index // len(self.aside)))
        cheapest = next(feasible, None)
        self.infeasible = set(order if cheapest is None else order[: order.index(cheapest)])
        chosen = order[0] if cheapest is None else cheapest
        self.before = (observation.time, self.along[chosen // len(self.aside)], self.aside[chosen % len(self.aside)])
        return chosen

    def where_to_start(self, observation: Observation) -> list[float]:
        measured = [float(value) for value in observation.ego]
        self.rest_aside = self.rest_ahead = 0.0
        if self.before is None:
            return measured
        since, along, aside = self.before
        elapsed = observation.time - since
        planned = [along(elapsed, order) for order in range(3)] + [aside(elapsed, order) for order in range(3)]
        deviations = [abs(measured[index] - planned[index]) for index in (0, 1, 3, 4)]
        if any(deviation > allowed for deviation, allowed in zip(deviations, plans.LARGEST_DEVIATIONS, strict=True)):
            return measured
        self.rest_aside, self.rest_ahead = aside.horizon - elapsed, along.horizon - elapsed
        return planned

    def fit(self, observation: Observation) -> None:
        road, task = self.scenario.road, self.scenario.task
        lanes = (task.start_lane, task.target_lane)
        wanted, other = lanes if observation.time < task.lane_change_after else lanes[::-1]
        self.target = wanted * road.lane_width
        ends = list(plans.lateral_ends(road.lane_width, wanted, other).T)
        self.goes_on_aside = self.before is not None and bool(self.rest_aside >= plans.SHORTEST_REST)
        self.goes_on_ahead = self.before is not None and bool(self.rest_ahead >= plans.SHORTEST_REST)
        if self.before is not None and self.goes_on_aside:
            ends[-1] = np.array([self.before[2](1e9), self.rest_aside])
        self.aside = [curve(self.start[3:], [(0, end), (1, 0.0), (2, 0.0)], horizon) for end, horizon in ends]
        s, speed = self.start[:2]
        self.limit = self.desired_at(s)
        self.along = []
        for difference, horizon in plans.LONGITUDINAL_ENDS.T:
            first_guess = min(self.limit, self.desired_at(s + speed * horizon))
            desired = min(self.limit, self.desired_at(s + 0.5 * (speed + first_guess) * horizon))
            end_speed = max(desired + difference, 0.0)
            self.along.append(curve(self.start[:3], [(1, end_speed), (2, 0.0)], horizon, end_speed))
        if self.before is not None and self.goes_on_ahead:
            end_speed = self.before[1].end_speed
            self.along[-1] = curve(self.start[:3], [(1, end_speed), (2, 0.0)], self.rest_ahead, end_speed)

        self.samples_aside = [[tuple(plan(t, order) for order in range(4)) for t in TIMES] for plan in self.aside]
        self.samples_along = [[tuple(plan(t, order) for order in range(4)) for t in TIMES] for plan in self.along]
        if self.before is not None:
            self.planned = [self.before[2](t + observation.time - self.before[0]) for t in TIMES]

    @cache  # noqa: B019  # a planner lives as long as a test
    def desired_at(self, s: float) -> float:
        return float(np.interp(s, self.line[:, 0], self.desired))

    @cache  # noqa: B019  # a planner lives as long as a test
    def curvature_at(self, s: float) -> float:
        return float(np.interp(s, self.line[:, 0], self.line[:, 4], left=0.0, right=0.0))

    def candidate(self, i: int, j: int, observation: Observation) -> list[float]:
        """The twelve features of one candidate, not rounded."""
        aside, along = self.samples_aside[i], self.samples_along[j]
        sums = [0.0] * 12
        error = acceleration = 0.0
        lane_width, width = self.scenario.road.lane_width, self.scenario.ego.width
        for k, ((d, d1, d2, _), (s, s1, s2, _)) in enumerate(zip(aside, along, strict=True)):
            sums[2] += (d2 + s1**2 * self.curvature_at(s)) ** 2
            offset = min(abs(d - lane * lane_width) for lane in range(self.scenario.road.lanes))
            sums[3] += offset**2 / (1 + offset**2)
            sums[4] += (d1 / max(s1, terms.SLOWEST)) ** 2
            if self.before is not None:
                change = d - self.planned[k]
                sums[5] += change**2 / (1 + (change / terms.LARGEST_CHANGE) ** 2)
            away = (abs(d - self.target) - terms.ARRIVED) / (terms.NOT_ARRIVED - terms.ARRIVED)
            sums[6] += min(max(away, 0.0), 1.0)
            space = lane_width / 2 - offset - width / 2
            sums[9] += (max(terms.BOUNDARY_SPACE - space, 0.0) / terms.BOUNDARY_SPACE) ** 2
            error += (s1 - min(self.limit, self.desired_at(s))) ** 2
            acceleration += s2**2
        collision = 0.0
        for neighbour in observation.neighbours:
            collision += self.neighbour(neighbour, aside, along, sums)
        end_offset = abs(aside[-1][0] - self.target)
        changes_ahead = cost.CHANGE_AHEAD if self.goes_on_ahead and j != len(self.along) - 1 else 0.0
        changes_aside = cost.CHANGE_ASIDE if self.goes_on_aside and i != len(self.aside) - 1 else 0.0
        n = plans.POINTS
        features = [0.0] * 12
        features[0] = (
            self.rounded((cost.SPEED_ERROR * error + cost.ACCELERATION * acceleration) / n + changes_ahead)
            + self.rounded(cost.TERMINAL_OFFSET * 2 * end_offset**2 / (1 + end_offset) + changes_aside)
            + self.rounded(cost.COLLISION * collision / n)
        )
        for index, term in enumerate(cost.TERMS, start=1):
            share = {6: plans.INTERVAL, 8: 1.0, 11: 1.0}.get(index, 1 / n)
            features[index] = sums[index] * share / term.typical
        jerks = [sum(point[3] ** 2 for point in plan) / n / cost.TERMS[0].typical for plan in (aside, along)]
        features[1] = self.rounded(jerks[0]) + self.rounded(jerks[1])
        return features

    @staticmethod
    def rounded(value: float) -> float:
        return float(np.floor(value * terms.FEATURE_GRID + 0.5) / terms.FEATURE_GRID)

    def neighbour(
        self, neighbour: Floats, aside: list[tuple[float, ...]], along: list[tuple[float, ...]], sums: list[float]
    ) -> float:
        """Adds to P7, P8, P10, P11 what one neighbour means; returns at how many points it is touched."""
        other_s0, other_d0, other_s1, other_d1, length, width = (float(value) for value in neighbour)
        road, ego = self.scenario.road, self.scenario.ego
        if other_s0 < self.start[0] and abs(other_d0 - self.start[3]) < road.lane_width / 2:
            return 0.0
        touched = 0.0
        for t, (d, d1, _, _), (s, s1, _, _) in zip(TIMES, aside, along, strict=True):
            fading = exp(-t / terms.DRIFT_TIME)
            other_d = other_d0 + other_d1 * terms.DRIFT_TIME * (1 - fading)
            other_s = other_s0 + other_s1 * t
            gap = max(abs(other_s - s) - (ego.length + length) / 2, 0.0)
            beside = max(abs(other_d - d) - (ego.width + width) / 2, 0.0)
            clear = max(terms.CLEAR_TIME * s1, terms.SHORTEST_CLEARANCE)
            sums[7] += max(1 - (gap / clear) ** 2 - (beside / terms.CLEAR_SIDE) ** 2, 0.0)
            if gap == 0 and abs(other_d - d) < (ego.width + width) / 2:
                touched += 1
            sign = 1.0 if other_d > d else -1.0
            lateral_rate = max(sign * (d1 - other_d1 * fading), 0.0) / max(beside, terms.SMALLEST_SIDE_GAP)
            alongside = max(1 - gap / (terms.ALONGSIDE_TIME * max(s1, terms.SLOWEST)), 0.0)
            sums[10] += alongside * lateral_rate**2
            is_ahead = other_s > s
            rate = max(s1 - other_s1 if is_ahead else other_s1 - s1, 0.0) / max(gap, terms.SMALLEST_GAP)
            urgency = min(rate**2, terms.LARGEST_URGENCY) * max(1 - beside / terms.IN_PATH_FADE, 0.0)
            if is_ahead:
                sums[8] = max(sums[8], urgency)
            elif abs(other_d0 - self.target) < road.lane_width / 2:
                sums[11] = max(sums[11], urgency)
        return touched

    def is_feasible(self, i: int, j: int) -> bool:
        road, ego = self.scenario.road, self.scenario.ego
        away = ego.width / 2 + CURB
        right, left = min(road.right_edge + away, self.start[3]), max(road.left_edge - away, self.start[3])
        for t in TIMES:
            d = self.aside[i](t)
            _, _, _, path_curvature, speed, acceleration = self.motion(i, j, t)
            if not right <= d <= left or self.along[j](t, 1) < 0 or abs(path_curvature) > plans.LARGEST_CURVATURE:
                return False
            if abs(path_curvature) * speed**2 > plans.LARGEST_SIDE_ACCELERATION:
                return False
            if not -plans.LARGEST_BRAKING <= acceleration <= plans.LARGEST_THRUST:
                return False
        return True

    def motion(self, i: int, j: int, t: float) -> tuple[float, float, float, float, float, float]:
        """x, y, heading, curvature, speed and acceleration of the path at time t > 0, by differences (about 1e-5 accurate)."""

        def point(moment: float) -> Floats:
            return np.array(to_cartesian(self.line, self.along[j](moment), self.aside[i](moment))[:2])

        before, here, after = point(t - DIFFERENCE), point(t), point(t + DIFFERENCE)
        first, second = (here - before) / DIFFERENCE, (after - here) / DIFFERENCE
        velocity = (first + second) / 2
        speed = hypot(*velocity)
        turn = atan2(second[1], second[0]) - atan2(first[1], first[0])
        turn = (turn + pi) % (2 * pi) - pi
        heading = atan2(velocity[1], velocity[0])
        acceleration = (hypot(*second) - hypot(*first)) / DIFFERENCE
        return float(here[0]), float(here[1]), heading, turn / DIFFERENCE / speed, speed, acceleration
