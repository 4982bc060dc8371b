"""SUMO route files: SUMO drives what they say.

SUMO ignores misspelt attributes, and reads or writes other files if an element says so. Therefore elements and attributes must be in the
lists below, values in SUMO's own schema, edges and lanes in the network. Vehicles that a run does not see are left out.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from itertools import count, islice, pairwise
from math import inf
from typing import Any, Final
from xml.etree import ElementTree as ET

from drivecal.bundles.highway import CLASSES, Surroundings
from drivecal.bundles.highway_actions import EGO
from drivecal.bundles.highway_catalogue import TYPE_PARAMETERS
from drivecal.bundles.traffic.elements import Element, Notes, read_tree
from drivecal.contracts.assignments import finite_number
from drivecal.contracts.input_errors import nearest
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.roads.network import Network

_TYPE = re.compile(r"(?:atomic|union) type '(?:xs:)?(\w+)'")
_PREFIX = re.compile(r"^Element '[^']*'(?:, |: )|\[facet '\w+'\] ")
_FLOAT = re.compile(r"\[-\+\]\?\(\(.*?INF\)", re.IGNORECASE)
MOST_VEHICLES = 2000
"""Vehicles, trips and flows that belong to a run."""
MOST_READ = 10_000
"""Elements that SUMO reads of a file: the time that its schema takes for wrong ones grows with the square."""
MOST_FAULTS = 20
MOST_DRAWN = 100  # routes of a distribution that are looked at for each vehicle
MOST_SEARCHED = 200_000  # edges that are looked at for ways of trips; SUMO judges the others
OWN_TYPES = frozenset(f"DEFAULT_{kind}TYPE" for kind in ("VEH", "BIKE", "TAXI", "PED", "RAIL", "CONTAINER"))  # SUMO's
LONG = 1e9
SUBLANE: Final = "SL2015"
WORDS: Mapping[str, tuple[str, ...]] = {
    "vClass": tuple(CLASSES),
    "carFollowModel": ("Krauss", "IDM", "EIDM", "ACC", "CACC", "W99"),
    "laneChangeModel": ("LC2013", SUBLANE),
}
WITHOUT_EFFECT = frozenset(
    {"color", "guiShape", "imgFile", "osgFile", "height", "mass", "emissionClass", "line", "cost"}
    | {"personCapacity", "containerCapacity", "personNumber", "containerNumber", "boardingDuration", "loadingDuration"}
)
"""Attributes that decide nothing on the way; they are not passed on."""
_DEPARTING = frozenset(
    {"id", "type", "via", "speedFactor", "departLane", "departPos", "departPosLat", "departSpeed"}
    | {"arrivalLane", "arrivalPos", "arrivalPosLat", "arrivalSpeed"}
)
KNOWN: Mapping[str, frozenset[str]] = {
    "vType": TYPE_PARAMETERS
    | {"id", "length", "width", "maxSpeed", "speedDev", "speedFactor", "probability"}
    | {"vClass", "carFollowModel", "laneChangeModel"},
    "vTypeDistribution": frozenset({"id", "vTypes", "probabilities"}),
    "route": frozenset({"id", "edges", "probability"}),
    "routeDistribution": frozenset({"id", "routes", "probabilities"}),
    "vehicle": _DEPARTING | {"depart", "route"},
    "trip": _DEPARTING | {"depart", "from", "to"},
    "flow": _DEPARTING | {"route", "from", "to", "begin", "end", "number", "vehsPerHour", "perHour", "period", "probability"},
    "stop": frozenset({"lane", "edge", "startPos", "endPos", "duration", "until"}),
}
"""Attributes of elements that are passed on."""
_REMEDIES = dict.fromkeys([("vehicle", "from"), ("vehicle", "to")], "make it a trip") | {("trip", "route"): "make it a vehicle"}
INSIDE: Mapping[str, tuple[str, ...]] = {
    "vTypeDistribution": ("vType",),
    "routeDistribution": ("route",),
    "route": ("stop",),
    **dict.fromkeys(("vehicle", "trip", "flow"), ("route", "stop")),
}
IGNORED = ("param", "person", "personFlow", "container", "containerFlow")
"""Elements that are listed and not passed on."""
_REFERENCES = {"type": "type", "vTypes": "type", "route": "route", "routes": "route"}
NAMES = frozenset({"id", "from", "to", "via", "edges", "edge", "lane", *_REFERENCES})
_NUMBER = re.compile(r"(?i)\b(?:nan|inf(?:inity)?)\b|(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d*)?")
_WHOLE = re.compile(r"[-+]?\d+")
_DRAWN = re.compile(r"^normc?\(([^(),]+)(?:,[-+.\deE]+)*\)$")  # a time that is drawn, with its mean
_BLANKS = re.compile(r"\s*([(),])\s*")  # SUMO takes them inside of values and not around them, its schema neither
LIMITS = {
    ("vType", "tau"): (1e-3, LONG),
    ("vType", "stepping"): (1e-3, LONG),
    ("vType", "lcOvertakeDeltaSpeedFactor"): (-1.0, 1.0),
}
LIMITS |= {("flow", "vehsPerHour"): (1e-9, 3.6e6), ("flow", "perHour"): (1e-9, 3.6e6), ("flow", "period"): (1e-3, LONG)}
LIMITS |= {("flow", "probability"): (1e-9, 1.0), ("flow", "number"): (1.0, LONG), ("vType", "speedDev"): (0.0, 1e3)}
"""Limits that SUMO's schema does not have: beyond them SUMO does not start, or takes hours."""
FASTEST: Mapping[str, float] = {"truck": 130 / 3.6, "trailer": 130 / 3.6, "bus": 100 / 3.6, "coach": 100 / 3.6}
"""SUMO's `maxSpeed` (m/s) by class of vehicles; others have 200 km/h."""


