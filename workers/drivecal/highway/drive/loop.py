"""The closed loop of a controlled vehicle and SUMO's traffic."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.roads import Floats
from drivecal.highway import geometry as shared
from drivecal.highway.compilation import compiled_with
from drivecal.highway.drive import geometry
from drivecal.highway.drive.control import EgoControl, RunView
from drivecal.highway.drive.geometry import S, path_of
from drivecal.highway.drive.measures import TICK, Record, distance_at_limit
from drivecal.highway.drive.traffic import Traffic
from drivecal.highway.geometry import hit, swept
from drivecal.highway.vehicle import kernels, single_track
from drivecal.highway.vehicle.kernels import FOLLOWED, PATH, TOO_SHORT, TRAJECTORY, UNSTABLE, drive
from drivecal.highway.vehicle.model import SingleTrackModel
from drivecal.plugins.ports import VehicleModel

PATH_SPACING = 0.05
"""Seconds between points of the path that the lane keeper follows."""
PATH_AHEAD = 0.6
"""Seconds of the path beyond a tick: more than the vehicle's reaction."""
VERGE = 0.5
"""Distance (m) beyond a road's lanes at which a vehicle is off it."""
OFF_ROAD = 3
"""Further result of a move, after the results of `kernels.drive`."""


@compiled_with(single_track, kernels, shared, geometry)
def _move(
    line: Floats, lanes: Floats, state: Floats, plant: Floats, controller: Floats, by: int, lateral: float, acceleration: float,
    trajectory: Floats, since: float, track: int, dynamics: Floats, index: int, samples: int, motion: Floats,
) -> int:  # fmt: skip
    rows = dynamics[index * samples : (index + 1) * samples]
    if by == PATH:
        path_of(line, lanes, track, motion[S], state[3], trajectory)
    begun = since if by == TRAJECTORY else 0.0
    status = drive(state, plant, controller, by, lateral, acceleration, trajectory, begun, samples, rows)
    motion[geometry.STEERING] = state[8]
    on_road = geometry.place(line, lanes, state, motion[S], motion)
    return OFF_ROAD if status == FOLLOWED and not on_road else status


Move = Callable[[Floats, float, float, float, int], int]
"""Moves the ego vehicle through a tick: trajectory or path, seconds since its start, lateral command, acceleration, the tick's number.

Returns FOLLOWED, UNSTABLE or OFF_ROAD. Raises ValueError if the trajectory is too short.
"""


Watcher = Callable[[Traffic, Floats, Floats | None], None]
"""Sees a run at the start and after each step of the traffic: the others, the ego vehicle's pose, and the trajectory if the step began
with a new one. The next step overwrites the arrays."""


@dataclass(frozen=True, slots=True)
class FinishedRun:
    """A run's record and its failure, if any: see `highway_catalogue.FAILURES`."""

    record: Record
    failure: str | None


