"""The closed loop: a user's controller, the vehicle, and SUMO's traffic on a corridor."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from drivecal.bundles.highway import HighwayScenario, HighwaySimulator
from drivecal.domain.errors import DrivecalError
from drivecal.domain.roads import Floats
from drivecal.highway.drive import geometry
from drivecal.highway.drive.controllers import Checked
from drivecal.highway.drive.geometry import keeper_acceleration
from drivecal.highway.drive.measures import TICK, Record, distance_at_limit
from drivecal.highway.drive.plants import UserVehicleModel
from drivecal.highway.drive.road import HighwayRoad
from drivecal.highway.drive.traffic import Traffic
from drivecal.highway.drive.trajectories import TrajectorySource
from drivecal.highway.geometry import hit
from drivecal.highway.vehicle.model import SingleTrackModel

PATH_SPACING = 0.05
"""Seconds between points of the path that the lane keeper follows."""
PATH_AHEAD = 0.6
"""Seconds of the path beyond a tick: more than the vehicle's reaction."""


class Watcher(Protocol):
    """Sees a run: the other vehicles' `names`, their `outlines` as in `geometry`, and the ego vehicle's pose, at the start and after each
    step of the traffic. The next step overwrites the arrays."""

    def __call__(self, names: list[str], outlines: Floats, pose: Floats) -> None:
        """Sees a moment of the run."""


class StartError(DrivecalError):
    """The ego vehicle cannot start where the scenario places it."""


@dataclass(frozen=True, slots=True)
class FinishedRun:
    """A run's record and its failure, if any: see `highway_catalogue.FAILURES`."""

    record: Record
    failure: str | None


