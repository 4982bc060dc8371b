"""SUMO route files: vehicle types, routes, vehicles, trips and flows become entries of a scenario's traffic.

What is left out has SUMO's defaults. Elements without effect on the drive are noted; all others are refused by line.
"""

import re
from collections.abc import Mapping
from typing import Any

from drivecal.bundles.highway import CLASSES
from drivecal.bundles.highway_catalogue import TYPE_PARAMETERS
from drivecal.bundles.traffic.elements import Element, Notes, finite, read_tree
from drivecal.bundles.traffic.entries import Entry, VehicleNames
from drivecal.bundles.traffic.routes import joined
from drivecal.contracts.input_errors import nearest
from drivecal.contracts.strict_json import shown
from drivecal.roads.network import Network

DEFAULT_TYPE = "DEFAULT_VEHTYPE"
MODELS = ("Krauss", "IDM", "EIDM", "ACC", "CACC", "W99")
LANE_CHANGES = ("LC2013", "SL2015")
MIN_GAP, SIGMA = 2.5, 0.5
"""SUMO's defaults."""
MOST_VEHICLES = 500
MOST_WAYS = 100
"""Different ways of trips, which are searched for."""
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
ARRIVAL = {"arrivalPos": "max", "arrivalSpeed": "current", "arrivalLane": "current", "arrivalPosLat": ""}
"""SUMO's default of each attribute that decides how a vehicle leaves, at the end of its route."""
TYPE_WORDS = frozenset({"vClass", "carFollowModel", "laneChangeModel", "speedFactor"})
VEHICLE = frozenset({"type", "depart", "departLane", "departPos", "departSpeed", "route", "from", "to", "via", *ARRIVAL})
FLOW = (VEHICLE - {"depart"}) | {"begin", "end", "number", "vehsPerHour", "perHour", "period", "probability"}
LANES = ("first", "best", "allowed", "free", "random")
PLACES = ("base", "last", "free", "random", "random_free")
SPEEDS = ("max", "desired", "avg", "last", "speedLimit", "random")
PEOPLE = ("person", "personFlow", "container", "containerFlow")
_FACTOR = re.compile(r"normc?\(([^,()]*),([^,()]*)(?:,([^,()]*),([^,()]*))?\)")
_RATE = re.compile(r"exp\(([^()]*)\)")
LONG = 1e9


