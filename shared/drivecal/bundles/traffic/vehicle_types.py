"""Vehicle types of SUMO route files and their distributions, from which the seed draws the type of each vehicle."""

import re
from collections.abc import Mapping, Sequence
from itertools import accumulate
from random import Random
from typing import Any

from drivecal.bundles.highway import CLASSES
from drivecal.bundles.highway_catalogue import TYPE_PARAMETERS
from drivecal.bundles.traffic.departures import LONG
from drivecal.bundles.traffic.elements import Element, Notes, finite
from drivecal.contracts.input_errors import nearest
from drivecal.contracts.strict_json import shown

DEFAULT_TYPE = "DEFAULT_VEHTYPE"
MODELS = ("Krauss", "IDM", "EIDM", "ACC", "CACC", "W99")
LANE_CHANGES = ("LC2013", "SL2015")
MIN_GAP, SIGMA = 2.5, 0.5
"""SUMO's defaults."""
NUMBERS = {
    "length": "length",
    "width": "width",
    "maxSpeed": "max_speed",
    "tau": "time_headway",
    "minGap": "min_gap",
    "accel": "acceleration",
    "decel": "deceleration",
    "sigma": "sigma",
    "speedDev": "speed_deviation",
}
"""Fields of a driver by attributes of types."""
WITHOUT_EFFECT = frozenset(
    {"id", "color", "guiShape", "imgFile", "osgFile", "height", "mass", "emissionClass", "line", "cost"}
    | {"personCapacity", "containerCapacity", "personNumber", "containerNumber", "boardingDuration", "loadingDuration"}
)
"""Attributes that decide nothing on the way."""
TYPE = TYPE_PARAMETERS | NUMBERS.keys() | {"vClass", "carFollowModel", "laneChangeModel", "speedFactor", "probability"}
_FACTOR = re.compile(r"normc?\(([^,()]*),([^,()]*)(?:,([^,()]*),([^,()]*))?\)")


