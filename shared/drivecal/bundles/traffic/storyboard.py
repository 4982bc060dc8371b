"""The storyboard of an OpenSCENARIO file: events of its maneuvers become actions of the traffic's vehicles."""

from collections.abc import Iterator, Mapping, Sequence
from math import inf
from typing import Any, NamedTuple

from drivecal.bundles.highway_actions import EGO
from drivecal.bundles.traffic.conditions import LARGEST, Part, Parts, Reached, Triggers, stop_time
from drivecal.bundles.traffic.elements import Element, Notes, declare, parameter_holds
from drivecal.bundles.traffic.places import MOST_ASIDE, Map
from drivecal.bundles.traffic.ways import Polyline, WayReader
from drivecal.contracts.strict_json import shown

MOST_ACTIONS = 2_000
IMMEDIATE = 0.1
"""Seconds of a change of lanes that the file wants in no time."""
FASTEST_ASIDE = 20.0
"""Largest lateral acceleration (m/s²) of a drift."""
SHAPES = ("linear", "cubic", "sinusoidal", "step")
ENDING = ("override", "overwrite")
"""Priorities of events that end the running events of their maneuver."""


class _Planned(NamedTuple):
    """An action of the file: its id, the vehicle that does it, the element of the action itself, its event with the maneuver.

    For the begin of an act, `action` and `event` are the act itself.
    """

    id: str
    vehicle: str
    action: Element
    event: Part


class Ways(NamedTuple):
    """Edges of each vehicle on lanes, beginning with its start, and paths of the other ones, by id."""

    edges: Mapping[str, list[str]]
    roads: Map
    paths: Mapping[str, Polyline]
    reader: WayReader