class Loop:
    """Runs one scenario repeatedly. Equal parameters give equal bits, if the controller does.

    Everything that does not depend on the parameters is prepared once.
    """

    def __init__(
        self, traffic: Traffic, vehicle: VehicleModel, control: EgoControl, *, verge: float = VERGE, heading: float = 0.0
    ) -> None:
        """Prepares the runs.

        Args:
            traffic: SUMO with the scenario and its road.
            vehicle: the ego vehicle.
            control: what drives it.
            verge: distance (m) beyond the road's lanes at which the vehicle is off it.
            heading: of the ego vehicle at its start, relative to its lane (rad).

        Raises InvalidInputError if the step of the traffic, the control's period and the vehicle's sample time do not fit.
        """
        road, scenario, step, period = traffic.road, traffic.scenario, traffic.step, control.period
        self._road, self._traffic, self._vehicle, self._control = road, traffic, vehicle, control
        tick = min(step, period)
        self._tick = tick
        self._ticks_per_step, self._ticks_per_period = _whole(step, tick, "step"), _whole(period, tick, "period")
        self._ticks = round(scenario.duration / step) * self._ticks_per_step
        self._count = samples = _whole(tick, TICK, "step")
        ego = scenario.ego
        self._rows = np.zeros((self._ticks // self._ticks_per_step + 1, geometry.RECORDED + 6))
        self._dynamics = np.zeros((self._ticks * samples, 5))
        self._path = np.zeros((round((tick + PATH_AHEAD) / PATH_SPACING) + 2, 7))
        self._path[:, 0] = np.arange(len(self._path)) * PATH_SPACING
        self._motion = traffic.motion
        self._motion[geometry.SIZE : geometry.ROW] = 0.5 * ego.length, 0.5 * ego.width, verge, step, traffic.keeps_lanes
        x, y, course = road.start(traffic.start_s, traffic.start_d)
        self._start = (x, y, course + heading, ego.speed)
        # others may give another array each time
        self._pose = vehicle.pose if isinstance(vehicle, SingleTrackModel) else np.zeros(8)
        self._view = RunView(road, traffic, self._pose, self._motion)
        limits = np.nanmax(road.lanes[:, :, 2], axis=1)
        self._finish = road.length - 0.5 * ego.length
        self._wanted = max(distance_at_limit(road.line[:, 0], limits, traffic.start_s, self._finish, scenario.duration), 1e-9)

    def prepare(self) -> None:
        """Compiles or loads all kernels, which would take seconds of the first run. Raises InvalidInputError and TrafficError.

        It leaves the warm-up out, whose kernels concern vehicles that enter and that overlap.
        """
        traffic = self._traffic
        traffic.reset(is_warm=False)
        if not self._begin():
            raise InvalidInputError(Problem(f"scenarios.{traffic.name}.ego", "it starts off the road", "move it into its lane"))
        self._check_apart()
        geometry.settle(
            self._road.line, self._road.lanes, traffic.neighbours, traffic.outlines, self._motion, self._pose, self._rows
        )
        self._view.signals()
        geometry.nearest(self._road.line, *self._start[:2])
        if isinstance(self._vehicle, SingleTrackModel):
            model = SingleTrackModel(self._vehicle.parameters)
            model.start(*self._start)
            self._mover(model, PATH)(self._path, 0.0, 0.0, 0.0, 0)

    def _check_apart(self) -> None:
        """Raises InvalidInputError if two vehicles overlap that start at time 0; vehicles of the warm-up leave them room."""
        traffic, size = self._traffic, self._motion[geometry.SIZE : geometry.SIZE + 2]
        names = [*traffic.names[: traffic.starting], "ego"]
        starts = np.vstack([traffic.outlines[: traffic.starting, :5], [*self._pose[:3], *size]])
        for row, (x, y, heading, *half) in enumerate(starts.tolist()):  # the first for the kernel alone
            other = hit(starts[:row], np.array([x, y, heading, 0.0, 0.0, 0.0, 0.0, 0.0]), np.array(half))
            if other >= 0:
                message = f"{names[row]} starts inside of the vehicle {names[other]}"
                raise InvalidInputError(Problem(f"scenarios.{traffic.name}", message, "place them farther apart"))

    def _begin(self) -> bool:
        """Puts the ego vehicle to its start; returns whether it is on the road."""
        road, vehicle = self._road, self._vehicle
        vehicle.start(*self._start)
        self._pose[:] = vehicle.pose
        self._motion[geometry.STEERING] = self._motion[geometry.ROW] = 0.0
        on_road: bool = geometry.place(road.line, road.lanes, self._pose, self._traffic.start_s, self._motion)
        return on_road

    def _record(self, time: float, lead: float, row: int) -> None:
        road, traffic = self._road, self._traffic
        geometry.record(
            road.line, road.lanes, traffic.neighbours, traffic.outlines, self._motion, self._pose, time, lead,
            self._rows[row],
        )  # fmt: skip

    def _mover(self, vehicle: VehicleModel, by: int) -> Move:
        """Returns the move of a vehicle, which starts on the track that a lane keeper keeps.

        One compiled call for the built-in vehicles, because a call costs as much as the geometry; several for others.
        """
        line, lanes, dynamics, motion, pose = self._road.line, self._road.lanes, self._dynamics, self._motion, self._pose
        samples, tick, track = self._count, self._tick, int(motion.item(geometry.TRACK))
        if isinstance(vehicle, SingleTrackModel):
            state, plant, controller = vehicle.arrays

            def move(trajectory: Floats, since: float, lateral: float, acceleration: float, index: int) -> int:
                status: int = _move(
                    line, lanes, state, plant, controller, by, lateral, acceleration, trajectory, since, track, dynamics, index,
                    samples, motion,
                )  # fmt: skip
                if status == TOO_SHORT:
                    raise ValueError(f"the trajectory does not cover {since} s to {since + tick} s after its start")
                return status

            return move

        def move_by_port(trajectory: Floats, since: float, lateral: float, acceleration: float, index: int) -> int:
            del lateral, acceleration
            rows = dynamics[index * samples : (index + 1) * samples]
            stable = vehicle.follow(trajectory, since, tick, rows)  # installed vehicles have planners
            pose[:] = vehicle.pose
            motion[geometry.STEERING] = rows[-1, 4]
            on_road = geometry.place(line, lanes, pose, motion.item(S), motion)
            return (FOLLOWED if on_road else OFF_ROAD) if stable else UNSTABLE

        return move_by_port

    def run(self, parameters: Any, *, is_warm: bool = True, watch: Watcher | None = None) -> FinishedRun:
        """Runs one parameter set.

        Args:
            parameters: as the control takes them.
            is_warm: as of `Traffic.reset`.
            watch: sees the run.

        Raises ControllerError, TrafficError and others without a result.
        """
        traffic, vehicle, control, view, motion = self._traffic, self._vehicle, self._control, self._view, self._motion
        per_step, per_period, tick, finish = self._ticks_per_step, self._ticks_per_period, self._tick, self._finish
        traffic.reset(is_warm=is_warm)
        self._begin()
        pose, act, advance, settle = self._pose, control.act, traffic.advance, geometry.settle
        line, lanes, rows, at = self._road.line, self._road.lanes, self._rows, motion.data
        move = self._mover(vehicle, control.by)
        self._record(0.0, 0.0, 0)
        if watch is not None:
            watch(traffic, pose, None)
        control.begin(parameters)
        failure, ticks, recorded = None, 0, 0
        trajectory, planned = self._path, None
        lateral = acceleration = since = 0.0
        for index in range(self._ticks):
            if index % per_period == 0:
                view.time, view.lead, view.neighbours = index * tick, index % per_step * tick, traffic.neighbours
                planned, lateral, acceleration = act(view)
                if planned is not None:
                    trajectory = planned
                since = 0.0
            status = move(trajectory, since, lateral, acceleration, index)
            since += tick
            ticks = index + 1
            if at[S] >= finish:
                break  # the end of the route
            if status != FOLLOWED:
                failure = "off_road" if status == OFF_ROAD else "unstable"
                break
            if ticks % per_step == 0:
                if not advance(index // per_step):
                    break  # the end of the route
                struck = settle(line, lanes, traffic.neighbours, traffic.outlines, motion, pose, rows)
                recorded = ticks
                if watch is not None:
                    watch(traffic, pose, planned)
                    planned = None
                if struck >= 0:
                    failure = "collision"
                    break
        row = int(at[geometry.ROW]) + 1
        if recorded < ticks:  # the run ended within a step of the traffic
            self._record(ticks * tick, (ticks - recorded) * tick, row)
            row += 1
            if failure is None and self._strikes(rows[row - 2], (ticks - recorded) * tick):
                failure = "collision"
        width = 2.0 * motion.item(geometry.SIZE + 1)
        record = Record(rows[:row], self._dynamics[: ticks * self._count], self._wanted, finish, width)
        return FinishedRun(record, failure)

    def _strikes(self, before: Floats, seconds: float) -> bool:
        """Returns whether the ego vehicle has hit another one since the last step of the traffic, all others straight on."""
        outlines, size = self._traffic.outlines, self._motion[geometry.SIZE : geometry.SIZE + 2]
        moved = geometry.moved_on(outlines, seconds)
        return hit(moved, self._pose, size) >= 0 or swept(outlines, moved, before[1:4], self._pose, size) >= 0


def _whole(duration: float, part: float, field: str) -> int:
    """Returns how many times a part fits into a duration. Raises InvalidInputError if it is not a whole number."""
    count = round(duration / part)
    if count < 1 or abs(count * part - duration) > 1e-9:
        raise InvalidInputError(Problem(field, f"{duration:g} s is no multiple of {part:g} s", f"give a multiple of {part:g}"))
    return count
