"""SUMO route files: SUMO drives what they say, and refuses what it cannot drive.

SUMO ignores misspelt attributes, and reads or writes other files if an element says so. Therefore elements and attributes must be in the
lists below, and edges in the network. Vehicles that a run does not see are left out.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from typing import Final
from xml.etree import ElementTree as ET

from drivecal.bundles.highway import Surroundings
from drivecal.bundles.highway_catalogue import TYPE_PARAMETERS
from drivecal.bundles.traffic.elements import Element, Notes, finite, read_tree
from drivecal.contracts.input_errors import nearest
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError
from drivecal.roads.network import Network

MOST_VEHICLES = 2000
"""Vehicles, trips and flows that belong to a run."""
LONG = 1e9
SUBLANE: Final = "SL2015"
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
            message = f"SUMO has one kind of lanes, and the types have {' and '.join(sorted(models))}"
            raise self._root.fault(message, "give one of them")
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
        self._departing.append((begin, element))

    def _check(self, element: Element) -> None:
        """Checks the attributes of an element and of those inside of it, and its edges."""
        element.is_read = True
        known = KNOWN[element.element]
        for key in element.values:
            if key not in known and key not in WITHOUT_EFFECT:
                remedy = f"leave it out; {nearest(key, sorted(known))}"
                raise element.fault(f"the attribute {shown(key)} is not supported", remedy)
        for edge in (edge for key in ("edges", "from", "via", "to") for edge in element.values.get(key, "").split()):
            if edge not in self._network.edges or self._network.edges[edge].function != "":
                roads = [name for name in self._network.edges if not name.startswith(":")]
                raise element.fault(f"the network has no edge {shown(edge, 80)}", nearest(edge, roads))
        for child in element.children:
            if child.element in INSIDE.get(element.element, ()):
                self._check(child)
            elif child.element not in IGNORED:
                raise child.fault("the element is not supported here", "leave it out")


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
