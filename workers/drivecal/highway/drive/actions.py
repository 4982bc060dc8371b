"""Triggered actions of the traffic's vehicles, which brake, cut in or drift at a time, a gap or a place, and their conditions.

Conditions are evaluated once per step of the traffic.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from math import atan2, ceil, copysign, cos, hypot, inf, isnan, sin, sqrt
from typing import NamedTuple

import numpy as np

from drivecal.bundles.highway import TrafficEntry
from drivecal.bundles.highway_actions import EGO, Action, Brake, Condition, CutIn, Drift, Meet, Trigger, Wait
from drivecal.domain.errors import NoResultError
from drivecal.highway import sumo
from drivecal.highway.sumo import FREE, FREE_BUT_SAFE, MODEL
from drivecal.roads.lines import lengths

SLOWEST = 1e-3
"""Speed and closing speed (m/s) below which there is no time headway and no time to collision."""
ROUNDING = 1e-9


class Moving(NamedTuple):
    """A vehicle: s and d of its centre (m), its speed (m/s, negative against the route) and half of its length (m)."""

    s: float
    d: float
    speed: float
    half: float


Stretch = Callable[[float, float], float]
"""Returns metres of a way through a place (s, d) per metre of s."""


class Moment(NamedTuple):
    """The vehicles at a time (s). `stretch`: metres of the ego vehicle's way per metre of s; `stretch_at`: that of others."""

    time: float
    vehicles: Mapping[str, Moving]
    stretch: float
    stretch_at: Stretch


class Events:
    """Events of a run so far: actions that have begun or are done, and how far each vehicle has travelled (m)."""

    def __init__(self) -> None:
        self.begun: set[str] = set()
        self.done: set[str] = set()
        self.travelled: dict[str, float] = {}

    def follow(self, vehicles: Mapping[str, Moving], step: float) -> None:
        """Adds the way of the last step (s), also of vehicles against the route or without a place on it."""
        for name, vehicle in vehicles.items():
            self.travelled[name] = self.travelled[name] + abs(vehicle.speed) * step if name in self.travelled else 0.0


class Watch:
    """The trigger of an action in one run."""

    def __init__(self, name: str, trigger: Trigger, step: float) -> None:
        """`name` is the acting vehicle's; `step` is the traffic's (s)."""
        self._after = [_Watched(name, condition, step) for condition in trigger.after]
        self._when = [_Watched(name, condition, step) for condition in _conditions(trigger)]
        self._is_open = not self._after

    def is_due(self, moment: Moment, events: Events) -> bool:
        """Returns whether the action begins now. Must be called once per step."""
        after = [watched.holds(moment, events) for watched in self._after]
        when = [watched.holds(moment, events) for watched in self._when]
        self._is_open = self._is_open or all(after)
        return self._is_open and all(when)


def _conditions(trigger: Trigger) -> list[Condition]:
    if trigger.when is not None:
        return trigger.when
    if trigger.time is not None:
        return [Condition(quantity="time", above=trigger.time)]
    return [Condition(quantity="s", above=trigger.s) if trigger.s is not None else Condition(quantity="gap", below=trigger.gap)]