class RouteFile:
    """The traffic of a route file."""

    def __init__(self, content: bytes, name: str, network: Network, duration: float, names: VehicleNames) -> None:
        """Reads a file. `name`: the file's; `duration`: the scenario's (s); `names`: of all vehicles. Raises InvalidInputError."""
        self._root = read_tree(content, name, "routes")
        self._network, self._duration, self._names = network, duration, names
        self._notes = Notes(name)
        self._types: dict[str, Element] = {}
        self._routes: dict[str, Element] = {}
        self._ways: dict[tuple[str, ...], list[str] | None] = {}
        self.entries: list[Entry] = []
        for element in self._root.children:
            self._take(element)
        self.notes = self._notes.texts(self._root)

    def _take(self, element: Element) -> None:
        kind = element.element
        if kind == "vType":
            element.is_read = True
            _named(self._types, element)
        elif kind == "route":
            element.is_read = True
            _named(self._routes, element)
        elif kind in {"vehicle", "trip", "flow"}:
            element.is_read = True
            self._vehicle(element)
        elif kind not in PEOPLE:
            raise element.fault("the element is not supported", "give vType, route, vehicle, trip and flow")

    def _vehicle(self, element: Element) -> None:
        """Adds the entry of a vehicle, trip or flow."""
        is_flow = element.element == "flow"
        _check_attributes(element, FLOW if is_flow else VEHICLE)
        _check_stops(element)
        _check_arrival(element)
        driver = self._driver(element)
        edges = self._edges(element)
        begin = _seconds(element, "begin", 0.0) if is_flow else _seconds(element, "depart", None)
        if begin >= self._duration:
            self._notes.add(element, f"it begins after the scenario's duration of {self._duration:g} s, and is left out")
            return
        if len(self.entries) == MOST_VEHICLES:
            message = f"the file has more than {MOST_VEHICLES} vehicles, trips and flows until the scenario's end"
            raise element.fault(message, "leave out vehicles that are never met, or make flows of them")
        length = driver["length"]
        start = _start(element, length)
        name = self._names.new(element.text("id"), element)
        base: dict[str, Any] = driver | {"id": name, "edge": edges[0], "route": edges}
        if is_flow:
            self.entries.append(Entry("flows", base | start | {"begin": begin} | self._amount(element, begin), element))
            return
        if begin <= 0.0 and (placed := self._placed(start, edges[0], length)) is not None:
            self.entries.append(Entry("traffic", base | placed, element))
        else:
            self.entries.append(
                Entry("flows", base | start | {"begin": max(begin, 0.0), "per_hour": 3600.0, "number": 1}, element)
            )

    def _driver(self, element: Element) -> dict[str, Any]:
        """Returns the fields of a driver that SUMO's type has."""
        name = element.text("type", DEFAULT_TYPE)
        kind = self._types.get(name)
        if kind is None and name != DEFAULT_TYPE:
            raise element.fault(f"there is no vType {shown(name)} before it", nearest(name, list(self._types)))
        if kind is None:
            return _driver({}) | {"model": "Krauss", "sigma": SIGMA}
        _check_attributes(kind, TYPE_WORDS | NUMBERS.keys() | TYPE_PARAMETERS)
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

    def _edges(self, element: Element) -> list[str]:
        """Returns the edges of a vehicle's route."""
        inner = element.optional("route")
        if inner is not None or "route" in element.values:
            name = element.text("route", "")
            route = self._routes.get(name) if inner is None else inner
            if route is None:
                raise element.fault(f"there is no route {shown(name)} before it", nearest(name, list(self._routes)))
            _check_attributes(route, {"edges"})
            _check_stops(route)
            edges = route.text("edges").split()
            if not edges:
                raise route.fault("the route has no edges", "give it edges")
            return self._known(route, edges)
        stops = [element.text("from"), *element.text("via", "").split(), element.text("to")]
        stops = self._known(element, stops)
        if tuple(stops) not in self._ways:
            if len(self._ways) == MOST_WAYS:
                raise element.fault(f"the trips have more than {MOST_WAYS} different ways", "give routes instead of trips")
            self._ways[tuple(stops)] = joined(self._network, stops)
        way = self._ways[tuple(stops)]
        if way is None:
            raise element.fault(f"no way leads over {', '.join(map(shown, stops))}", "give a route")
        return way

    def _known(self, element: Element, edges: list[str]) -> list[str]:
        for edge in edges:
            if edge not in self._network.edges or self._network.edges[edge].function != "":
                roads = [name for name in self._network.edges if not name.startswith(":")]
                raise element.fault(f"the network has no edge {shown(edge, 80)}", nearest(edge, roads))
        return edges

    def _placed(self, start: Mapping[str, Any], edge: str, length: float) -> dict[str, Any] | None:
        """Returns the place of a vehicle that is there from the start, None if SUMO must look for one."""
        lanes = self._network.edges[edge].lanes
        lane, s, speed = start["lane"], start["s"], start["speed"]
        if lane == "first":
            lane = next((entry.index for entry in lanes if entry.for_cars), 0)
        if isinstance(lane, str) or lane >= len(lanes) or isinstance(speed, str):
            return None
        if s == "base":
            s = 0.5 * length
        return None if isinstance(s, str) or s > lanes[lane].length else {"lane": lane, "s": s, "speed": speed}

    def _amount(self, element: Element, begin: float) -> dict[str, Any]:
        """Returns how many vehicles a flow has, and when they come."""
        given = [key for key in ("vehsPerHour", "perHour", "period", "probability") if key in element.values]
        end = _seconds(element, "end", None) if "end" in element.values else None
        number = element.integer("number", 1, 10_000) if "number" in element.values else None
        amount: dict[str, Any] = {"number": number, "end": end}
        if len(given) > 1:
            raise element.fault(f"it has {' and '.join(given)}", "give one of them")
        if not given:
            if number is None or end is None or end <= begin:
                raise element.fault("how many vehicles come is not said", "give vehsPerHour, period, or number, begin and end")
            return amount | {"per_hour": number * 3600.0 / (end - begin)}
        key = given[0]
        if key == "period" and (match := _RATE.fullmatch(element.text("period").replace(" ", ""))):
            rate = finite(match[1])
            if rate is None or rate <= 0.0:
                raise element.fault(f"period is {shown(element.text('period'))}, which is not a rate", "give e.g. exp(0.2)")
            return amount | {"per_hour": 3600.0 * rate, "random": True}
        value = element.number(key, 1e-6, 1.0 if key == "probability" else LONG)
        if key == "probability":
            self._notes.add(element, "vehicles come at random with the same mean, but at any time instead of once a second")
            return amount | {"per_hour": 3600.0 * value, "random": True}
        return amount | {"per_hour": 3600.0 / value if key == "period" else value}