class Loop:
    """Runs one scenario repeatedly. Equal parameters give equal bits, if the controller does."""

    def __init__(
        self,
        name: str,
        simulator: HighwaySimulator,
        scenario: HighwayScenario,
        road: HighwayRoad,
        traffic: Traffic,
        vehicle: SingleTrackModel,
        controller: Checked | TrajectorySource,
    ) -> None:
        """`name`: the scenario's."""
        self._name, self._scenario, self._road, self._traffic = name, scenario, road, traffic
        self._vehicle, self._controller = vehicle, controller
        self._plans = None if isinstance(controller, Checked) else controller
        step = simulator.step
        period = step if simulator.controller.period is None else simulator.controller.period
        tick = min(step, period)
        self._step, self._tick = step, tick
        self._ticks_per_step, self._ticks_per_period = round(step / tick), round(period / tick)
        self._ticks = round(scenario.duration / step) * self._ticks_per_step
        samples = round(tick / TICK)
        output = simulator.controller.output
        self._acceleration = output.index("acceleration") if "acceleration" in output else None
        lateral = next((entry for entry in output if entry != "acceleration"), None)
        self._lateral = None if lateral is None else output.index(lateral)
        self._steer = lateral or "path"
        self._size = np.array([0.5 * scenario.ego.length, 0.5 * scenario.ego.width])
        self._rows = np.zeros((self._ticks // self._ticks_per_step + 1, geometry.RECORDED))
        self._row_views = list(self._rows)
        self._dynamics = np.zeros((self._ticks * samples, 5))
        self._samples = [self._dynamics[index * samples : (index + 1) * samples] for index in range(self._ticks)]
        self._path = np.zeros((round((tick + PATH_AHEAD) / PATH_SPACING) + 2, 7))
        self._path[:, 0] = np.arange(len(self._path)) * PATH_SPACING
        self._motion, self._front, self._signals = np.zeros(9), np.zeros(3), np.zeros(geometry.SIGNALS)
        self._start = (*road.start(traffic.start_s, traffic.start_d), scenario.ego.speed)
        limits = np.nanmax(road.lanes[:, :, 2], axis=1)
        self._finish = road.length - 0.5 * scenario.ego.length
        self._wanted = max(distance_at_limit(road.line[:, 0], limits, traffic.start_s, self._finish, scenario.duration), 1e-9)

    def prepare(self) -> None:
        """Compiles or loads all kernels, which would take seconds of the first run. Raises StartError and TrafficError.

        It leaves the warm-up out, whose kernels concern vehicles that enter and that overlap.
        """
        road, traffic, vehicle, motion = self._road, self._traffic, self._vehicle, self._motion
        dynamics = np.zeros((1, 5))
        traffic.reset(is_warm=False)
        vehicle.start(*self._start)
        if not geometry.place(road.line, road.lanes, vehicle.pose, traffic.start_s, self._size, motion, self._front):
            raise StartError(f"scenarios.{self._name}.ego: it starts off the road; move it into its lane")
        self._check_apart(vehicle.pose)
        geometry.settle(
            road.line, road.lanes, traffic.raw, traffic.others, traffic.outlines, self._step, motion, vehicle.pose, vehicle.steering,
            self._size, 0.0, self._row_views[0], self._row_views[0],
        )  # fmt: skip
        geometry.observe(
            road.line,
            road.lanes,
            road.ends,
            traffic.others,
            motion,
            vehicle.pose,
            vehicle.steering,
            1.0,
            0.0,
            0.0,
            self._signals,
        )
        geometry.nearest(road.line, *self._start[:2])
        geometry.path_of(road.line, road.lanes, 0, motion.item(geometry.S), vehicle.pose.item(3), self._path)
        vehicle.keep(self._path, 0.0, 0.0, dynamics)

    def _check_apart(self, pose: Floats) -> None:
        """Raises StartError if two vehicles overlap that start at time 0; vehicles of the warm-up leave them room."""
        starting = self._traffic.starting
        names, outlines = [*self._traffic.names[:starting], "ego"], self._traffic.outlines[:starting]
        starts = np.vstack([outlines, [*pose[:3], *self._size, 0.0]])
        for row, (x, y, heading, *size) in enumerate(starts.tolist()):  # the first for the kernel alone
            other = hit(starts[:row], np.array([x, y, heading, 0.0, 0.0, 0.0, 0.0, 0.0]), np.array(size[:2]))
            if other >= 0:
                message = f"{names[row]} starts inside of the vehicle {names[other]}; place them farther apart"
                raise StartError(f"scenarios.{self._name}: {message}")

    def run(self, parameters: Mapping[str, Any], *, is_warm: bool = True, watch: Watcher | None = None) -> FinishedRun:
        """Runs one parameter set. `is_warm`: as of `Traffic.reset`. Raises ControllerError, TrafficError and others without a result."""
        road, traffic, vehicle, controller = self._road, self._traffic, self._vehicle, self._controller
        line, lanes, ends, size, motion, front, signals = (
            road.line, road.lanes, road.ends, self._size, self._motion, self._front, self._signals
        )  # fmt: skip
        pose, half = vehicle.pose, self._size.item(0)
        per_step, per_period, tick, step = self._ticks_per_step, self._ticks_per_period, self._tick, self._step
        by_acceleration, by_lateral, steer, plans = self._acceleration, self._lateral, self._steer, self._plans
        trajectory, planned = self._path, 0
        traffic.reset(is_warm=is_warm)
        if isinstance(vehicle, UserVehicleModel):
            vehicle.begin(parameters)
        vehicle.start(*self._start)
        geometry.place(line, lanes, pose, traffic.start_s, size, motion, front)
        track = int(motion.item(geometry.TRACK))
        geometry.record(line, lanes, traffic.others, motion, pose, vehicle.steering, half, 0.0, 0.0, self._row_views[0])
        if watch is not None:
            watch(traffic.names, traffic.outlines, pose)
        controller.begin(parameters)
        failure, rows, ticks, recorded = None, 1, 0, 0
        acceleration = lateral = 0.0
        for index, dynamics in enumerate(self._samples):
            if index % per_period == 0:
                lead = index % per_step * tick
                geometry.observe(
                    line, lanes, ends, traffic.others, motion, pose, vehicle.steering, half, index * tick, lead, signals
                )
                observed = signals.tolist()
                if plans is not None:
                    trajectory, planned = plans.plan(observed, pose, motion.item(geometry.S), traffic, lead), index
                elif isinstance(controller, Checked):
                    commands = controller.step(observed)
                    acceleration = (
                        keeper_acceleration(observed) if by_acceleration is None else float(commands[by_acceleration])
                    )
                    lateral = 0.0 if by_lateral is None else float(commands[by_lateral])
            if plans is not None:
                stable = vehicle.follow(trajectory, (index - planned) * tick, tick, dynamics)
            elif steer == "path":
                geometry.path_of(line, lanes, track, motion.item(geometry.S), pose.item(3), self._path)
                stable = vehicle.keep(self._path, 0.0, acceleration, dynamics)
            elif steer == "curvature":
                stable = vehicle.turn(lateral, acceleration, dynamics)
            else:
                stable = vehicle.step(lateral, acceleration, dynamics)
            ticks = index + 1
            on_road = geometry.place(line, lanes, pose, motion.item(geometry.S), size, motion, front)
            if motion.item(geometry.S) >= self._finish:
                break  # the end of the route
            if not stable or not on_road:
                failure = "off_road" if stable else "unstable"
                break
            if ticks % per_step == 0:
                if not traffic.advance(index // per_step, motion, front, pose.item(3)):
                    break  # the end of the route
                hit = geometry.settle(
                    line, lanes, traffic.raw, traffic.others, traffic.outlines, step, motion, pose, vehicle.steering, size,
                    ticks * tick, self._row_views[rows - 1], self._row_views[rows],
                )  # fmt: skip
                rows += 1
                recorded = ticks
                if watch is not None:
                    watch(traffic.names, traffic.outlines, pose)
                if hit >= 0:
                    failure = "collision"
                    break
        if recorded < ticks:  # the run ended within a step of the traffic
            lead = (ticks - recorded) * tick
            geometry.record(
                line, lanes, traffic.others, motion, pose, vehicle.steering, half, ticks * tick, lead, self._row_views[rows]
            )
            rows += 1
        samples = len(self._samples[0])
        record = Record(
            self._rows[:rows],
            self._dynamics[: ticks * samples],
            self._wanted,
            self._finish,
            vehicle.parameters.mass,
            self._scenario.ego.width,
        )
        return FinishedRun(record, failure)