class _Watched:
    """A condition, with what it was before."""

    def __init__(self, name: str, condition: Condition, step: float) -> None:
        self._condition = condition
        self._vehicle = condition.vehicle or name
        self._to = condition.to or (EGO if self._vehicle != EGO else name)
        self._lag = ceil(condition.delay / step - ROUNDING)
        self._before: bool | None = None
        self._place: tuple[float, float] | None = None
        self._history: list[bool] = []

    def holds(self, moment: Moment, events: Events) -> bool:
        """Returns whether the condition is fulfilled, as of its delay ago."""
        condition, holds = self._condition, self._holds(moment, events)
        rises = holds and self._before is False
        self._before = holds
        fulfilled = rises if condition.rising else holds
        if self._lag == 0:
            return fulfilled
        self._history.append(fulfilled)
        return len(self._history) > self._lag and self._history[-1 - self._lag]

    def _holds(self, moment: Moment, events: Events) -> bool:
        condition = self._condition
        if condition.quantity is None:
            return condition.done in events.done if condition.done is not None else condition.begun in events.begun
        value = self._value(moment, events)
        if value is None:
            return False
        margin = ROUNDING if condition.strict else -ROUNDING
        if condition.above is not None:
            return value >= condition.above + margin
        return condition.below is not None and value <= condition.below - margin

    def _value(self, moment: Moment, events: Events) -> float | None:
        """Returns the quantity, None if it is not defined now."""
        quantity = self._condition.quantity
        if quantity == "time":
            return moment.time
        vehicle = moment.vehicles.get(self._vehicle)
        if vehicle is None:
            return None
        if quantity == "speed":
            return abs(vehicle.speed)
        if quantity == "s":
            return vehicle.s
        if quantity == "travelled":
            return events.travelled.get(self._vehicle, 0.0)
        if quantity == "distance":
            return self._distance(vehicle)
        other = moment.vehicles.get(self._to)
        if other is None:
            return None
        is_ego = EGO in {self._vehicle, self._to}
        return self._between(vehicle, other, moment.stretch if is_ego else moment.stretch_at(vehicle.s, vehicle.d))

    def _distance(self, vehicle: Moving) -> float:
        """Returns the least distance from the condition's place to the way of a vehicle's centre since the last step."""
        x, y = vehicle.s - (self._condition.s or 0.0), vehicle.d - self._condition.d
        begin_x, begin_y = self._place or (x, y)
        self._place = None if isnan(x) else (x, y)
        step_x, step_y = x - begin_x, y - begin_y
        square = step_x * step_x + step_y * step_y
        share = 0.0 if square == 0.0 else min(max(-(begin_x * step_x + begin_y * step_y) / square, 0.0), 1.0)
        return hypot(begin_x + share * step_x, begin_y + share * step_y)

    def _between(self, vehicle: Moving, other: Moving, stretch: float) -> float | None:
        way = (other.s - vehicle.s) * stretch
        gap = abs(way) - (0.0 if self._condition.centres else vehicle.half + other.half)
        if self._condition.quantity == "gap":
            return gap
        speed = vehicle.speed if self._condition.quantity == "headway" else vehicle.speed - other.speed
        speed = copysign(speed, speed * way)  # towards the other
        return gap / speed if speed > SLOWEST else None


DEFAULT_RATE, DEFAULT_SECONDS = 4.0, 3.0
SHORTEST, SLOWEST_BRAKING = 0.1, 0.1
"""Seconds of a motion to the side at least; least speed (m/s) that divides a distance."""
PEAK_SPEED, PEAK_ACCELERATION = 1.875, 10.0 / sqrt(3.0)
"""Largest speed and acceleration of a motion of least jerk, per its mean speed, and per way / seconds²."""


Lateral = Callable[[float, float, float], float]
"""Returns d at an s (last) of the centre of the lane that holds a place (s, d)."""


@dataclass(slots=True)
class _Speeding:
    """A running `brake`: the speed now, the one to be reached, the rate, and the time at which it is given back to the model, if known.

    A `constant` vehicle has no model: it comes back to its own speed at the rate of the brake.
    """

    brake: Brake
    speed: float
    target: float
    rate: float
    until: float | None = None


@dataclass(slots=True)
class _Shift:
    """A running motion to the side: from `start` by `way` (m), in `seconds` from `begin`; `steps`: lanes still to be entered, `ways` to
    each of them at the begin. The lanes were farther apart by the `gap` where they were entered; it fades to 0 until the end."""

    action: str | None
    begin: float
    seconds: float
    start: float
    way: float
    steps: int = 0
    passed: float = 0.0
    ways: list[float] = field(default_factory=list)
    gap: float = 0.0

    def left(self, time: float) -> float:
        """Returns the share of the way that is left at a time: least jerk, from rest to rest."""
        u = min(max((time - self.begin) / self.seconds, 0.0), 1.0)
        return 1.0 - u * u * u * (10.0 - 15.0 * u + 6.0 * u * u)

    def at(self, time: float) -> float:
        """Returns the offset at a time."""
        return self.start + self.way * (1.0 - self.left(time)) - self.gap * self.left(time)

    def enter(self, time: float, measured: float) -> None:
        """Takes the way to the lane that is entered at a time, as it is there (m)."""
        known = self.ways.pop(0) if self.ways else measured
        self.passed += known
        if (left := self.left(time)) > 0.0:
            self.gap += (measured - known) / left


NEAR = 1e-6
"""Metres and seconds before a meeting that count as none."""


