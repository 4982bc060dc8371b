"""The closed loop of planner, vehicle model and SUMO, in scenario steps of 0.1 s."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.evaluations import Failure
from drivecal.domain.roads import Floats, reference_line, to_cartesian
from drivecal.domain.scenarios import Scenario
from drivecal.highway import geometry as shared
from drivecal.highway.compilation import compiled_with
from drivecal.highway.traffic import geometry
from drivecal.highway.traffic.geometry import STEP, place
from drivecal.highway.traffic.simulation import Simulation
from drivecal.highway.vehicle import equations, kernels
from drivecal.highway.vehicle.kernels import FOLLOWED, TOO_SHORT, UNSTABLE, follow
from drivecal.highway.vehicle.model import SingleTrackModel
from drivecal.plugins.ports import Observation, Planner, VehicleModel

OFF_ROAD = 3
"""Result of a move, beside those of `kernels.follow`."""


@compiled_with(equations, kernels, shared, geometry)
def _move(
    state: Floats, plant: Floats, controller: Floats, line: Floats, along: Floats, frame: Floats, trajectory: Floats, since: float,
    index: int, motion: Floats, dynamics: Floats, ego: Floats,
) -> int:  # fmt: skip
    samples = len(dynamics) // (len(motion) - 1)
    rows = dynamics[index * samples : (index + 1) * samples]
    status = follow(state, plant, controller, trajectory, since, samples, rows)
    on_road = place(line, along, frame, state, motion[index, 0], motion[index + 1], ego)
    return OFF_ROAD if status == FOLLOWED and not on_road else status


Move = Callable[[Floats, float, int], int]
"""Moves the ego vehicle through a step: the trajectory, the seconds since its start, and the step's number.

Returns FOLLOWED, UNSTABLE or OFF_ROAD. Raises ValueError if the trajectory is too short.
"""


def mover(vehicle: VehicleModel, simulation: Simulation, frame: Floats, motion: Floats, dynamics: Floats) -> Move:
    """Returns the move of a vehicle, which writes the simulation's `ego` and the step's rows of `motion` and `dynamics`.

    One compiled call for the built-in vehicles, because a call costs as much as the geometry; two for vehicles of plug-ins.

    Args:
        vehicle: the ego vehicle.
        simulation: its road and its place in SUMO.
        frame: as in `traffic.geometry`.
        motion: as in `Drive`.
        dynamics: as in `Drive`.
    """
    line, along, ego = simulation.line, simulation.along, simulation.ego
    step = frame.item(STEP)
    if isinstance(vehicle, SingleTrackModel) and type(vehicle).follow is SingleTrackModel.follow:
        state, plant, controller = vehicle.arrays

        def move(trajectory: Floats, since: float, index: int) -> int:
            status: int = _move(
                state, plant, controller, line, along, frame, trajectory, since, index, motion, dynamics, ego
            )  # fmt: skip
            if status == TOO_SHORT:
                raise ValueError(f"the trajectory does not cover {since} s to {since + step} s after its start")
            return status

        return move
    samples = len(dynamics) // (len(motion) - 1)

    def move_by_port(trajectory: Floats, since: float, index: int) -> int:
        stable = vehicle.follow(trajectory, since, step, dynamics[index * samples : (index + 1) * samples])
        on_road = place(line, along, frame, vehicle.pose, motion.item(index, 0), motion[index + 1], ego)
        return (FOLLOWED if on_road else OFF_ROAD) if stable else UNSTABLE

    return move_by_port


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
        lanes = (road.right_edge, road.left_edge, road.lane_width, road.lanes - 1.0)
        self._frame = np.array([0.5 * ego.length, 0.5 * ego.width, *lanes, scenario.step])
        self._dynamics = np.zeros((self._steps * samples, 5))
        self._motion = np.zeros((self._steps + 1, 6))
        self._motions = list(self._motion)
        x, y, heading = to_cartesian(reference_line(road), ego.s, ego.d)
        self._start = (x, y, heading + ego.heading, ego.speed)

    def drive(self, parameters: Sequence[float], watch: Watcher | None = None) -> Drive:
        """Drives one run. Raises SimulationError if SUMO fails."""
        scenario, vehicle, simulation = self._scenario, self._vehicle, self._simulation
        planner = self._planner
        step, steps_per_plan = scenario.step, self._steps_per_plan
        frame, motion, dynamics, motions = self._frame, self._motion, self._dynamics, self._motions
        simulation.load(scenario)
        line, along, ego, neighbours = simulation.line, simulation.along, simulation.ego, simulation.neighbours
        move = mover(vehicle, simulation, frame, motion, dynamics)
        vehicle.start(*self._start)
        place(line, along, frame, vehicle.pose, scenario.ego.s, motions[0], ego)
        simulation.reset()  # puts `ego` to where SUMO starts it
        planner.reset(parameters)
        observation = Observation(0.0, motions[0], neighbours)
        failure = None
        since, done = 0.0, 0
        for index in range(self._steps):
            planned = None
            if index % steps_per_plan == 0:
                observation.time = index * step
                observation.ego = motions[index]
                planned = trajectory = planner.plan(observation)
                since = 0.0
            moved = move(trajectory, since, index)
            since += step
            done = index + 1
            if moved != FOLLOWED:
                failure = Failure.OFF_ROAD if moved == OFF_ROAD else Failure.UNSTABLE
                break
            pose = vehicle.pose
            collided = simulation.advance(index, pose)
            if watch is not None:
                watch(index, planned, pose, neighbours)
            if collided:
                failure = Failure.COLLISION
                break
        return Drive(motion[: done + 1], dynamics[: done * len(dynamics) // self._steps], failure)
