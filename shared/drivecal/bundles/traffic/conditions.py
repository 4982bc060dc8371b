"""Start triggers of OpenSCENARIO files as conditions of actions."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from math import inf
from typing import Any

from drivecal.bundles.traffic.elements import Element, Notes, parameter_holds
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError

MOST_PARTS = 10_000


@dataclass(eq=False, slots=True)
class Part:
    """A part of a storyboard: the names from its story to itself, the part around it, and the ids of the traffic's actions inside."""

    kind: str
    element: Element
    path: tuple[str, ...]
    owner: "Part | None"
    actions: list[str] = field(default_factory=list)
    begin: str = ""
    """Id of the action without effect that begins with an act. Empty for other parts."""

    @property
    def act(self) -> "Part":
        """The act around the part, or the part itself if it is an act or a story."""
        return self if self.kind == "act" or self.owner is None else self.owner.act

    def add(self, action: str) -> None:
        """Adds an action to the part and to those around it."""
        self.actions.append(action)
        if self.owner is not None:
            self.owner.add(action)

    def holds(self, element: Element) -> bool:
        """Returns whether an element lies inside of the part."""
        around: Element | None = element
        while around is not None and around is not self.element:
            around = around.parent
        return around is not None

    def __str__(self) -> str:
        return f"{shown('::'.join(self.path), 200)} (line {self.element.line})"


class Parts:
    """All parts of a storyboard."""

    def __init__(self) -> None:
        self._by_names: dict[tuple[str, tuple[str, ...]], list[Part]] = {}
        self._count = 0

    def new(self, kind: str, element: Element, owner: Part | None = None) -> Part:
        """Returns a part of a kind as references call it. Raises InvalidInputError if there are too many."""
        self._count += 1
        if self._count > MOST_PARTS:
            raise element.fault(f"the storyboard has more than {MOST_PARTS:,} parts", "leave some out")
        outer = owner.path if owner is not None else ()
        begin = f"act{self._count}" if kind == "act" else ""
        part = Part(kind, element, (*outer, element.text("name", "")), owner, begin=begin)
        for around in {names for size in range(len(outer) + 1) for names in combinations(outer, size)}:
            self._by_names.setdefault((kind, (*around, part.path[-1])), []).append(part)
        return part

    def referred(self, condition: Element) -> Part:
        """Returns the part that a condition refers to: by its name, after any names of parts around it, in their order.

        Raises InvalidInputError if there is none with actions of the traffic, or several.
        """
        kind, reference = condition.text("storyboardElementType"), condition.text("storyboardElementRef")
        parts = self._by_names.get((kind, tuple(reference.split("::"))), [])
        if len(parts) > 1:
            raise _ambiguous(condition, reference, parts)
        if not parts or not parts[0].actions:
            message = f"there is no {shown(kind, 40)} {shown(reference, 200)} with actions of the traffic"
            raise condition.fault(message, "give an element of the file that does not drive the ego vehicle only")
        return parts[0]


def _ambiguous(condition: Element, reference: str, parts: list[Part]) -> InvalidInputError:
    message = f"{shown(reference, 200)} may be {parts[0]} or {parts[1]}"
    if parts[0].path == parts[1].path:
        return condition.fault(message, "rename one of them")
    return condition.fault(message, "put names of the elements around it before its name, with :: between them")


LARGEST = 1e6
NEAR = 0.01
"""Metres between a vehicle's centre and its reference point that are not noted."""
MOST_CONDITIONS = 20
"""Conditions of a trigger."""
ABOVE = ("greaterThan", "greaterOrEqual")
BELOW = ("lessThan", "lessOrEqual")
ENDED = ("completeState", "endTransition")
BEGUN = ("startTransition", "runningState")
STAYS = {"rising": False}
"""Begun and done actions stay so: their edge is no moment that could be missed."""
Conditions = list[dict[str, Any]]
Reached = Callable[[Element], tuple[float, float]]
"""Returns s and d of the scenario's route at a <Position>."""


