"""Checks of the actions of a scenario of kind `highway`: triggers, conditions, and the vehicles and actions that they name."""

from collections.abc import Collection, Iterator, Sequence

from drivecal.bundles.highway import TrafficEntry
from drivecal.bundles.highway_actions import EGO, Action, Brake, Condition, CutIn, Drift, Meet, Trigger
from drivecal.contracts.input_errors import nearest
from drivecal.domain.errors import Problem

RELATIVE = frozenset({"gap", "headway", "ttc"})
"""Quantities between two vehicles."""


def actions_problems(
    field: str, traffic: Sequence[TrafficEntry], *, is_whole: bool, others: Collection[str] = ()
) -> Iterator[Problem]:
    """Yields the faults of all actions.

    Args:
        field: The scenario's in the manifest.
        traffic: The vehicles with their actions.
        is_whole: Every vehicle is among `traffic` and `others`, so that unknown names are faults.
        others: Ids of vehicles of a route file.
    """
    named_here = (vehicle.id or f"vehicle{index}" for index, vehicle in enumerate(traffic))
    vehicles = [EGO, *named_here, *others] if is_whole else None
    ids: dict[str, str] = {}
    actions = [
        (f"{field}.traffic[{index}].actions[{number}]", vehicle, action)
        for index, vehicle in enumerate(traffic)
        for number, action in enumerate(vehicle.actions)
    ]
    for place, _, action in actions:
        if action.id is not None and action.id in ids:
            yield Problem(f"{place}.id", f"the id {action.id} is taken", "give each action another id")
        elif action.id is not None:
            ids[action.id] = place
    for place, vehicle, action in actions:
        yield from _trigger(place, action)
        yield from _content(place, vehicle, action)
        siblings = [other.id for other in vehicle.actions if other.id is not None and other is not action]
        yield from _unknown(
            [(f"{place}.ends[{number}]", name) for number, name in enumerate(action.ends)],
            siblings,
            "other action of the vehicle",
        )
        named = [(f"{place}.{key}", getattr(action, key, None)) for key in ("like", "beside", "other")]
        for section in ("after", "when"):
            for number, condition in enumerate(getattr(action, section) or ()):
                inner = f"{place}.{section}[{number}]"
                yield from _condition(inner, condition)
                named += [(f"{inner}.{key}", getattr(condition, key)) for key in ("vehicle", "to")]
                if is_whole:
                    parts = [(f"{inner}.{key}", getattr(condition, key)) for key in ("begun", "done")]
                    yield from _unknown(parts, list(ids), "action")
        if vehicles is not None:
            yield from _unknown(named, vehicles, "vehicle of `traffic`")


def _unknown(named: Sequence[tuple[str, str | None]], known: Sequence[str], noun: str) -> Iterator[Problem]:
    for field, name in named:
        if name is not None and name not in known:
            yield Problem(field, f"there is no {noun} {name}", nearest(name, known))


def _trigger(field: str, trigger: Trigger) -> Iterator[Problem]:
    given = [name for name in ("time", "gap", "s", "when") if getattr(trigger, name) is not None]
    if len(given) != 1:
        message = f"the action has {' and '.join(given) or 'nothing'} to begin at"
        yield Problem(field, message, "give exactly one of time, gap, s and when")


def _condition(field: str, condition: Condition) -> Iterator[Problem]:
    given = [name for name in ("quantity", "begun", "done") if getattr(condition, name) is not None]
    limits = [name for name in ("above", "below") if getattr(condition, name) is not None]
    if len(given) != 1:
        message = f"the condition has {' and '.join(given) or 'nothing'} to wait for"
        yield Problem(field, message, "give exactly one of quantity, begun and done")
    elif len(limits) != (condition.quantity is not None):
        message = f"the condition has {' and '.join(limits) or 'no limit'}"
        yield Problem(field, message, "give above or below with a quantity, and none of them without")
    elif condition.to is not None and condition.quantity not in RELATIVE:
        yield Problem(f"{field}.to", f"{given[0]} is of one vehicle", "leave it out")
    elif condition.quantity == "distance" and (condition.s is None or condition.below is None):
        yield Problem(field, "a distance needs a place and a limit", "give `s` and `below`")
    elif condition.quantity != "distance" and (condition.s is not None or condition.d != 0.0):
        yield Problem(f"{field}.{'d' if condition.s is None else 's'}", f"{given[0]} is measured to no place", "leave it out")


def _content(field: str, vehicle: TrafficEntry, action: Action) -> Iterator[Problem]:
    if isinstance(action, Brake):
        yield from _at_most_one(field, action, ("rate", "seconds", "metres"))
        if action.like is None and action.speed < 0.0:
            yield Problem(f"{field}.speed", f"{action.speed:g} m/s is below 0", "give 0 or more, or `like` a vehicle")
        if action.like is None and (action.continuous or action.factor != 1.0):
            key = "continuous" if action.continuous else "factor"
            yield Problem(f"{field}.{key}", "there is no vehicle to compare with", "add `like`, or leave it out")
        return
    if isinstance(action, Meet) and vehicle.path is None:
        yield Problem(field, "the vehicle has no path", "add `path`, or brake")
    if isinstance(action, CutIn | Drift) and vehicle.path is not None:
        yield Problem(field, "the vehicle moves along a path, on no lane", "give its way by the path")
    if isinstance(action, Drift):
        yield from _at_most_one(field, action, ("seconds", "lateral_acceleration"))
    if not isinstance(action, CutIn):
        return
    yield from _at_most_one(field, action, ("seconds", "metres", "lateral_speed"))
    if (action.lane is None) == (action.by is None):
        message = "the action has no lane to change to" if action.lane is None else "the action has lane and by"
        yield Problem(f"{field}.lane", message, "give exactly one of lane and by")
    if action.beside is not None and action.by is None:
        yield Problem(f"{field}.beside", "the lane is given by its index", "give `by` instead of `lane`")
    if vehicle.lane_change != "none":
        remedy = "leave out `lane_change`: SUMO's model would change back"
        yield Problem(field, f"the vehicle changes lanes by {vehicle.lane_change}", remedy)


def _at_most_one(field: str, action: Action, names: Sequence[str]) -> Iterator[Problem]:
    given = [name for name in names if getattr(action, name) is not None]
    if len(given) > 1:
        yield Problem(field, f"the action has {' and '.join(given)}", f"give one of {', '.join(names)}")
