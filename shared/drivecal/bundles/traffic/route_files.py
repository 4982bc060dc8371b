"""SUMO route files: their elements and attributes are checked against a list, and SUMO drives what they say.

SUMO ignores misspelt attributes, and reads or writes other files if an element says so: nothing beyond the list is passed on.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import inf
from typing import Final
from xml.etree import ElementTree as ET

from drivecal.bundles.highway import CLASSES, Surroundings
from drivecal.bundles.highway_actions import EGO
from drivecal.bundles.highway_catalogue import TYPE_PARAMETERS
from drivecal.bundles.traffic.elements import Element, Notes, finite, read_tree
from drivecal.contracts.input_errors import nearest
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError
from drivecal.roads.network import Network

MOST_VEHICLES = 2000
"""Vehicles, trips and flows that belong to a run."""
MOST_EARLIER = 1_000_000
"""Departures of a flow before a run, which SUMO counts one by one."""
MOST_PER_HOUR = 10_000.0
LONG = 1e9
SUBLANE: Final = "SL2015"
MODELS = ("Krauss", "IDM", "EIDM", "ACC", "CACC", "W99")
LANE_CHANGES = ("LC2013", SUBLANE)
NUMBERS: Mapping[str, tuple[float, float]] = {
    **dict.fromkeys(TYPE_PARAMETERS, (-LONG, LONG)),
    **dict.fromkeys(("length", "width"), (0.1, 100.0)),
    **dict.fromkeys(("accel", "decel", "emergencyDecel", "apparentDecel", "tau", "maxSpeed"), (1e-3, LONG)),
    **dict.fromkeys(("minGap", "probability", "duration"), (0.0, LONG)),
    **dict.fromkeys(("sigma", "speedDev"), (0.0, 1.0)),
    **dict.fromkeys(("vehsPerHour", "perHour"), (1e-3, MOST_PER_HOUR)),
    "number": (1.0, 10_000.0),
}
"""Bounds of attributes that are numbers."""
WORDS: Mapping[str, Iterable[str]] = {"vClass": CLASSES, "carFollowModel": MODELS, "laneChangeModel": LANE_CHANGES}
WITHOUT_EFFECT = frozenset(
    {"color", "guiShape", "imgFile", "osgFile", "height", "mass", "emissionClass", "line", "cost"}
    | {"personCapacity", "containerCapacity", "personNumber", "containerNumber", "boardingDuration", "loadingDuration"}
)
"""Attributes that decide nothing on the way; they are not passed on."""
_DEPARTING = frozenset(
    {"id", "type", "route", "from", "to", "via", "speedFactor", "departLane", "departPos", "departPosLat", "departSpeed"}
    | {"arrivalLane", "arrivalPos", "arrivalPosLat", "arrivalSpeed"}
)
KNOWN: Mapping[str, frozenset[str]] = {
    "vType": TYPE_PARAMETERS
    | {"id", "length", "width", "maxSpeed", "speedDev", "speedFactor", "probability"}
    | {"vClass", "carFollowModel", "laneChangeModel"},
    "vTypeDistribution": frozenset({"id", "vTypes", "probabilities"}),
    "route": frozenset({"id", "edges", "probability"}),
    "routeDistribution": frozenset({"id", "routes", "probabilities"}),
    "vehicle": _DEPARTING | {"depart"},
    "trip": _DEPARTING | {"depart"},
    "flow": _DEPARTING | {"begin", "end", "number", "vehsPerHour", "perHour", "period", "probability"},
    "stop": frozenset({"lane", "edge", "startPos", "endPos", "duration", "until"}),
}
"""Attributes of elements that are passed on."""
INSIDE: Mapping[str, tuple[str, ...]] = {
    "vTypeDistribution": ("vType",),
    "routeDistribution": ("route",),
    "route": ("stop",),
    **dict.fromkeys(("vehicle", "trip", "flow"), ("route", "stop")),
}
IGNORED = ("param", "person", "personFlow", "container", "containerFlow")
"""Elements that are listed and not passed on."""
_RATE = re.compile(r"exp\(([^()]*)\)")
_FACTOR = re.compile(r"normc?\([^()]*\)")


@dataclass(frozen=True, slots=True)
class RouteTraffic:
    """The traffic of a route file in a run.

    Attributes:
        content: The file that SUMO reads: the types, the routes, and the vehicles that depart in the run or its warm-up.
        starting: Ids of the vehicles that depart at the run's time 0.
        vehicles: Ids of all vehicles and trips.
        lane_changes: Models of lane changes; SUMO's default is LC2013.
        notes: What is ignored or left out, with the lines.
    """

    content: bytes
    starting: tuple[str, ...]
    vehicles: frozenset[str]
    lane_changes: frozenset[str]
    notes: tuple[str, ...]


def read_routes(content: bytes, name: str, network: Network, scenario: Surroundings, duration: float) -> RouteTraffic:
    """Checks a route file.

    Args:
        content: The file.
        name: Its name in messages.
        network: The network on which it drives.
        scenario: Times of the run, and the other vehicles, whose ids are taken.
        duration: Seconds of the run.

    Raises:
        InvalidInputError: The file says what is not on the list, or no vehicle of it departs in the run.
    """
    return _Reader(read_tree(content, name, "routes"), name, network, scenario, duration).traffic()


class _Reader:
    """The reading of one file."""

    def __init__(self, root: Element, name: str, network: Network, scenario: Surroundings, duration: float) -> None:
        self._root, self._name, self._network = root, name, network
        self._begin, self._first = scenario.begin, scenario.begin - scenario.warm_up
        self._end = scenario.begin + duration
        self._notes = Notes(name)
        self._types, self._routes = {"DEFAULT_VEHTYPE"}, set[str]()
        self._taken = {EGO, *(entry.id or f"vehicle{index}" for index, entry in enumerate(scenario.traffic))}
        self._times: list[float] = []
        self._early = 0
        self._departing: list[tuple[float, Element]] = []

    def traffic(self) -> RouteTraffic:
        """Returns what is left of the file."""
        written = ET.Element("routes")
        for element in self._root.children:
            if element.element in {"vehicle", "trip", "flow"}:
                self._depart(element)
            elif element.element in {"vType", "vTypeDistribution", "route", "routeDistribution"}:
                self._check(element)
                written.append(_copied(element))
            elif element.element not in IGNORED:
                raise element.fault(
                    "the element is not supported", "give vType, route, their distributions, vehicle, trip and flow"
                )
        if not self._departing:
            raise self._empty()
        self._departing.sort(key=lambda entry: entry[0])  # SUMO skips vehicles that are out of order
        written.extend(_copied(element) for _, element in self._departing)
        notes = self._notes.texts(self._root)
        if self._early:
            early = f"{self._early:,} of {len(self._times):,} vehicles, trips and flows depart before {_time(self._first)} s"
            notes += (f"{self._name}: {early}, and are left out",)
        models = {kind for element in written.iter("vType") if (kind := element.get("laneChangeModel"))}
        if len(models) > 1:
            raise self._root.fault(
                f"SUMO has one kind of lanes, and the types have {' and '.join(sorted(models))}", "give one of them"
            )
        single = [(time, element.text("id")) for time, element in self._departing if element.element != "flow"]
        return RouteTraffic(
            ET.tostring(written),
            tuple(name for time, name in single if time == self._begin),
            frozenset(name for _, name in single),
            frozenset(models or ["LC2013"]),
            notes,
        )

    def _empty(self) -> InvalidInputError:
        """Returns the refusal of a file that brings no vehicle into the run."""
        if not self._times:
            return self._root.fault("it has no vehicle, trip or flow", "give one, or leave `routes` out")
        first, last = min(self._times), max(self._times)
        times = f"from {_time(first)} to {_time(last)} s" if last > first else f"at {_time(first)} s"
        message = (
            f"none of its {len(self._times):,} vehicles, trips and flows departs in the run, which is from {_time(self._first)} to "
            f"{_time(self._end)} s: they begin {times}"
        )
        return self._root.fault(message, f"give the scenario `begin: {_time(first)}`, the file's time at the run's begin")

    def _depart(self, element: Element) -> None:
        """Checks a vehicle, trip or flow, and keeps it if it belongs to the run."""
        element.is_read = True
        is_flow = element.element == "flow"
        begin = max(_seconds(element, "begin", "0") if is_flow else _seconds(element, "depart"), 0.0)
        end = _seconds(element, "end", str(LONG)) if is_flow else begin
        self._times.append(begin)
        if begin >= self._end:
            element.skip()
            self._notes.add(element, f"it begins after the run's end at {_time(self._end)} s, and is left out")
            return
        if end < self._first or (is_flow and end == self._first):
            element.skip()
            self._early += 1
            return
        if len(self._departing) == MOST_VEHICLES:
            message = f"the file has more than {MOST_VEHICLES:,} vehicles, trips and flows until the scenario's end"
            raise element.fault(
                message, "leave out vehicles that are never met, make flows of them, or give a shorter `warm_up`"
            )
        self._check(element)
        name = element.text("type", "DEFAULT_VEHTYPE")
        if name not in self._types:
            raise element.fault(f"there is no vType {shown(name)} before it", nearest(name, list(self._types)))
        self._check_way(element)
        if is_flow:
            per_second = self._per_second(element, begin, end)
            if (self._first - begin) * per_second > MOST_EARLIER:
                message = f"more than {MOST_EARLIER:,} of its vehicles depart before the run"
                raise element.fault(message, f"give it a later begin, e.g. {_time(self._first - 3600.0)}")
        self._departing.append((begin, element))

    def _check(self, element: Element) -> None:
        """Checks the attributes of an element and of those inside of it."""
        element.is_read = True
        known = KNOWN[element.element]
        for key in element.values:
            if key in WITHOUT_EFFECT:
                continue
            if key not in known:
                raise element.fault(
                    f"the attribute {shown(key)} is not supported", f"leave it out; {nearest(key, sorted(known))}"
                )
            if key in NUMBERS:
                element.number(key, *NUMBERS[key])
            elif key in WORDS:
                element.word(key, tuple(WORDS[key]))
        factor = element.values.get("speedFactor", "1").replace(" ", "")
        if not _FACTOR.fullmatch(factor):
            element.number("speedFactor", 0.0, 100.0, 1.0)
        if "edges" in element.values:
            self._check_edges(element, element.text("edges").split(), is_joined=True)
        if element.element != "stop" and (name := element.values.get("id")) is not None:
            self._check_name(element, name)
        for child in element.children:
            if child.element in INSIDE.get(element.element, ()):
                self._check(child)
            elif child.element not in IGNORED:
                raise child.fault("the element is not supported here", "leave it out")

    def _check_name(self, element: Element, name: str) -> None:
        """Raises InvalidInputError for an id that another element of the file or an entry of the scenario has."""
        kind = element.element
        names = self._types if kind.startswith("vType") else self._routes if kind.startswith("route") else self._taken
        if name in names or name in self._taken or name.rpartition(".")[0] in self._taken:
            raise element.fault("another one has the same id, here or in the scenario", "rename one")
        if len(name) > 200 or (names is self._routes and name.startswith("route-")):
            raise element.fault("the id is too long, or begins as drivecal's own do", "rename it")
        names.add(name)

    def _check_way(self, element: Element) -> None:
        """Checks the edges over which a vehicle drives."""
        route = element.values.get("route")
        if route is not None and route not in self._routes:
            raise element.fault(f"there is no route {shown(route)} before it", nearest(route, list(self._routes)))
        if route is None and element.optional("route") is None:
            ends = [element.text("from"), *element.text("via", "").split(), element.text("to")]
            self._check_edges(element, ends, is_joined=False)

    def _check_edges(self, element: Element, edges: list[str], *, is_joined: bool) -> None:
        """Checks that the network has edges, and if they are a route that lanes lead from each to the next."""
        if not edges:
            raise element.fault("the route has no edges", "give it edges")
        before: str | None = None
        for edge in edges:
            if edge not in self._network.edges or self._network.edges[edge].function != "":
                roads = [name for name in self._network.edges if not name.startswith(":")]
                raise element.fault(f"the network has no edge {shown(edge, 80)}", nearest(edge, roads))
            if is_joined and before is not None:
                reached = {link.end for link in self._network.connections.get(before, ())}
                if edge not in reached:
                    message = f"no lane leads from {shown(before, 80)} to {shown(edge, 80)}"
                    raise element.fault(message, f"it leads to {', '.join(sorted(reached)[:5]) or 'no edge'}")
            before = edge

    def _per_second(self, element: Element, begin: float, end: float) -> float:
        """Returns how many vehicles of a flow depart in a second."""
        given = [key for key in ("vehsPerHour", "perHour", "period", "probability") if key in element.values]
        number = float(element.values["number"]) if "number" in element.values else None
        if len(given) > 1:
            raise element.fault(f"it has {' and '.join(given)}", "give one of them")
        if not given and (number is None or not begin < end < LONG):
            raise element.fault("how many vehicles come is not said", "give vehsPerHour, period, or number, begin and end")
        if not given:
            return (number or 0.0) / (end - begin)
        if given == ["probability"]:
            return element.number("probability", 0.0, 1.0)
        if given != ["period"]:
            return element.number(given[0], *NUMBERS[given[0]]) / 3600.0
        text = element.text("period").replace(" ", "")
        match = _RATE.fullmatch(text)
        value = finite(match[1] if match else text) or -1.0
        rate = value if match else 1.0 / value
        if not 1.0 / LONG <= rate <= MOST_PER_HOUR / 3600.0:
            message = f"period is {shown(text)}, which is no time of at least {3600.0 / MOST_PER_HOUR:g} s between two vehicles"
            raise element.fault(message, "give e.g. 5, or exp(0.2)")
        return rate


def _copied(element: Element) -> ET.Element:
    """Returns what SUMO reads of a checked element."""
    known = KNOWN[element.element]
    copied = ET.Element(element.element, {key: text for key, text in element.values.items() if key in known})
    copied.extend(_copied(child) for child in element.children if child.is_read and child.element in KNOWN)
    return copied


def _seconds(element: Element, key: str, default: str | None = None) -> float:
    """Returns a time in seconds, which may be written as days, hours, minutes and seconds with colons."""
    text = element.text(key, default)
    values = [finite(part) for part in text.split(":")]
    units = (1.0, 60.0, 3600.0, 86400.0)
    total = inf if None in values or len(values) > len(units) else 0.0
    for value, unit in zip(reversed(values), units, strict=False):
        total += (value or 0.0) * unit
    if not abs(total) <= LONG:
        raise element.fault(f"{key} is {shown(text, 40)}, which is not a time", "give seconds, e.g. 12.5")
    return total


def _time(value: float) -> str:
    """Returns a time (s) as it is written in files and manifests."""
    return f"{value:.12g}"
