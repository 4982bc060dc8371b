"""The closed loop of planner, vehicle model and SUMO, in scenario steps of 0.1 s."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.evaluations import Failure
from drivecal.domain.roads import Floats, reference_line, to_cartesian
from drivecal.domain.scenarios import Scenario
from drivecal.highway.geometry import with_directions
from drivecal.highway.traffic.geometry import place
from drivecal.highway.traffic.simulation import Simulation
from drivecal.plugins.ports import Observation, Planner, VehicleModel

SAMPLE_TIME = 0.01
"""Sample time of the vehicle's dynamics (s)."""

Watcher = Callable[[int, Floats | None, Floats, Floats], None]
"""Callback after each step, with its number, the new trajectory if the step planned one, the vehicle's pose and the neighbours."""


@dataclass(frozen=True, slots=True)
class Drive:
    """Time series of a run, as views of the loop's buffers that the next run overwrites.

    `motion`: the ego vehicle's Frenet motion (s, s', s'', d, d', d'') at the start and after each of n steps, shape (n + 1, 6). `dynamics`:
    as from `VehicleModel.follow`, shape (10 n, 5). `failure`: the reason of an early end.
    """

    motion: Floats
    dynamics: Floats
    failure: Failure | None


class ClosedLoop:
    """Drives a scenario repeatedly; everything that does not depend on the parameters is prepared once."""

    def __init__(self, scenario: Scenario, planner: Planner, vehicle: VehicleModel, simulation: Simulation) -> None:
        """Prepares the runs. Raises InvalidInputError if scenario step, planning period and the vehicle's sample time do not fit."""
        self._scenario, self._planner, self._vehicle, self._simulation = scenario, planner, vehicle, simulation
        self._steps = round(scenario.duration / scenario.step)
        self._steps_per_plan = round(planner.period / scenario.step)
        samples = round(scenario.step / SAMPLE_TIME)
        if samples < 1 or abs(samples * SAMPLE_TIME - scenario.step) > 1e-9:
            raise InvalidInputError(Problem("step", f"{scenario.step} s", f"give a multiple of {SAMPLE_TIME} s"))
        if self._steps_per_plan < 1 or abs(self._steps_per_plan * scenario.step - planner.period) > 1e-9:
            raise InvalidInputError(Problem("period", f"{planner.period} s", f"plan every multiple of {scenario.step} s"))
        road, ego = scenario.road, scenario.ego
        line = reference_line(road)
        self._line = with_directions(line)
        self._outline = np.array([0.5 * ego.length, 0.5 * ego.width, road.right_edge, road.left_edge])
        self._dynamics = np.zeros((self._steps * samples, 5))
        self._samples = [self._dynamics[index * samples : (index + 1) * samples] for index in range(self._steps)]
        self._motion = np.zeros((self._steps + 1, 6))
        self._motions = list(self._motion)
        self._front = np.zeros(3)
        x, y, heading = to_cartesian(line, ego.s, ego.d)
        self._start = (x, y, heading + ego.heading, ego.speed)

    def drive(self, parameters: Sequence[float], watch: Watcher | None = None, planner: Planner | None = None) -> Drive:
        """Drives one run. `planner` replaces the loop's own. Raises SimulationError if SUMO fails."""
        scenario, vehicle, simulation = self._scenario, self._vehicle, self._simulation
        planner = planner or self._planner
        step, steps_per_plan = scenario.step, self._steps_per_plan
        line, outline, motions, front = self._line, self._outline, self._motions, self._front
        front_values = front.data  # a memoryview returns single items several times faster
        simulation.load(scenario)
        simulation.reset()
        neighbours = simulation.neighbours
        planner.reset(parameters)
        vehicle.start(*self._start)
        place(line, vehicle.pose, scenario.ego.s, outline, motions[0], front)
        observation = Observation(0.0, motions[0], neighbours)
        failure = None
        since, done = 0.0, 0
        for index, dynamics in enumerate(self._samples):
            planned = None
            if index % steps_per_plan == 0:
                observation.time = index * step
                observation.ego = motions[index]
                planned = trajectory = planner.plan(observation)
                since = 0.0
            stable = vehicle.follow(trajectory, since, step, dynamics)
            since += step
            done = index + 1
            pose, motion = vehicle.pose, motions[done]
            on_road = place(line, pose, motions[index].item(0), outline, motion, front)
            if not stable or not on_road:
                failure = Failure.OFF_ROAD if stable else Failure.UNSTABLE
                break
            collided = simulation.advance(index, front_values, pose)
            if watch is not None:
                watch(index, planned, pose, neighbours)
            if collided:
                failure = Failure.COLLISION
                break
        return Drive(self._motion[: done + 1], self._dynamics[: done * len(self._samples[0])], failure)