class VehicleTypes:
    """Types and distributions of a file. Seed and id of a vehicle decide which type is drawn for it, whatever other vehicles there are."""

    def __init__(self, seed: int, notes: Notes) -> None:
        self._seed, self._notes = seed, notes
        self._types: dict[str, Element] = {}
        self._distributions: dict[str, tuple[Sequence[str], Sequence[float]]] = {}

    def add(self, element: Element) -> None:
        """Adds a `vType` or a `vTypeDistribution`. Raises InvalidInputError."""
        element.is_read = True
        name = element.text("id")
        if name in self._types or name in self._distributions:
            raise element.fault("another one has the same id", "rename one")
        if element.element == "vType":
            self._types[name] = element
        else:
            self._distributions[name] = self._distribution(element)

    def shares(self, element: Element) -> dict[str, float]:
        """Returns the types of a flow and their shares; a single one if its type is no distribution. Raises InvalidInputError."""
        name = element.text("type", DEFAULT_TYPE)
        if name not in self._distributions:
            return {name: 1.0}
        types, weights = self._distributions[name]
        return {kind: weight / sum(weights) for kind, weight in zip(types, weights, strict=True)}

    def drawn(self, element: Element, vehicle: str) -> str:
        """Returns the type of a vehicle, by its id, or of one of a flow. Raises InvalidInputError."""
        name = element.text("type", DEFAULT_TYPE)
        if name not in self._distributions:
            return name
        types, weights = self._distributions[name]
        place = Random(f"{self._seed} {vehicle}").random() * sum(weights)  # noqa: S311  # a repeatable draw, no secret
        return next((kind for kind, border in zip(types, accumulate(weights), strict=True) if place < border), types[-1])

    def driver(self, name: str, element: Element) -> dict[str, Any]:
        """Returns the fields of a driver that SUMO's type has. `element`: of the vehicle, for messages. Raises InvalidInputError."""
        kind = self._types.get(name)
        if kind is None and name != DEFAULT_TYPE:
            raise element.fault(
                f"there is no vType {shown(name)} before it", nearest(name, [*self._types, *self._distributions])
            )
        if kind is None:
            return _driver({}) | {"model": "Krauss", "sigma": SIGMA}
        check_attributes(kind, TYPE)
        numbers = {field: kind.number(key, -LONG, LONG) for key, field in NUMBERS.items() if key in kind.values}
        if "speedFactor" in kind.values:
            numbers |= self._speed_factor(kind)
        model = kind.word("carFollowModel", MODELS, "Krauss")
        driver = _driver(numbers, kind.word("vClass", CLASSES, "passenger"))
        driver |= {"model": model, "lane_change": kind.word("laneChangeModel", LANE_CHANGES, "LC2013")}
        if model == "Krauss":
            driver.setdefault("sigma", SIGMA)
        elif driver.pop("sigma", None) is not None:
            self._notes.add(kind, f"sigma has no effect on {model}")
        driver["parameters"] = {
            key: kind.number(key, -LONG, LONG) for key in kind.values if key in TYPE_PARAMETERS and key not in NUMBERS
        }
        return driver

    def _distribution(self, element: Element) -> tuple[Sequence[str], Sequence[float]]:
        """Returns the types that can be drawn and their weights: those inside of the element, and those that it names."""
        check_attributes(element, {"vTypes", "probabilities"})
        names = element.text("vTypes", "").split()
        for name in names:
            if name not in self._types and name != DEFAULT_TYPE:
                raise element.fault(f"there is no vType {shown(name)} before it", nearest(name, list(self._types)))
        weights = [self._weight(name) for name in names]
        if "probabilities" in element.values:
            given = [finite(part) for part in element.text("probabilities").split()]
            weights = [value for value in given if value is not None and 0.0 <= value <= LONG]
            if not len(given) == len(weights) == len(names):
                message = f"it has {len(names)} vTypes and {len(weights)} probabilities from 0 on"
                raise element.fault(message, "give one number for each of vTypes")
        for child in element.every("vType"):
            self.add(child)
            names.append(child.text("id"))
            weights.append(self._weight(names[-1]))
        for child in element.children:
            if not child.is_read:
                raise child.fault("the element is not supported here", "give vType")
        drawn = [(name, weight) for name, weight in zip(names, weights, strict=True) if weight > 0.0]
        if not drawn:
            raise element.fault("no type can be drawn of it", "give it a vType with a probability above 0")
        if len({name for name, _ in drawn}) < len(drawn):
            raise element.fault("it has a vType twice", "give each once")
        return [name for name, _ in drawn], [weight for _, weight in drawn]

    def _weight(self, name: str) -> float:
        """Returns the weight of a type in distributions, by default 1 as in SUMO."""
        return self._types[name].number("probability", 0.0, LONG, 1.0) if name in self._types else 1.0

    def _speed_factor(self, kind: Element) -> dict[str, float]:
        """Returns mean and deviation of a type's speed factor."""
        text = kind.text("speedFactor").replace(" ", "")
        match = _FACTOR.fullmatch(text)
        if match is None:
            return {"speed_factor": kind.number("speedFactor", 0.0, 100.0)}
        values = [None if part is None else finite(part) for part in match.groups()]
        if values[0] is None or values[1] is None or (match[3] is not None and None in values):
            raise kind.fault(f"speedFactor is {shown(text)}, which is not a distribution", "give e.g. normc(1,0.1,0.2,2)")
        if values[2:] not in ([None, None], [0.2, 2.0]):
            self._notes.add(kind, "speedFactor is cut off at 0.2 and 2, SUMO's default")
        return {"speed_factor": values[0], "speed_deviation": values[1]}


def check_attributes(element: Element, known: "frozenset[str] | set[str]") -> None:
    """Raises InvalidInputError for an attribute that is neither known nor without effect."""
    for key in element.values:
        if key not in known and key not in WITHOUT_EFFECT:
            raise element.fault(f"the attribute {shown(key)} is not supported", f"leave it out; {nearest(key, sorted(known))}")


def _driver(numbers: Mapping[str, float], vehicle_class: str = "passenger") -> dict[str, Any]:
    """Returns a driver with SUMO's defaults."""
    length, width, deviation = CLASSES[vehicle_class]
    defaults = {"length": length, "width": width, "min_gap": MIN_GAP, "speed_deviation": deviation, "lane_change": "LC2013"}
    return defaults | dict(numbers) | {"vehicle_class": vehicle_class}