class PathVehicle:
    """The motion of one of them: `along` (m) from the path's first point to its centre, and its speed (m/s)."""

    def __init__(self, entry: TrafficEntry) -> None:
        """Takes an entry with a path."""
        points = np.array(entry.path, np.float64)
        self._points = points[np.r_[True, np.any(np.diff(points, axis=0), axis=1)]]
        self._lengths, self._half = lengths(self._points), 0.5 * entry.length
        self._start = entry.s, entry.speed
        self.along, self.speed = self._start

    def reset(self) -> None:
        """Puts it to its start."""
        self.along, self.speed = self._start

    def advance(self, step: float) -> None:
        """Moves it on for a step (s)."""
        self.along += self.speed * step

    def front(self) -> tuple[float, float, float]:
        """Returns x and y of its front (m), and its heading (rad). It goes straight on beyond the path's ends."""
        row = int(np.clip(np.searchsorted(self._lengths, self.along, side="right") - 1, 0, len(self._points) - 2))
        (x, y), (dx, dy) = self._points[row], self._points[row + 1] - self._points[row]
        heading = atan2(dy, dx)
        ahead = self.along - float(self._lengths[row]) + self._half
        return float(x) + ahead * cos(heading), float(y) + ahead * sin(heading), heading


def meeting_speed(meet: Meet, along: float, speed: float, seconds: float, step: float) -> float | None:
    """Returns the speed after the next step of a vehicle that is to meet another one, None if it is there.

    It waits, if it stands, as long as one constant acceleration suffices to arrive in time at the final speed; on its way it takes two
    constant accelerations of equal time.

    Args:
        meet: The action.
        along: Metres on its path.
        speed: Its speed now (m/s).
        seconds: Time after which the other vehicle is at its place, infinite if it stands.
        step: Seconds of a step.
    """
    way = meet.at - along
    if way <= max(NEAR, 0.5 * speed * step):
        return None
    if meet.speed is None:
        return way / max(seconds, step) if seconds < inf else speed
    final = meet.speed
    way, seconds = way - meet.steady, seconds - (meet.steady / final if final > 0.0 else 0.0)
    if way <= NEAR:
        return final
    if seconds <= 2.0 * step:  # it is late
        return final
    if speed == 0.0 and 2.0 * way < final * seconds:
        return 0.0
    middle = max(0.5 * (4.0 * way / seconds - speed - final), 0.0)
    return max(speed + (middle - speed) * min(2.0 * step / seconds, 1.0), 0.0)


def _seconds_to(way: float, speed: float) -> float:
    """Returns the time that a vehicle takes for a way (m) at a speed (m/s): infinite if it stands, 0 if it is beyond."""
    if way <= 0.0:
        return 0.0
    return way / speed if speed > 1e-3 else inf