class Storyboard:
    """The actions of a storyboard, by vehicle."""

    def __init__(
        self,
        root: Element,
        ids: Mapping[str, str],
        centres: Mapping[str, float],
        ways: Ways,
        reached: Reached,
        duration: float,
        notes: Notes,
    ) -> None:
        """Reads a storyboard. `ids` and `centres` have the form that `Triggers` expects. Raises InvalidInputError."""
        self._ids, self._ways, self._notes, self._centres, self._reached = ids, ways, notes, centres, reached
        self._duration = duration
        self._parts = Parts()
        self._count = 0
        planned = list(self._planned(root))
        triggers = Triggers(ids, centres, self._parts, reached, notes)
        self.actions: dict[str, list[dict[str, Any]]] = {}
        idle: dict[str, _Planned] = {}
        for entry in planned:
            act = entry.event.act
            idle[act.begin] = _Planned(act.begin, entry.vehicle, act.element, act)
            contents = list(self._content(entry))
            ends = self._ended(entry, planned)
            if not contents:
                idle[entry.id] = entry
                if ends:
                    self._notes.add(entry.event.element, "ends no other event, for nothing of it is driven")
            for content in contents:
                document = {"id": entry.id, "ends": ends} | self._begin(entry, triggers) | content
                self.actions.setdefault(entry.vehicle, []).append(document)
        driven = [(vehicle, action) for vehicle, actions in self.actions.items() for action in actions]
        for _, action in driven:
            action["ends"] = [name for name in action["ends"] if name not in idle]
        self._add_awaited(driven, idle, triggers)
        for entry in idle.values():
            for trigger in entry.event.element.every("StartTrigger") if entry.event.kind == "event" else ():
                trigger.skip()

    @staticmethod
    def _begin(entry: _Planned, triggers: Triggers) -> dict[str, Any]:
        """Returns the conditions on which an action begins."""
        of_act, of_event = (
            triggers.conditions(part.element.optional("StartTrigger")) for part in (entry.event.act, entry.event)
        )
        return {"after": of_act if entry.event.kind == "event" else [], "when": of_event}

    def _add_awaited(self, driven: list[tuple[str, dict[str, Any]]], idle: dict[str, _Planned], triggers: Triggers) -> None:
        """Adds the actions without effect for which others wait: they have begun and are done once, as any other."""
        while driven:
            vehicle, action = driven.pop()
            names = {condition.get("done", condition.get("begun")) for condition in action["after"] + action["when"]}
            for name in sorted(names & idle.keys()):
                entry = idle.pop(name)
                awaited = {"id": entry.id, "do": "wait"} | self._begin(entry, triggers)
                whose = entry.vehicle if entry.event.kind == "event" else vehicle
                self.actions.setdefault(whose, []).append(awaited)
                driven.append((whose, awaited))

    def _planned(self, root: Element) -> Iterator[_Planned]:
        """Yields the actions of the traffic's vehicles, and adds notes on the ego vehicle's actions."""
        for element in root.every("Story"):
            declare(element, {})
            story = self._parts.new("story", element)
            for act in (self._parts.new("act", act, story) for act in element.every("Act")):
                if _never_begins(act.element):
                    act.element.skip()
                    self._notes.add(act.element, "never begins: a condition on a parameter does not hold")
                    continue
                for group in (self._parts.new("maneuverGroup", group, act) for group in act.element.every("ManeuverGroup")):
                    yield from self._group(group)
                self._check_stop(act)

    def _check_stop(self, act: Part) -> None:
        """Raises InvalidInputError if an act with actions of the traffic may stop before the end."""
        stops = act.element.every("StopTrigger")
        for group in (group for trigger in stops for group in trigger.every("ConditionGroup")):
            if act.actions and ((time := stop_time(group)) is None or time < self._duration):
                message = "an act that may stop before the end is not supported"
                raise group.fault(message, "leave the StopTrigger out, and end actions by an event of priority override")
            group.skip()
            self._notes.add(group, "ignored: the act stops no action of the traffic before the end")

    def _group(self, group: Part) -> Iterator[_Planned]:
        """Yields the actions of a group of maneuvers, for each of its actors."""
        actors = group.element.only("Actors")
        if actors.decides("selectTriggeringEntities", "false"):
            raise actors.fault("triggering entities as actors are not supported", "name the actors")
        self._note_order(group.element)
        names = [actor.entity(self._ids) for actor in actors.every("EntityRef")]
        if not names:
            group.element.skip()
            self._notes.add(group.element, "ignored: it has no actor")
        listed = group.element.every("Maneuver", "CatalogReference") if names else []
        for element in listed:
            if element.element == "Maneuver":
                declare(element, {})
        whole = [
            self._ways.reader.catalogs.entry(element, "Maneuver") if element.element != "Maneuver" else element
            for element in listed
        ]
        for maneuver in (self._parts.new("maneuver", element, group) for element in whole):
            for event in (self._parts.new("event", event, maneuver) for event in maneuver.element.every("Event")):
                self._note_order(event.element)
                for action in (self._parts.new("action", action, event) for action in event.element.every("Action")):
                    for vehicle in names:
                        if vehicle == EGO:
                            self._skip(event)
                        else:
                            yield self._named(vehicle, action, event)

    def _note_order(self, element: Element) -> None:
        """Notes what an element says about the order of events that is driven otherwise."""
        if element.text("maximumExecutionCount", "1").strip() != "1":
            self._notes.add(element, "driven once")
        if element.word("priority", ("parallel", "skip", *ENDING), "parallel") == "skip":
            self._notes.add(element, "driven also while other events run")

    def _named(self, vehicle: str, action: Part, event: Part) -> _Planned:
        self._count += 1
        if self._count > MOST_ACTIONS:
            raise action.element.fault(f"there are more than {MOST_ACTIONS:,} actions", "leave some out")
        name = f"action{self._count}"
        action.add(name)
        return _Planned(name, vehicle, action.element, event)

    def _ended(self, entry: _Planned, planned: Sequence[_Planned]) -> list[str]:
        """Returns the actions that end when an action begins: the same vehicle's, from the other events of its maneuver."""
        if entry.event.element.text("priority", "parallel") not in ENDING or entry.event.owner is None:
            return []
        others = set(entry.event.owner.actions).difference(entry.event.actions)
        return [other.id for other in planned if other.vehicle == entry.vehicle and other.id in others]

    def _skip(self, event: Part) -> None:
        event.element.skip()
        for trigger in event.act.element.every("StartTrigger"):
            trigger.skip()
        self._notes.add(event.element, "ignored for the ego vehicle: the problem's controller drives it")

    def _content(self, entry: _Planned) -> Iterator[dict[str, Any]]:
        """Yields what an action is as a document, nothing if it has no effect on the traffic."""
        private = entry.action.only("PrivateAction", "GlobalAction")
        if private.element == "GlobalAction":
            ignore_global(private, self._notes)
            return
        kind = private.only(
            "LongitudinalAction",
            "LateralAction",
            "ControllerAction",
            "VisibilityAction",
            "AppearanceAction",
            "ActivateControllerAction",
            "SynchronizeAction",
        )
        if kind.element == "SynchronizeAction":
            yield self._meeting(kind, entry.vehicle)
        elif kind.element == "LongitudinalAction":
            yield from speed_action(kind.only("SpeedAction"), self._ids, self._notes)
        elif kind.element == "LateralAction":
            lateral = kind.only("LaneChangeAction", "LaneOffsetAction")
            change = self._lane_change if lateral.element == "LaneChangeAction" else self._offset
            yield change(lateral, entry.vehicle)
        else:
            ignore_controller(kind, self._notes)

    def _meeting(self, action: Element, vehicle: str) -> dict[str, Any]:
        """Returns a SynchronizeAction as the document of a `meet`."""
        if vehicle not in self._ways.paths:
            raise action.fault(
                "an entity on a lane is not synchronised", "give it a FollowTrajectoryAction or AssignRouteAction in <Init>"
            )
        master = action.text("masterEntityRef")
        if master not in self._ids:
            raise action.fault(f"there is no entity {shown(master)}", f"give one of {', '.join(list(self._ids)[:10])}")
        other = self._ids[master]
        s, _ = self._reached(action.only("TargetPositionMaster"))
        pose = self._ways.reader.pose(action.only("TargetPosition"), {}, {}, ())
        at = self._ways.paths[vehicle].along(pose)[0] + self._centres[vehicle]
        document = {"do": "meet", "other": other, "other_s": s + self._centres[other], "at": at}
        final = action.optional("FinalSpeed")
        if final is None:
            return document
        wanted = final.only("AbsoluteSpeed")
        speed = wanted.number("value", 0.0, 100.0)
        steady = wanted.optional("TargetDistanceSteadyState", "TargetTimeSteadyState")
        metres = 0.0
        if steady is not None and steady.element == "TargetDistanceSteadyState":
            metres = steady.number("distance", 0.0, 10_000.0)
        elif steady is not None:
            metres = steady.number("time", 0.0, 100.0) * speed
        return document | {"speed": speed, "steady": metres}

    def _lane_change(self, action: Element, vehicle: str) -> dict[str, Any]:
        if vehicle in self._ways.paths:
            raise action.fault("the entity is on no lane", "give its way by its trajectory or route")
        if abs(action.number("targetLaneOffset", -10.0, 10.0, 0.0)) > 0.0:
            raise action.fault("targetLaneOffset is not supported", "give a LaneOffsetAction after the change of lanes")
        return {"do": "cut_in"} | self._sideways(action.only("LaneChangeActionDynamics")) | self._target(action, vehicle)

    def _sideways(self, dynamics: Element) -> dict[str, float]:
        """Returns how a change of lanes is done: drivecal's motion has the same time, distance or largest lateral speed."""
        shape = dynamics.word("dynamicsShape", SHAPES)
        dimension = dynamics.word("dynamicsDimension", ("time", "distance", "rate"))
        value = dynamics.number("value", -LARGEST, LARGEST)
        if shape == "step" or value == 0.0:
            self._notes.add(dynamics, f"driven in {IMMEDIATE:g} s")
            return {"seconds": IMMEDIATE}
        if shape != "sinusoidal":
            self._notes.add(dynamics, "driven with least jerk, in the same time or distance, or at most the same lateral speed")
        if dimension == "rate":
            return {"lateral_speed": abs(value)}
        return {"seconds" if dimension == "time" else "metres": value}

    def _target(self, action: Element, vehicle: str) -> dict[str, Any]:
        target = action.only("LaneChangeTarget").only("RelativeTargetLane", "AbsoluteTargetLane")
        if target.element == "RelativeTargetLane":
            other = target.entity(self._ids)
            lanes = target.integer("value", -30, 30)
            widest = max(len(self._ways.roads.network.edges[edge].lanes) for edge in self._ways.edges[vehicle])
            if abs(lanes) >= widest:
                message = f"the vehicle's direction has only {widest} lanes, and none changes to those of the other direction"
                raise target.fault(message, f"give a value between {1 - widest} and {widest - 1}")
            return ({} if other == vehicle else {"beside": other}) | {"by": lanes}
        number = target.integer("value", -64, 64)
        indices = {self._ways.roads.lane_index(edge, number) for edge in self._ways.edges[vehicle]} - {None}
        if len(indices) > 1:
            message = f"lane {number} has several places among the lanes of the vehicle's way"
            raise target.fault(message, "give a RelativeTargetLane")
        if not indices:
            known = ", ".join(self._ways.roads.lane_numbers(self._ways.edges[vehicle]))
            message = f"lane {number} is not of the vehicle's direction, and no vehicle changes to a lane of the other one"
            raise target.fault(message, f"give one of {known}" if known else "give a RelativeTargetLane")
        return {"lane": indices.pop()}

    def _offset(self, action: Element, vehicle: str) -> dict[str, Any]:
        if action.decides("continuous", "false"):
            raise action.fault("an offset that is kept continuously is not supported", 'give continuous="false"')
        dynamics = action.only("LaneOffsetActionDynamics")
        target = action.only("LaneOffsetTarget").only("AbsoluteTargetLaneOffset")
        offset = target.number("value", -MOST_ASIDE, MOST_ASIDE)
        sides = {number.startswith("-") for number in self._ways.roads.lane_numbers(self._ways.edges.get(vehicle, ()))}
        if offset and len(sides) > 1:
            message = "the vehicle's way has right and left lanes of its roads, whose offsets count to different sides"
            raise target.fault(message, "give a route over lanes of one side, or a value of 0")
        drift = {"do": "drift", "offset": -offset if False in sides else offset}
        acceleration = dynamics.number("maxLateralAcc", 1e-3, inf, inf)
        shape = dynamics.word("dynamicsShape", SHAPES, "sinusoidal")
        if shape == "step":
            self._notes.add(dynamics, f"driven in {IMMEDIATE:g} s")
            return drift | {"seconds": IMMEDIATE}
        if shape != "sinusoidal":
            self._notes.add(dynamics, "driven with least jerk")
        if acceleration == inf:
            self._notes.add(dynamics, "driven in the default time: it has no maxLateralAcc")
            return drift
        return drift | {"lateral_acceleration": min(acceleration, FASTEST_ASIDE)}