class Triggers:
    """Reads the triggers of a storyboard."""

    def __init__(
        self, ids: Mapping[str, str], centres: Mapping[str, float], parts: Parts, reached: Reached, notes: Notes
    ) -> None:
        """`ids` maps names of entities to ids of vehicles. `centres` maps ids to the distance (m) from a vehicle's reference point forward
        to its centre. `parts` must hold all parts of the storyboard."""
        self._ids, self._centres, self._parts, self._reached, self._notes = ids, centres, parts, reached, notes

    def conditions(self, trigger: Element | None) -> Conditions:
        """Returns conditions that must all hold at the same time. A trigger without any fires at once. Raises InvalidInputError."""
        groups = trigger.every("ConditionGroup") if trigger is not None else []
        if len(groups) > 1:
            raise groups[1].fault("alternatives (several groups) are not supported", "give one group of conditions")
        conditions = [condition for group in groups for condition in group.every("Condition")]
        if len(conditions) > MOST_CONDITIONS:
            raise conditions[MOST_CONDITIONS].fault(f"the trigger has more than {MOST_CONDITIONS} conditions", "leave some out")
        return [entry for condition in conditions for entry in self._condition(condition)]

    def _condition(self, condition: Element) -> Conditions:
        edge = condition.word("conditionEdge", ("none", "rising"), "none")
        delay = condition.number("delay", 0.0, 3600.0, 0.0)
        kind = condition.only("ByValueCondition", "ByEntityCondition")
        entries = self._of_value(kind, delay) if kind.element == "ByValueCondition" else self._of_entity(kind)
        if len(entries) > MOST_CONDITIONS:
            raise condition.fault(f"the condition is on more than {MOST_CONDITIONS} actions or entities", "leave some out")
        is_rising = edge == "rising"
        if is_rising and len(entries) > 1 and kind.element == "ByEntityCondition":
            # They rise together when the last of them does, which no condition of one of them says.
            raise condition.fault("the rising edge of a condition on several entities is not supported", 'give "none"')
        common = {"rising": is_rising, "delay": delay}
        held = delay == 0.0 and kind.element == "ByValueCondition" and all(entry.get("above", 1.0) <= 0.0 for entry in entries)
        return [] if held else [common | entry for entry in entries]  # the time is above 0 as soon as the scenario runs

    def _of_value(self, kind: Element, delay: float) -> Conditions:
        condition = kind.only("SimulationTimeCondition", "ParameterCondition", "StoryboardElementStateCondition")
        if condition.element == "SimulationTimeCondition":
            return [{"quantity": "time"} | _limit(condition)]
        if condition.element == "ParameterCondition":
            return [{"quantity": "time", "above": 0.0 if parameter_holds(condition) else LARGEST} | STAYS]
        state = condition.word("state", ENDED + BEGUN)
        part = self._parts.referred(condition)
        if state in ENDED:
            return [{"done": action} | STAYS for action in part.actions]
        if part.kind in {"event", "action"}:
            return [{"begun": part.actions[0]} | STAYS]
        if part.kind == "story":
            return [{"quantity": "time", "above": 0.0} | STAYS]
        return [] if delay == 0.0 and part.act.holds(condition) else [{"begun": part.act.begin} | STAYS]

    def _of_entity(self, kind: Element) -> Conditions:
        triggering = kind.only("TriggeringEntities")
        rule = triggering.word("triggeringEntitiesRule", ("any", "all"))
        entities = [entity.entity(self._ids) for entity in triggering.every("EntityRef")[: MOST_CONDITIONS + 1]]
        if not entities or (rule == "any" and len(entities) > 1):
            raise triggering.fault("any of several entities is not supported", "give one entity")
        condition = kind.only("EntityCondition").only(
            "RelativeDistanceCondition",
            "TimeHeadwayCondition",
            "TimeToCollisionCondition",
            "TraveledDistanceCondition",
            "ReachPositionCondition",
            "SpeedCondition",
        )
        quantity = self._quantity(condition)
        self._note_centres(condition, quantity, entities)
        return [quantity | {"vehicle": entity} for entity in entities]

    def _note_centres(self, condition: Element, quantity: Mapping[str, Any], entities: Sequence[str]) -> None:
        """Notes a distance of reference points that centres have at another moment."""
        if quantity["quantity"] != "distance" and not quantity.get("centres", False):
            return
        other = self._centres.get(str(quantity.get("to")), 0.0)
        metres = max((abs(self._centres.get(entity, 0.0) - other) for entity in entities), default=0.0)
        if metres > NEAR:
            text = f"measured from centres, not from reference points, up to {metres:.2f} m apart for vehicles of one direction"
            self._notes.add(condition, text)

    def _quantity(self, condition: Element) -> dict[str, Any]:
        kind = condition.element
        if kind == "TraveledDistanceCondition":
            return {"quantity": "travelled", "above": condition.number("value", 0.0, LARGEST)}
        if kind == "ReachPositionCondition":
            tolerance = condition.number("tolerance", 0.0, LARGEST)
            s, d = self._reached(condition.only("Position"))
            return {"quantity": "distance", "s": s, "d": d, "below": tolerance}
        if kind == "SpeedCondition":
            condition.word("direction", ("longitudinal",), "longitudinal")
            return {"quantity": "speed"} | _limit(condition)
        target = (
            condition.only("TimeToCollisionConditionTarget").only("EntityRef")
            if kind == "TimeToCollisionCondition"
            else condition
        )
        axis = condition.text("relativeDistanceType", "longitudinal")
        if axis in {"euclidianDistance", "cartesianDistance"}:
            self._notes.add(condition, f"{axis} is measured along the road")
        elif axis != "longitudinal":
            raise condition.fault(f"the {axis[:40]} distance is not supported", "give longitudinal")
        if (system := condition.text("coordinateSystem", "road")) not in {"road", "lane"}:
            self._notes.add(condition, f"measured along the road, not in the coordinate system {shown(system, 40)}")
        names = {"RelativeDistanceCondition": "gap", "TimeHeadwayCondition": "headway", "TimeToCollisionCondition": "ttc"}
        centres = not condition.decides("freespace", "true")
        return {"quantity": names[kind], "to": target.entity(self._ids), "centres": centres} | _limit(condition)


def _limit(condition: Element) -> dict[str, float]:
    """Returns the limit of a condition. The time is above a value as soon as it is there: it goes on."""
    rule = condition.word("rule", ABOVE + BELOW)
    strict = rule == "lessThan" or (rule == "greaterThan" and condition.element != "SimulationTimeCondition")
    return {"above" if rule in ABOVE else "below": condition.number("value", -LARGEST, LARGEST), "strict": strict}


def stop_time(group: Element) -> float | None:
    """Returns the time (s) at which a group of a StopTrigger is fulfilled, None if not only the time decides that."""
    times = []
    for condition in group.every("Condition"):
        condition.text("conditionEdge", "none")  # a time that has come once stays so
        value = condition.optional("ByValueCondition")
        time = value.optional("SimulationTimeCondition") if value is not None else None
        if time is None or time.word("rule", (*ABOVE, "lessThan", "lessOrEqual", "equalTo", "notEqualTo")) not in ABOVE:
            return None
        times.append(time.number("value", 0.0, inf) + condition.number("delay", 0.0, inf, 0.0))
    return max(times, default=None)
