"""Conditions on which the actions of the traffic's vehicles begin, evaluated once per step of the traffic."""

from collections.abc import Callable, Mapping
from math import ceil, copysign, hypot, isnan
from typing import NamedTuple

from drivecal.bundles.highway_actions import EGO, Condition, Trigger

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


def straight(_: float, __: float) -> float:
    """Returns the stretch of a straight road."""
    return 1.0


class Moment(NamedTuple):
    """The vehicles at a time (s). `stretch`: metres of the ego vehicle's way per metre of s; `stretch_at`: that of others."""

    time: float
    vehicles: Mapping[str, Moving]
    stretch: float
    stretch_at: Stretch = straight


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
        """`name`: of the vehicle that acts; `step`: of the traffic (s)."""
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
        if condition.above is not None:
            return value >= condition.above - ROUNDING
        return condition.below is not None and value <= condition.below + ROUNDING

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
