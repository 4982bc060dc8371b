"""Actions of the traffic's vehicles in scenarios of the simulator `highway`, and the conditions that start them."""

from typing import Annotated, Literal

from pydantic import Field, StringConstraints

from drivecal.contracts.specification import Model

VehicleId = Annotated[str, StringConstraints(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9_-]+$")]
Lane = Annotated[int, Field(ge=0, le=30)]
"""Index of a lane as in SUMO: 0 is the rightmost."""
Position = Annotated[float, Field(ge=0, le=1e6)]
Speed = Annotated[float, Field(ge=0, le=100)]
Seconds = Annotated[float, Field(ge=0, le=100_000)]
EGO = "ego"
"""Id of the controlled vehicle."""


class Condition(Model):
    """A condition of an action: a `quantity` is `above` or `below` a value, or other actions, by id, have `begun` or are `done`.
    The value itself counts as above and below it, except for a `strict` condition.

    `time` is in s. `speed` (m/s), `s` (m, along the scenario's route) and `travelled` (m, since the start) belong to `vehicle`, by default
    the acting vehicle. `gap` (m, along the road), `headway` (s) and `ttc` (s) lead from it to the vehicle `to`, by default ego: between
    bumpers, or with `centres` between centres. `headway` needs `to` ahead, `ttc` vehicles that approach each other. `distance` (m)
    leads from the vehicle's centre to the point at `s` (m) of the scenario's route, `d` (m) to its left; its least in a step counts.

    A `rising` condition must have been false in the step before. With `delay` (s, in whole steps), its state of that time ago counts.
    """

    quantity: Literal["time", "speed", "s", "travelled", "gap", "headway", "ttc", "distance"] | None = None
    vehicle: VehicleId | None = None
    to: VehicleId | None = None
    centres: bool = False
    s: Position | None = None
    d: Annotated[float, Field(ge=-1000, le=1000)] = 0.0
    above: Annotated[float, Field(ge=-1e6, le=1e6)] | None = None
    below: Annotated[float, Field(ge=-1e6, le=1e6)] | None = None
    strict: bool = False
    begun: VehicleId | None = None
    done: VehicleId | None = None
    rising: bool = False
    delay: Annotated[float, Field(ge=0, le=3600)] = 0.0


class Trigger(Model):
    """Begin of an action: at a `time` (s), or when the ego vehicle is within `gap` (m, between bumpers), or at `s` (m) of the
    scenario's route, or `when` all conditions are fulfilled at once. `after`: conditions that must have been fulfilled before, all at once.
    `ends`: other actions of the vehicle, by id, which end if they run then: it keeps the speed and the place in its lane that it has.
    """

    id: VehicleId | None = None
    time: Seconds | None = None
    gap: Annotated[float, Field(ge=0, le=1000)] | None = None
    s: Position | None = None
    when: Annotated[list[Condition], Field(max_length=20)] | None = None
    after: Annotated[list[Condition], Field(max_length=20, default_factory=list)]
    ends: Annotated[list[VehicleId], Field(max_length=50, default_factory=list)]


class Brake(Trigger):
    """The vehicle brakes, or accelerates, to `speed` at `rate` (m/s²), and holds it for `hold` seconds, by default to the end.

    `like` names another vehicle: its speed times `factor` is added to `speed`, with `continuous` in every step. `rate` defaults to 4;
    `seconds` or `metres` replace it with the duration or the distance of the change.
    """

    do: Literal["brake"]
    speed: Annotated[float, Field(ge=-100, le=100)] = 0.0
    like: VehicleId | None = None
    factor: Annotated[float, Field(ge=0, le=100)] = 1.0
    continuous: bool = False
    rate: Annotated[float, Field(gt=0, le=20)] | None = None
    seconds: Annotated[float, Field(ge=0, le=3600)] | None = None
    metres: Annotated[float, Field(gt=0, le=10_000)] | None = None
    hold: Seconds | None = None


class CutIn(Trigger):
    """The vehicle changes to `lane` of its edge, in `seconds`, even into a gap that is too small.

    `by` replaces `lane`: the number of lanes to the left of its own lane, or of the lane of the vehicle `beside`. `metres` or
    `lateral_speed` (m/s, at most) replace `seconds`.
    """

    do: Literal["cut_in"]
    lane: Lane | None = None
    by: Annotated[int, Field(ge=-30, le=30)] | None = None
    beside: VehicleId | None = None
    seconds: Annotated[float, Field(gt=0, le=60)] | None = None
    metres: Annotated[float, Field(gt=0, le=10_000)] | None = None
    lateral_speed: Annotated[float, Field(gt=0, le=20)] | None = None


class Drift(Trigger):
    """The vehicle drifts to `offset` (m, to the left of its lane's centre) in `seconds`, or at most at `lateral_acceleration` (m/s²)."""

    do: Literal["drift"]
    offset: Annotated[float, Field(ge=-50, le=50)]
    seconds: Annotated[float, Field(gt=0, le=600)] | None = None
    lateral_acceleration: Annotated[float, Field(gt=0, le=20)] | None = None


class Meet(Trigger):
    """The vehicle, which has a `path`, is `at` (m along it) when the vehicle `other` is at `other_s` (m) of the scenario's route.

    `speed`: its own there, which it has `steady` metres before; without it, it drives at the speed that brings it there in time.
    """

    do: Literal["meet"]
    other: VehicleId = EGO
    other_s: Annotated[float, Field(ge=-1e6, le=1e6)]
    at: Position
    speed: Speed | None = None
    steady: Annotated[float, Field(ge=0, le=10_000)] = 0.0


class Wait(Trigger):
    """The vehicle does nothing. The action is done as soon as it begins, and other actions may wait for that."""

    do: Literal["wait"]


Action = Annotated[Brake | CutIn | Drift | Meet | Wait, Field(discriminator="do")]