@dataclass(frozen=True, slots=True)
class RouteTraffic:
    """The traffic of a route file in a run.

    Attributes:
        content: The file that SUMO reads: the types, the routes, and the vehicles that depart in the run or its warm-up.
        starting: Ids of the vehicles that depart at the run's time 0.
        vehicles: Ids of all vehicles and trips.
        lane_changes: Models of lane changes; SUMO's default is LC2013.
        notes: What is ignored or left out, with the lines.
        places: Lines and elements of ids.
    """

    content: bytes
    starting: tuple[str, ...]
    vehicles: frozenset[str]
    lane_changes: frozenset[str]
    notes: tuple[str, ...]
    places: Mapping[str, str] = field(default_factory=dict)

    def located(self, error: object) -> str:
        """Returns what SUMO says of a vehicle, flow, type or route, with its line and element before."""
        quoted = (name for text in re.findall(r"'([^']*)'", str(error)) for name in (text, text.rpartition(".")[0]))
        return next((f"{self.places[name]}: {error}" for name in quoted if name in self.places), str(error))


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
        self._given: dict[str, dict[str, Element | None]] = {"type": dict.fromkeys(OWN_TYPES), "route": {}, "vehicle": {}}
        own = {EGO, *(entry.id or f"vehicle{index}" for index, entry in enumerate(scenario.traffic))}
        self._taken = {"type": set(own), "route": {f"route-{name}" for name in own}, "vehicle": own}  # SUMO keeps them apart
        self._numbers, self._searched = count(1), 0
        self._times: list[float] = []
        self._early = 0
        self._departing: list[tuple[float, Element]] = []

    def traffic(self) -> RouteTraffic:
        """Returns what is left of the file."""
        kept: list[Element] = []
        for element in self._root.children:
            if element.element in {"vehicle", "trip", "flow"}:
                self._depart(element)
            elif element.element in {"vType", "vTypeDistribution", "route", "routeDistribution"}:
                self._check(element)
                kept.append(element)
            elif element.element not in IGNORED:
                remedy = "give vType, route, their distributions, vehicle, trip and flow"
                raise element.fault("the element is not supported", remedy)
        if not self._departing:
            raise self._empty()
        self._departing.sort(key=lambda entry: entry[0])  # SUMO skips vehicles that are out of order
        kept += [element for _, element in self._departing]
        written, read = ET.Element("routes"), [self._root]
        written.extend(_copied(element, read) for element in kept)
        if wrong := tuple(islice(_schema_faults(written, read), MOST_FAULTS)):
            raise InvalidInputError(*wrong)
        notes = self._notes.texts(self._root)
        if self._early:
            early = f"{self._early:,} of {len(self._times):,} vehicles, trips and flows depart before {self._first:.12g} s"
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
            {element.values.get("id", ""): f"line {element.line}, <{element.element}>" for element in kept},
        )

    def _empty(self) -> InvalidInputError:
        """Returns the refusal of a file that brings no vehicle into the run."""
        if not self._times:
            return self._root.fault("it has no vehicle, trip or flow", "give one, or leave `routes` out")
        first, last = min(self._times), max(self._times)
        if self._first <= first < self._end:
            return self._root.fault("its flows end before a vehicle departs", "give them an `end` after the run's begin")
        times = f"from {first:.12g} to {last:.12g} s" if last > first else f"at {first:.12g} s"
        message = (
            f"none of its {len(self._times):,} vehicles, trips and flows departs in the run, which is from {self._first:.12g} to "
            f"{self._end:.12g} s: they begin {times}"
        )
        return self._root.fault(message, f"give the scenario `begin: {first:.12g}`, the file's time at the run's begin")

    def _depart(self, element: Element) -> None:
        """Checks a vehicle, trip or flow, and keeps it if it belongs to the run."""
        element.is_read = True
        is_flow = element.element == "flow"
        begin = max(_seconds(element, "begin", "0") if is_flow else _seconds(element, "depart"), 0.0)
        end = _seconds(element, "end", str(LONG)) if is_flow else begin
        self._times.append(begin)
        if begin >= self._end:
            element.skip()
            self._notes.add(element, f"it begins after the run's end at {self._end:.12g} s, and is left out")
            return
        if end < self._first or (is_flow and end == self._first):
            element.skip()
            self._early += 1
            return
        if len(self._departing) == MOST_VEHICLES:
            message = f"the file has more than {MOST_VEHICLES:,} vehicles, trips and flows until the scenario's end"
            raise element.fault(message, "leave out vehicles that are never met, make flows, or give a shorter `warm_up`")
        self._check(element)
        if "route" not in element.values and element.optional("route") is None:
            element.text("route" if element.element == "vehicle" else "from")
        rates = [key for key in ("vehsPerHour", "perHour", "period", "probability") if key in element.values]
        if is_flow and (len(rates) > 1 or not (rates or ("number" in element.values and end < LONG))):
            message = f"how many vehicles come is said by {' and '.join(rates) or 'nothing'}"
            raise element.fault(message, "give one of vehsPerHour, period and probability, or number, begin and end")
        self._check_start(element)
        self._departing.append((begin, element))

    def _check_start(self, element: Element) -> None:
        """Checks that a vehicle can start with its type's speed in its lane, and that its way leads to its stops and its end."""
        values, route = element.values, element.optional("route")
        of_type = kind.values if (kind := self._given["type"].get(values.get("type", "DEFAULT_VEHTYPE"))) else {}
        fastest = finite_number(of_type.get("maxSpeed", "")) or FASTEST.get(of_type.get("vClass", ""), 200 / 3.6)
        if (finite_number(values.get("departSpeed", "")) or 0.0) > fastest and (kind is None or kind.element == "vType"):
            raise element.fault(f"departSpeed is above the {fastest:.4g} m/s of the type", "give less, or the type a maxSpeed")
        ways = [edge for key in ("from", "via", "to") for edge in values.get(key, "").split() if "from" in values]
        for begin, end in pairwise(ways):
            self._check_way(element, begin, end)
        named = route or self._given["route"].get(values.get("route", "") if not ways else "")
        drawn = () if named is None else named.values.get("routes", "").split(None, MOST_DRAWN)[:MOST_DRAWN]
        inside = [*map(self._given["route"].get, drawn), *([] if named is None else named.every("route")), named]
        lane, stops = values.get("departLane", "").strip(), element.every("stop")
        for each in inside:
            left, before = (ways, []) if each is None else (each.values.get("edges", "").split(), each.every("stop"))
            self._searched += len(inside) - 1
            if not left or self._searched > MOST_SEARCHED:  # SUMO judges
                continue
            if _WHOLE.fullmatch(lane) and self._network.lane(f"{left[0]}_{int(lane)}") is None:
                raise element.fault(f"{shown(left[0], 80)} has no lane {lane}", "give a departLane from 0, the rightmost")
            at = self._along(element, "departPos", left[0], 0.0)
            for stop in (*before, *stops):
                edge, place = self._halt(stop)
                if edge.startswith(":"):
                    continue  # on a junction: SUMO judges
                back = edge == left[0] and place < at
                if ways:
                    self._check_way(stop, left[0], edge, back=back)
                elif edge not in left[back:]:
                    raise stop.fault("it is not ahead on the route", "give a lane of it, behind departPos and earlier stops")
                left, at = [edge] if ways else left[left.index(edge, back) :], place
            if stops and values.get("to"):
                back = ways[0] != ways[-1] and self._along(element, "arrivalPos", ways[-1], inf) < at
                self._check_way(element, left[0], ways[-1], back=back)

    def _check_way(self, element: Element, begin: str, end: str, *, back: bool = False) -> None:
        """Checks that a way leads from an edge to another, or with `back` around to the same edge."""
        reached, fresh = set[str](), [begin] if begin != end or back else []
        while fresh and end not in reached and self._searched < MOST_SEARCHED:
            self._searched += 1
            fresh += {link.end for link in self._network.connections.get(fresh.pop(), ())} - reached
            reached.update(fresh)
        if (begin != end or back) and end not in reached and not fresh:
            raise element.fault(f"no way leads from {shown(begin, 80)} to {shown(end, 80)}", "give edges that lead there")

    def _along(self, element: Element, key: str, edge: str, default: float) -> float:
        """Returns a place along an edge (m), which may be given from its end."""
        place = finite_number(element.values.get(key, ""))
        return default if place is None else place + self._network.edges[edge].lanes[0].length * (place < 0)

    def _halt(self, stop: Element) -> tuple[str, float]:
        """Returns the edge of a stop and its end along it (m)."""
        edge = stop.values["lane"].rpartition("_")[0] if "lane" in stop.values else stop.values["edge"]
        length = self._network.edges[edge].lanes[0].length
        begin, end = self._along(stop, "startPos", edge, 0.0), self._along(stop, "endPos", edge, length)
        if not 0 <= begin <= end <= length:
            raise stop.fault(f"it lies from {begin:g} to {end:g} m of {length:g} m", "give startPos and endPos in the lane")
        return edge, end

    def _check(self, element: Element) -> None:
        """Checks the attributes of an element and of those inside of it, and its edges."""
        element.is_read = True
        if next(self._numbers) > MOST_READ:
            raise element.fault(f"the run has more than {MOST_READ:,} elements", "leave out what no vehicle of it needs")
        known = KNOWN[element.element]
        for key in element.values:
            if key in {"arrival", "fromTaz", "toTaz"} and "departPos" in known:  # duarouter and cutRoutes write them
                self._notes.add(element, f"ignored: {key}, which has no effect on a given way")
            elif key not in known and key not in WITHOUT_EFFECT:
                remedy = _REMEDIES.get((element.element, key)) or nearest(key, sorted(known))
                raise element.fault(f"the attribute {shown(key)} is not supported", remedy)
            if key in WORDS:
                element.word(key, WORDS[key])
            if key in known - NAMES:
                text = _BLANKS.sub(r"\1", element.values[key]).strip()
                low, high = LIMITS.get((element.element, key), (-LONG, LONG)) if "exp" not in text else (1e-9, 1e3)
                numbers = [finite_number(part) for part in (text.removeprefix("exp(").rstrip(")"), *_NUMBER.findall(text))]
                if None in numbers[1:] or not all(low <= number <= high for number in numbers[:1] if number is not None):
                    raise element.fault(f"{key} is {shown(text, 40)}", f"give a number from {low:g} to {high:g}")
                if key == "speedFactor" and len(numbers) == 2 and element.element == "vType" and numbers[0] is not None:
                    usual = CLASSES.get(element.values.get("vClass", ""), CLASSES["passenger"])[2]
                    spread = 3 * (usual if (own := finite_number(element.values.get("speedDev", ""))) is None else own)
                    if spread > 0 and not 0.2 - spread <= numbers[0] <= 2.0 + spread:
                        raise element.fault(f"{key} {numbers[0]:g} is beyond 0.2 to 2", "give one between, or speedDev 0")
            elif key in {"from", "route", "type"} and not element.values[key].strip():
                raise element.fault(f"{key} is empty", "fill it in, or leave it out")
        self._check_places(element)
        for key, kind in _REFERENCES.items():
            for name in element.values.get(key, "").split():
                if name not in (given := self._given[kind]):
                    raise element.fault(f"no {kind} {shown(name)} is defined before this line", nearest(name, sorted(given)))
        for child in element.children:
            if child.element in INSIDE.get(element.element, ()):
                self._check(child)
            elif child.element not in IGNORED:
                raise child.fault("the element is not supported here", "leave it out")
        name, tag = element.values.get("id", ""), element.element
        kind = "type" if tag.startswith("vType") else "route" if tag.startswith("route") else "vehicle"
        if name in self._taken[kind] or (kind == "vehicle" and name.rpartition(".")[0] in self._taken[kind]):
            raise element.fault(f"another {kind} has the same id, here or in the scenario", "rename one")
        if tag.endswith("Distribution"):
            listed = element.values.get(f"{tag[:-12]}s", "").split()
            shares = element.values.get("probabilities", "").split() if listed else []
            members = [self._given[kind][other] if kind == "type" else None for other in listed[len(shares) :]]
            members += element.every("vType", "route")
            rest = ["1" if each is None else each.values.get("probability", "1") for each in members]
            if None in map(finite_number, shares) or not sum(
                finite_number(each) or 0.0 for each in shares[: len(listed)] + rest
            ):
                remedy = f"give it a {kind}, and one of them a number above 0 as probability"
                raise element.fault(f"nothing can be drawn of it, with probabilities {shown(' '.join(shares), 40)}", remedy)
        self._taken[kind] |= {name} - {""}
        self._given[kind] |= {name: element} if name else {}

    def _check_places(self, element: Element) -> None:
        """Checks that the network has the edges and the lane of an element, and links from each edge of a route to the next."""
        route = element.values.get("edges", "").split()
        alone = [edge for key in ("from", "via", "to") for edge in element.values.get(key, "").split()]
        alone += [element.values["edge"]] if "edge" in element.values else []
        for edges in (route, *([edge] for edge in alone)):
            for _, message, remedy in self._network.faults(edges):
                raise element.fault(message, remedy)
        if "lane" in element.values and self._network.lane(lane := element.text("lane")) is None:
            raise element.fault(f"the network has no lane {shown(lane, 80)}", "give EDGE_INDEX, e.g. e1_0")
        if element.element == "stop" and (
            _seconds(element, "duration", "0") < 0 or {"lane", "edge"}.isdisjoint(element.values)
        ):
            raise element.fault("a stop needs a place, and no duration below 0", "give lane or edge, and a duration")
        if element.element == "stop":
            self._halt(element)
        if element.element == "route" and not route:
            raise element.fault("the route has no edges", "give it edges")