class Actions:
    """The actions of all vehicles of a scenario."""

    def __init__(
        self, vehicles: Mapping[str, TrafficEntry], lateral: Lateral, stretch: Stretch, paths: Mapping[str, PathVehicle]
    ) -> None:
        """`vehicles` have ids; `lateral` and `stretch` belong to the road; `paths` are the vehicles that SUMO does not know."""
        self._paths = paths
        self._entries = [(name, action) for name, vehicle in vehicles.items() for action in vehicle.actions]
        self._vehicles, self._lateral, self._stretch = vehicles, lateral, stretch
        self.reset()

    def reset(self) -> None:
        """Forgets what has happened, for another run."""
        self._waiting: list[tuple[str, Action, Watch | None]] = [(name, action, None) for name, action in self._entries]
        self._late: list[tuple[str, CutIn]] = []
        self._speeding: dict[str, _Speeding] = {}
        self._shifts: dict[str, _Shift] = {}
        self._meets: dict[str, Meet] = {}
        self._events = Events()

    @property
    def pending(self) -> bool:
        """Some action is still to be done."""
        return bool(self._waiting or self._late or self._speeding or self._shifts or self._meets)

    def act(self, time: float, step: float, vehicles: Mapping[str, Moving], stretch: float) -> None:
        """Begins and continues actions for the step from `time` on. `vehicles`, ego among them, and `stretch` are as in `Moment`.

        Vehicles that have left the network do nothing. Vehicles that are due to cut in inside of a junction do so behind it, on the edge
        whose lanes the scenario numbers.
        """
        moment = Moment(time, vehicles, stretch, self._stretch)
        self._events.follow(moment.vehicles, step)
        waiting: list[tuple[str, Action, Watch | None]] = []
        due: list[tuple[str, Action]] = [*self._late]
        for name, action, known in self._waiting:
            watch = Watch(name, action, step) if known is None else known
            if watch.is_due(moment, self._events) and name in vehicles:
                due.append((name, action))
            else:
                waiting.append((name, action, watch))
        self._waiting, self._late = waiting, []
        for name, action in due:
            if isinstance(action, CutIn) and (name not in vehicles or sumo.vehicle.getRoadID(name).startswith(":")):
                self._late.append((name, action))
            else:
                self._begin(name, action, moment)
        for name in [name for name in self._speeding if name in vehicles]:
            self._speed(name, moment, step)
        for name in [name for name in self._shifts if name in vehicles]:
            self._shift(name, time + step)
        for name in list(self._meets):
            self._meet(name, moment, step)

    def _begin(self, name: str, action: Action, moment: Moment) -> None:
        vehicle = sumo.vehicle
        self._events.begun.add(action.id or "")
        if action.ends:
            self._end(name, action.ends)
        if isinstance(action, Wait):
            self._events.done.add(action.id or "")
            return
        if isinstance(action, (Brake, Meet)):
            if name in self._speeding:
                self._events.done.add(self._speeding.pop(name).brake.id or "")
            if name in self._meets:
                self._events.done.add(self._meets.pop(name).id or "")
        if isinstance(action, Meet):
            self._meets[name] = action
            return
        if isinstance(action, Brake):
            path = self._paths.get(name)
            speed = vehicle.getSpeed(name) if path is None else path.speed
            target = _target(action, moment, speed)
            rate = _rate(action, speed, target)
            # A speed that is already that of the other vehicle says no rate at which to keep to it.
            self._speeding[name] = _Speeding(action, speed, target, DEFAULT_RATE if action.continuous and rate == 0.0 else rate)
            if path is None:
                vehicle.setSpeedMode(name, FREE if self._vehicles[name].model == "constant" else FREE_BUT_SAFE)
            return
        if name in self._shifts:
            self._events.done.add(self._shifts[name].action or "")
        offset = vehicle.getLateralLanePosition(name)
        if isinstance(action, Drift):
            way = action.offset - offset
            seconds = action.seconds or DEFAULT_SECONDS
            if action.lateral_acceleration is not None:
                seconds = max(sqrt(PEAK_ACCELERATION * abs(way) / action.lateral_acceleration), SHORTEST)
            self._shifts[name] = _Shift(action.id, moment.time, seconds, offset, way)
            return
        edge, index = vehicle.getRoadID(name), vehicle.getLaneIndex(name)
        count = sumo.edge.getLaneNumber(edge)
        centres = [_aside(name, edge, index, lane) for lane in range(count)]
        target_lane = action.lane
        if target_lane is None:
            left = 0.0
            if action.beside is not None:
                left = self._left(name, action.beside, moment) + offset
            base = min(range(count), key=lambda lane: abs(centres[lane] - left))
            target_lane = base + (action.by or 0)
        if not 0 <= target_lane < count:
            raise NoResultError(
                f"{name} cannot cut into lane {target_lane} of edge {edge} at {moment.time:g} s, which has {count} lanes"
            )
        way = centres[target_lane] - offset
        seconds = action.seconds or DEFAULT_SECONDS
        if action.metres is not None:
            seconds = action.metres / max(vehicle.getSpeed(name), SLOWEST_BRAKING)
        elif action.lateral_speed is not None:
            seconds = PEAK_SPEED * abs(way) / action.lateral_speed
        lanes = range(index, target_lane, 1 if target_lane > index else -1)
        ways = [centres[lane + lanes.step] - centres[lane] for lane in lanes]
        self._shifts[name] = _Shift(action.id, moment.time, max(seconds, SHORTEST), offset, way, target_lane - index, ways=ways)

    def _end(self, name: str, ended: Collection[str]) -> None:
        """Ends the running ones of these actions of a vehicle: it keeps its speed, and its place in its lane.

        What is done at once is done already, also if it has begun in this step.
        """
        running, shift = self._speeding.get(name), self._shifts.get(name)
        if running is not None and running.brake.id in ended:
            running.brake = running.brake.model_copy(update={"hold": None, "continuous": False})
            running.target, running.until = running.target if running.rate == inf else running.speed, None
        if name in self._meets and self._meets[name].id in ended:
            self._events.done.add(self._meets.pop(name).id or "")
        if shift is not None and shift.action in ended and shift.seconds > SHORTEST:
            self._events.done.add(shift.action or "")
            del self._shifts[name]
        late = [action.id or "" for _, action in self._late if action.id in ended]
        self._late = [entry for entry in self._late if entry[1].id not in ended]
        self._events.begun.update(late)
        self._events.done.update(late)

    def _left(self, name: str, other: str, moment: Moment) -> float:
        """Returns how far to the left of a vehicle the lane of another one is (m)."""
        if other not in moment.vehicles or isnan(moment.vehicles[other].s):
            raise NoResultError(f"{name} cannot change to the lane of {other} at {moment.time:g} s: it has left the road")
        own, there = moment.vehicles[name], moment.vehicles[other]
        left = self._lateral(there.s, there.d, own.s) - own.d
        return left if own.speed >= 0.0 else -left

    def _speed(self, name: str, moment: Moment, step: float) -> None:
        running, time = self._speeding[name], moment.time
        if running.until is not None and time >= running.until - 1e-9:
            self._events.done.add(running.brake.id or "")
            vehicle = self._vehicles[name]
            if vehicle.model != "constant":
                sumo.vehicle.setSpeedMode(name, MODEL)
                sumo.vehicle.setSpeed(name, -1)
                del self._speeding[name]
                return
            running.brake = running.brake.model_copy(update={"hold": None, "continuous": False})
            running.target, running.until = vehicle.speed, None
        if running.brake.continuous:
            running.target = _target(running.brake, moment, running.target)
        change, target = running.rate * step, running.target
        speed = max(running.speed - change, target) if running.speed > target else min(running.speed + change, target)
        running.speed = speed
        if name in self._paths:
            self._paths[name].speed = speed
        else:
            sumo.vehicle.setSpeed(name, speed)
        if speed != target or running.until is not None:
            return
        if running.brake.hold is not None:
            running.until = time + step + running.brake.hold
        elif not running.brake.continuous:
            self._events.done.add(running.brake.id or "")

    def _meet(self, name: str, moment: Moment, step: float) -> None:
        """Gives a vehicle on a path the speed with which it meets another one; it keeps its last speed if the other one has gone."""
        meet, path = self._meets[name], self._paths[name]
        other = moment.vehicles.get(meet.other)
        speed = None
        if other is not None and not isnan(other.s):
            stretch = moment.stretch if meet.other == EGO else moment.stretch_at(other.s, other.d)
            seconds = _seconds_to((meet.other_s - other.s) * stretch, other.speed)
            speed = meeting_speed(meet, path.along, path.speed, seconds, step)
        if speed is None:
            self._events.done.add(meet.id or "")
            del self._meets[name]
        path.speed = path.speed if speed is None else speed

    def _shift(self, name: str, time: float) -> None:
        """Moves a vehicle sideways, and into the next lane when its centre crosses the marking, or after the junction."""
        running, vehicle = self._shifts[name], sumo.vehicle
        offset = running.at(time) - running.passed
        side = (running.steps > 0) - (running.steps < 0)
        if side:
            edge, index = vehicle.getRoadID(name), vehicle.getLaneIndex(name)
            half = 0.5 * sumo.lane.getWidth(f"{edge}_{index}")
            if side * offset > half and not edge.startswith(":") and 0 <= index + side < sumo.edge.getLaneNumber(edge):
                running.enter(time, _aside(name, edge, index, index + side))
                vehicle.moveTo(name, f"{edge}_{index + side}", vehicle.getLanePosition(name))
                running.steps -= side
                offset = running.at(time) - running.passed
        vehicle.setLateralLanePosition(name, offset)
        if time >= running.begin + running.seconds - 1e-9 and not running.steps:
            self._events.done.add(running.action or "")
            del self._shifts[name]