def _driver(numbers: Mapping[str, float], vehicle_class: str = "passenger") -> dict[str, Any]:
    """Returns a driver with SUMO's defaults."""
    length, width, deviation = CLASSES[vehicle_class]
    defaults = {"length": length, "width": width, "min_gap": MIN_GAP, "speed_deviation": deviation, "lane_change": "LC2013"}
    return defaults | dict(numbers) | {"vehicle_class": vehicle_class}


def _named(table: dict[str, Element], element: Element) -> None:
    name = element.text("id")
    if name in table:
        raise element.fault("another one has the same id", "rename one")
    table[name] = element


def _check_attributes(element: Element, known: "frozenset[str] | set[str]") -> None:
    """Raises InvalidInputError for an attribute that is neither known nor without effect."""
    for key in element.values:
        if key not in known and key not in WITHOUT_EFFECT:
            raise element.fault(f"the attribute {shown(key)} is not supported", f"leave it out; {nearest(key, sorted(known))}")


def _check_arrival(element: Element) -> None:
    """Raises InvalidInputError for a vehicle that leaves elsewhere than at the end of its last edge, or in another way than it comes."""
    for key, default in ARRIVAL.items():
        if (text := element.text(key, default)) != default:
            remedy = f"give {default}, or leave it out" if default else "leave it out"
            raise element.fault(f"{key} is {shown(text, 40)}, but vehicles drive on to the end of their route", remedy)


def _check_stops(element: Element) -> None:
    for stop in element.every("stop"):
        raise stop.fault("stops are not supported", "leave the stop out")


def _seconds(element: Element, key: str, default: float | None) -> float:
    """Returns a time in seconds, which may be written as hours, minutes and seconds with colons."""
    parts = element.text(key, None if default is None else repr(default)).split(":")
    values = [finite(part) for part in parts]
    if not 1 <= len(parts) <= 4 or any(value is None for value in values):
        raise element.fault(f"{key} is {shown(element.text(key), 40)}, which is not a time", "give seconds, e.g. 12.5")
    seconds = 0.0
    for value, unit in zip(reversed(values), (1.0, 60.0, 3600.0, 86400.0), strict=False):
        seconds += (value or 0.0) * unit
    if not abs(seconds) <= LONG:
        raise element.fault(f"{key} is {shown(element.text(key), 40)}, which is not a time", "give seconds, e.g. 12.5")
    return seconds


def _start(element: Element, length: float) -> dict[str, Any]:
    """Returns lane, place and speed at which a vehicle departs, as numbers or SUMO's words: `departPos` is that of its front."""
    lane: int | str = element.text("departLane", "first")
    if lane not in LANES:
        lane = element.integer("departLane", 0, 30)
    place, speed = (
        text if (text := element.text(key, default)) in words else element.number(key, 0.0, LONG, finite(default))
        for key, words, default in (("departPos", PLACES, "base"), ("departSpeed", SPEEDS, "0"))
    )
    if not isinstance(place, str):
        place = place - 0.5 * length if place > 0.5 * length else "base"
    return {"lane": lane, "s": place, "speed": speed}
