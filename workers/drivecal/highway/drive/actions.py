"""Triggered actions of the traffic's vehicles: they brake, cut in or drift at a time, a gap or a place."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from drivecal.bundles.highway import Brake, CutIn, Drift, TrafficEntry
from drivecal.domain.errors import DrivecalError
from drivecal.domain.roads import Floats
from drivecal.highway import sumo
from drivecal.highway.sumo import FREE, FREE_BUT_SAFE, MODEL


class ActionError(DrivecalError):
    """A vehicle cannot do what the scenario says, e.g. cut into a lane that does not exist."""


class EgoPlace(NamedTuple):
    """Place of the ego vehicle: s of its centre (m), and metres of its way per metre of s."""

    s: float
    stretch: float


@dataclass(slots=True)
class _Speeding:
    """A running `brake`: the speed now, and the time at which it is given back to the model, if it is known.

    A `constant` vehicle has no model: it comes back to its own speed at the rate of the brake.
    """

    brake: Brake
    speed: float
    until: float | None = None


@dataclass(slots=True)
class _Shift:
    """A running motion to the side: from `start` by `way` (m), in `seconds` from `begin`; `steps`: lanes still to be entered."""

    begin: float
    seconds: float
    start: float
    way: float
    steps: int = 0
    passed: float = 0.0

    def at(self, time: float) -> float:
        """Returns the offset at a time: least jerk, from rest to rest."""
        u = min(max((time - self.begin) / self.seconds, 0.0), 1.0)
        return self.start + self.way * u * u * u * (10.0 - 15.0 * u + 6.0 * u * u)


class Actions:
    """The actions of all vehicles of a scenario."""

    def __init__(self, vehicles: Mapping[str, TrafficEntry]) -> None:
        """`vehicles`: by id."""
        self._entries = [(name, action) for name, vehicle in vehicles.items() for action in vehicle.actions]
        self._vehicles = vehicles
        self.reset()

    def reset(self) -> None:
        """Forgets what has happened, for another run."""
        self._waiting = list(self._entries)
        self._late: list[tuple[str, CutIn]] = []
        self._speeding: dict[str, _Speeding] = {}
        self._shifts: dict[str, _Shift] = {}

    @property
    def pending(self) -> bool:
        """Whether something is still to be done."""
        return bool(self._waiting or self._late or self._speeding or self._shifts)

    def act(self, time: float, step: float, names: Sequence[str], others: Floats, ego: EgoPlace, length: float) -> None:
        """Begins and continues actions for the step from `time` on. `others` and `ego`: at that time; `length`: the ego vehicle's.

        Vehicles that have left the network do nothing. Vehicles that are due to cut in inside of a junction do so behind it, on the edge
        whose lanes the scenario numbers.
        """
        rows = {name: row for row, name in enumerate(names)}
        waiting: list[tuple[str, Brake | CutIn | Drift]] = []
        due: list[tuple[str, Brake | CutIn | Drift]] = [*self._late]
        for name, action in self._waiting:
            is_due = name in rows and self._is_due(name, action, time, others.item(rows[name], 0), ego, length)
            (due if is_due else waiting).append((name, action))
        self._waiting, self._late = waiting, []
        for name, action in due:
            if isinstance(action, CutIn) and (name not in rows or sumo.vehicle.getRoadID(name).startswith(":")):
                self._late.append((name, action))
            else:
                self._begin(name, action, time)
        for name in [name for name in self._speeding if name in rows]:
            self._speed(name, time, step)
        for name in [name for name in self._shifts if name in rows]:
            self._shift(name, time + step)

    def _is_due(self, name: str, action: Brake | CutIn | Drift, time: float, s: float, ego: EgoPlace, length: float) -> bool:
        if action.time is not None:
            return time >= action.time - 1e-9
        if action.s is not None:
            return s >= action.s
        return abs(s - ego.s) * ego.stretch - 0.5 * (length + self._vehicles[name].length) <= (action.gap or 0.0)

    def _begin(self, name: str, action: Brake | CutIn | Drift, time: float) -> None:
        vehicle = sumo.vehicle
        if isinstance(action, Brake):
            self._speeding[name] = _Speeding(action, vehicle.getSpeed(name))
            vehicle.setSpeedMode(name, FREE_BUT_SAFE)
            return
        offset = vehicle.getLateralLanePosition(name)
        if isinstance(action, Drift):
            self._shifts[name] = _Shift(time, action.seconds, offset, action.offset - offset)
            return
        edge, index = vehicle.getRoadID(name), vehicle.getLaneIndex(name)
        count = sumo.edge.getLaneNumber(edge)
        if action.lane >= count:
            raise ActionError(
                f"{name} cannot cut into lane {action.lane} of edge {edge} at {time:g} s, which has {count} lanes"
            )
        centres = [0.0]
        for lane in range(1, count):
            centres.append(centres[-1] + 0.5 * (_width(edge, lane - 1) + _width(edge, lane)))
        way = centres[action.lane] - centres[index] - offset
        self._shifts[name] = _Shift(time, action.seconds, offset, way, action.lane - index)

    def _speed(self, name: str, time: float, step: float) -> None:
        running = self._speeding[name]
        if running.until is not None and time >= running.until - 1e-9:
            vehicle = self._vehicles[name]
            if vehicle.model != "constant":
                sumo.vehicle.setSpeedMode(name, MODEL)
                sumo.vehicle.setSpeed(name, -1)
                del self._speeding[name]
                return
            sumo.vehicle.setSpeedMode(name, FREE)
            running.brake, running.until = Brake(do="brake", speed=vehicle.speed, rate=running.brake.rate), None
        change, target = running.brake.rate * step, running.brake.speed
        speed = max(running.speed - change, target) if running.speed > target else min(running.speed + change, target)
        running.speed = speed
        sumo.vehicle.setSpeed(name, speed)
        if speed == target and running.until is None and running.brake.hold is not None:
            running.until = time + step + running.brake.hold

    def _shift(self, name: str, time: float) -> None:
        """Moves a vehicle sideways, and into the next lane when its centre crosses the marking, or after the junction."""
        running, vehicle = self._shifts[name], sumo.vehicle
        offset = running.at(time) - running.passed
        side = (running.steps > 0) - (running.steps < 0)
        if side:
            edge, index = vehicle.getRoadID(name), vehicle.getLaneIndex(name)
            half = 0.5 * _width(edge, index)
            if side * offset > half and not edge.startswith(":") and 0 <= index + side < sumo.edge.getLaneNumber(edge):
                vehicle.moveTo(name, f"{edge}_{index + side}", vehicle.getLanePosition(name))
                way = side * (half + 0.5 * _width(edge, index + side))
                running.passed += way
                running.steps -= side
                offset -= way
        vehicle.setLateralLanePosition(name, offset)
        if time >= running.begin + running.seconds and not running.steps:
            del self._shifts[name]


def _width(edge: str, lane: int) -> float:
    width: float = sumo.lane.getWidth(f"{edge}_{lane}")
    return width