def _target(brake: Brake, moment: Moment, otherwise: float) -> float:
    """Returns the speed to be reached, `otherwise` if the vehicle to compare with has left the network."""
    if brake.like is None:
        return brake.speed
    other = moment.vehicles.get(brake.like)
    return otherwise if other is None else max(brake.factor * abs(other.speed) + brake.speed, 0.0)


def _rate(brake: Brake, speed: float, target: float) -> float:
    """Returns the rate (m/s²) of a change of speed."""
    if brake.seconds is not None:
        return abs(target - speed) / brake.seconds if brake.seconds > 0.0 else inf
    if brake.metres is not None:
        return abs(target**2 - speed**2) / (2.0 * brake.metres)
    return DEFAULT_RATE if brake.rate is None else brake.rate


def _aside(name: str, edge: str, lane: int, other: int) -> float:
    """Returns how far to the left of its lane's centre that of another lane is (m), as `moveTo` moves a vehicle: others may lie between."""
    at = sumo.vehicle.getLanePosition(name)

    def point(index: int, position: float) -> tuple[float, float]:
        x, y = sumo.simulation.convert2D(edge, min(max(position, 0.0), sumo.lane.getLength(f"{edge}_{index}")), index)
        return x, y

    (x, y), (there_x, there_y), before, after = point(lane, at), point(other, at), point(lane, at - 1.0), point(lane, at + 1.0)
    heading = atan2(after[1] - before[1], after[0] - before[0])
    return (there_y - y) * cos(heading) - (there_x - x) * sin(heading)