def _copied(element: Element, read: list[Element]) -> ET.Element:
    """Returns what SUMO reads of a checked element, and adds to `read` first the element, then those inside of it."""
    known = KNOWN[element.element]
    read.append(element)
    copied = ET.Element(element.element)
    for key in filter(known.__contains__, element.values):
        copied.set(key, element.values[key] if key in NAMES else _BLANKS.sub(r"\1", element.values[key]).strip())
    copied.extend(_copied(child, read) for child in element.children if child.is_read and child.element in KNOWN)
    return copied


def _seconds(element: Element, key: str, default: str | None = None) -> float:
    """Returns a time in seconds, which may be written as days, hours, minutes and seconds with colons."""
    text = element.text(key, default)
    parts = [finite_number(part) for part in reversed(_DRAWN.sub(r"\1", _BLANKS.sub(r"\1", text.strip())).split(":"))]
    total = sum((inf if part is None else part) * unit for part, unit in zip(parts, (1.0, 60.0, 3600.0, 86400.0), strict=False))
    if not abs(total) <= LONG or len(parts) not in {1, 3, 4}:
        raise element.fault(f"{key} is {shown(text, 40)}, which is not a time", "give seconds, e.g. 12.5")
    return total


def _schema_faults(root: ET.Element, elements: Sequence[Element]) -> Iterator[Problem]:
    """Yields what the schema refuses in a document that was made of `elements`, in their order; nothing where it is not installed."""
    etree, validator, types = _schema()
    if etree is None:
        return
    document = etree.fromstring(ET.tostring(root))
    validator.validate(document)
    places = dict(zip(document.iter(), elements, strict=True))
    for error in validator.error_log:  # SUMO takes elements in any order
        if error.type_name != "SCHEMAV_ELEMENT_CONTENT" and (element := places.pop(document.xpath(error.path)[0], None)):
            kind = _TYPE.search(error.message)
            right = " or ".join(dict.fromkeys(_right(types, kind[1]))) if kind is not None else "a value that is allowed"
            yield from element.fault(
                shown(_FLOAT.sub("NUMBER", _PREFIX.sub("", error.message)), 400).rstrip("."), f"give {right}"
            ).problems


def _right(types: Mapping[str, Any], name: str) -> Iterator[str]:
    """Yields what a type of the schema takes, in words."""
    if name not in types:
        yield "a whole number" if "int" in name.lower() else "a number"
        return
    for part in types[name].iter():
        for base in (part.get("memberTypes") or part.get("base") or "").split():
            yield from _right(types, base.removeprefix("xsd:")) if base != "xsd:string" else ()
        if part.tag.endswith(("}enumeration", "}pattern")):
            yield _FLOAT.sub("NUMBER", part.get("value")).replace("\\", "")


@cache
def _schema() -> tuple[Any, Any, Mapping[str, Any]]:
    """Returns lxml's module, the schema, and its simple types by name; None in their places where they are not installed."""
    try:
        from lxml import etree  # the installation of a client alone does not have it

        folder = files("sumo_data") / "data" / "xsd"
        parts = [etree.parse(str(folder / "types" / name)) for name in ("base.xsd", "route.xsd")]
        types = {kind.get("name"): kind for part in parts for kind in part.iter("{*}simpleType") if kind.get("name")}
        return etree, etree.XMLSchema(etree.parse(str(folder / "routes_file.xsd"))), types
    except (ImportError, OSError):
        return None, None, {}