def _never_begins(act: Element) -> bool:
    """Returns whether an act waits for a condition on a parameter that does not hold."""
    groups = [group for trigger in act.every("StartTrigger") for group in trigger.every("ConditionGroup")]
    results = []
    for group in groups:
        values = [value for condition in group.every("Condition") for value in condition.every("ByValueCondition")]
        results.append(all(parameter_holds(each) for value in values for each in value.every("ParameterCondition")))
    return bool(results) and not any(results)


def speed_action(action: Element, ids: Mapping[str, str], notes: Notes) -> Iterator[dict[str, Any]]:
    """Yields a change of speed as the document of a `brake`, nothing if its rate is 0."""
    dynamics = action.only("SpeedActionDynamics")
    shape = dynamics.word("dynamicsShape", SHAPES)
    dimension = dynamics.word("dynamicsDimension", ("time", "distance", "rate"))
    value = abs(dynamics.number("value", -LARGEST, LARGEST))
    target = action.only("SpeedActionTarget").only("AbsoluteTargetSpeed", "RelativeTargetSpeed")
    content = {"do": "brake"} | target_speed(target, ids)
    if shape == "step" or (value == 0.0 and dimension != "rate"):
        yield content | {"seconds": 0.0}
        return
    if value == 0.0:
        notes.add(dynamics, "ignored: a rate of 0 changes nothing")
        return
    if shape != "linear":
        notes.add(dynamics, "driven with constant acceleration")
    yield content | {{"time": "seconds", "distance": "metres", "rate": "rate"}[dimension]: value}


def target_speed(target: Element, ids: Mapping[str, str]) -> dict[str, Any]:
    """Returns the fields of a `brake` that say to which speed."""
    value = target.number("value", -100.0, 100.0)
    if target.element == "AbsoluteTargetSpeed":
        return {"speed": value}
    other = target.entity(ids)
    kind = target.word("speedTargetValueType", ("delta", "factor"))
    relative = {"speed": value} if kind == "delta" else {"factor": value, "speed": 0.0}
    return {"like": other, "continuous": target.decides("continuous", "false")} | relative


def ignore_controller(kind: Element, notes: Notes) -> None:
    """Notes an action without effect on the traffic. Raises InvalidInputError if a controller of the file would drive a vehicle."""
    inner = [kind, *kind.every("ActivateControllerAction", "AssignControllerAction", "OverrideControllerValueAction")]
    for element in inner:
        if element.element == "ActivateControllerAction" and any(
            element.decides(key, "false") for key in ("lateral", "longitudinal")
        ):
            raise element.fault("a controller would drive a vehicle of the traffic", "give SpeedAction and LaneChangeAction")
    kind.skip()
    notes.add(kind, "ignored")


def ignore_global(action: Element, notes: Notes) -> None:
    """Notes an action of the surroundings without effect on the traffic. Raises InvalidInputError for others."""
    kind = action.only("EnvironmentAction", "InfrastructureAction", "VariableAction", "ParameterAction")
    kind.skip()
    notes.add(action, "ignored" if kind.element != "ParameterAction" else "ignored: conditions know the declared value")
