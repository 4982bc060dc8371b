"""SUMO networks: reads a `.net.xml` into edges, lanes, connections and junctions.

Nothing is repaired: a number that is missing, absurd or not finite, two elements of one name and an element that names an unknown one
are refused. Positions keep the file's coordinates. A lane whose speed limit changes, or is not known, has them by place as `Lane.limits`;
SUMO's cars keep one limit per lane, the first.
"""

import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from itertools import islice
from typing import Any

import numpy as np

from drivecal.contracts.input_errors import nearest
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.roads import Floats
from drivecal.roads.documents import Attributes, read_elements

OLDEST, NEWEST = (0, 20), (1, 99)
"""Versions of the format."""
CAR = "passenger"
DEFAULT_WIDTH = 3.2
"""Metres; SUMO's own."""
FARTHEST = 1e8
"""Largest coordinate (m)."""
LONGEST = 1e6
"""Metres of a lane."""
SLOWEST, FASTEST = 0.1, 150.0
"""Least and largest speed limit (m/s)."""
WIDEST = 100.0
"""Metres of a lane: proving grounds have 28."""
MOST_LANES = 32
"""Lanes of an edge."""
MOST_CONNECTIONS = 1_000
"""Connections from an edge, and lanes into a junction."""
MOST_POINTS = 200_000
"""Points of a lane."""
OTHER_FILES = ("href", "file", "output", "dest")
"""Attributes that make SUMO read or write other files: of `<include>`, and of signs, detectors and events of additional files."""
WIDTHS = "drivecal.widths"
"""Parameter of lanes whose width changes: pairs of a share of the shape's length and a width (m), which SUMO ignores."""
LIMITS = "drivecal.limits"
"""Parameter of lanes whose limit changes or is not known: pairs of a share of the shape's length and the limit (m/s) after it, which
SUMO ignores."""
UNKNOWN = "none"
"""A limit in `LIMITS` that the file does not give."""
UNPLACED = "drivecal.unplaced"
"""Parameter of lanes that are not at their place in the OpenDRIVE file: the cause."""
ORIGIN = "origId"
"""Parameter of lanes with which netconvert names the roads and lanes of an OpenDRIVE file."""

_ORIGIN = re.compile(r"(\S+_-?[0-9]{1,3}( \S+_-?[0-9]{1,3})*)?")

CONVERTED = ".net.xml"
"""Ending of a converted network's file, after that of its OpenDRIVE file."""
CONVERTER = 3
"""Version of the conversion: networks of others are made again. 3 drives closed roads around once, and refuses negative widths."""
_SOURCE = re.compile(rb"<!-- converted \(version %d\) from an OpenDRIVE file of SHA-256 ([0-9a-f]{64}) -->" % CONVERTER)


def network_file(name: str) -> str:
    """Returns the file of a bundle that holds a network: that of an OpenDRIVE file lies next to it since the bundle was packed."""
    return name + CONVERTED if name.lower().endswith(".xodr") else name


def source_of(network: bytes) -> str | None:
    """Returns the digest of the OpenDRIVE file that a network was converted from, None if it was not converted by this drivecal."""
    match = _SOURCE.search(network, 0, 300)
    return None if match is None else match[1].decode()


def source_comment(content: bytes) -> bytes:
    """Returns the line of a converted network with which `source_of` finds the digest of its OpenDRIVE file."""
    digest = hashlib.sha256(content).hexdigest().encode()
    return b"<!-- converted (version %d) from an OpenDRIVE file of SHA-256 %s -->\n" % (CONVERTER, digest)


@dataclass(frozen=True, eq=False, slots=True)
class Lane:
    """A lane: its centre line `shape` (n, 2) in driving direction, `length` of SUMO's positions (m), limit (m/s), width (m)."""

    edge: str
    index: int
    shape: Floats
    length: float
    limit: float
    width: float
    for_cars: bool
    line: int
    """Line of the file."""
    widths: Floats | None = None
    """Shares of the shape's length and widths there (n, 2), if the width changes along the lane."""
    origin: str | None = None
    """Roads and lanes of the OpenDRIVE file that it was made of, such as `7_-1`, if netconvert has said so."""
    limits: Floats | None = None
    """Shares of the shape's length and limits (m/s) from there on (n, 2), if the limit changes along the lane, or is not known: NaN."""
    unplaced: str | None = None
    """Why the lane is not at its place in the OpenDRIVE file, if it is not."""


@dataclass(frozen=True, eq=False, slots=True)
class Edge:
    """Adjacent lanes, from the right. `function` is empty for roads, else `internal`, `crossing`, ..."""

    id: str
    function: str
    begin: str
    end: str
    lanes: tuple[Lane, ...]
    line: int


@dataclass(frozen=True, slots=True)
class Connection:
    """A way from a lane to the next, through the lane `via` inside of the junction if the network has such lanes."""

    begin: str
    end: str
    from_lane: int
    to_lane: int
    via: str | None
    light: bool
    state: str
    direction: str
    for_cars: bool
    line: int


@dataclass(frozen=True, slots=True)
class Junction:
    """A junction. `lanes`: incoming ones in order of its requests; `foes` has a text of bits for each request, the last for request 0."""

    id: str
    kind: str
    lanes: tuple[str, ...]
    foes: tuple[str, ...]
    line: int


@dataclass(frozen=True, eq=False)
class Network:
    """A SUMO network. `connections` from each edge are in the order of the file; `roundabouts` are the edges of any; `offset` was
    added to the coordinates (m) of the source it was built from.
    """

    name: str
    edges: Mapping[str, Edge]
    connections: Mapping[str, tuple[Connection, ...]]
    junctions: Mapping[str, Junction]
    roundabouts: frozenset[str]
    offset: tuple[float, float] = (0.0, 0.0)
    crossed: bool = False
    """A route may lead over crossings without traffic lights."""

    def lane(self, name: str) -> Lane | None:
        """Returns the lane of an id such as `e1_0`."""
        edge, _, index = name.rpartition("_")
        if edge not in self.edges or not index.isascii() or not index.isdigit() or len(index) > 3:
            return None
        lanes = self.edges[edge].lanes
        return lanes[int(index)] if int(index) < len(lanes) else None

    def faults(self, route: Sequence[str]) -> Iterator[tuple[int, str, str]]:
        """Yields place, message and remedy of each edge that is no road here, or to which no lane leads from the edge before it."""
        for index, name in enumerate(route):
            reached = {link.end: None for link in self.connections.get(route[index - 1], ())} if index else {name: None}
            if name not in self.edges or self.edges[name].function != "":
                roads = list(islice((shown(edge.id, 80) for edge in self.edges.values() if edge.function == ""), 2_000))
                remedy = nearest(name, get_close_matches(name, roads, n=1) or roads[:20])
                yield index, f"there is no edge {shown(name, 80)}", remedy
            elif name not in reached:
                message = f"no lane leads from {shown(route[index - 1], 80)} to {shown(name, 80)}"
                yield index, message, f"it leads to {', '.join(shown(edge, 80) for edge in list(reached)[:5]) or 'no edge'}"


def read_network(content: bytes, name: str) -> Network:
    """Returns the network of a `.net.xml`. `name`: the file's name in messages.

    Raises InvalidInputError naming file, line, element, cause and remedy.
    """
    reader = _Reader(name)
    read_elements(content, name, "net", reader.start, reader.end)
    return reader.finished()


@dataclass(slots=True)
class _Reader:
    """Collects the elements of a network."""

    name: str
    edges: dict[str, Edge] = field(default_factory=dict)
    connections: dict[str, list[Connection]] = field(default_factory=dict)
    junctions: dict[str, Junction] = field(default_factory=dict)
    roundabouts: set[str] = field(default_factory=set)
    edge: Attributes | None = None
    lanes: list[Lane] = field(default_factory=list)
    junction: Attributes | None = None
    foes: list[str] = field(default_factory=list)
    offset: tuple[float, float] = (0.0, 0.0)

    def start(self, attributes: Attributes) -> None:
        """Takes an element. Whatever has no meaning for a route is left out, except what would let SUMO read other files."""
        if attributes.element == "include" or any(key in attributes.values for key in OTHER_FILES):
            raise attributes.fault("the element names another file, which SUMO would use", "give a network in one file")
        method: Any = getattr(self, f"on_{attributes.element}", None)
        if method is not None:
            method(attributes)

    def end(self, tag: str) -> None:
        """Closes an edge or a junction."""
        if tag == "edge" and self.edge is not None:
            self._close_edge(self.edge)
            self.edge, self.lanes = None, []
        elif tag == "junction" and self.junction is not None:
            self._close_junction(self.junction)
            self.junction, self.foes = None, []

    def finished(self) -> Network:
        """Returns the network. Raises InvalidInputError if it has no roads."""
        if not any(edge.function == "" for edge in self.edges.values()):
            raise InvalidInputError(Problem(self.name, "the network has no roads", "give a network with edges"))
        for way in (way for ways in self.connections.values() for way in ways):
            for name, lane in ((way.begin, way.from_lane), (way.end, way.to_lane)):
                if name in self.edges and lane >= len(self.edges[name].lanes):
                    message = f"line {way.line}: a connection names the lane {lane} of {shown(name, 60)}, which is missing"
                    raise InvalidInputError(Problem(self.name, message, "build the network again"))
        connections = {edge: tuple(ways) for edge, ways in self.connections.items()}
        return Network(self.name, self.edges, connections, self.junctions, frozenset(self.roundabouts), self.offset)

    def on_net(self, attributes: Attributes) -> None:
        text = attributes.text("version")
        major, _, minor = text.partition(".")
        numbers = [int(part) if part.isascii() and part.isdigit() and len(part) < 4 else -1 for part in (major, minor or "0")]
        version = (numbers[0], numbers[1])
        if min(version) < 0 or not OLDEST <= version <= NEWEST:
            message = f"networks of version {shown(text, 20)} cannot be read, only those from {OLDEST[0]}.{OLDEST[1]} to 1.x"
            raise attributes.fault(message, "convert it: netconvert -s OLD.net.xml -o NEW.net.xml")
        if attributes.truth("lefthand"):
            raise attributes.fault("the network is for left-hand traffic", "give a network for right-hand traffic")

    def on_location(self, attributes: Attributes) -> None:
        text = attributes.text("netOffset", "0,0")
        try:
            x, y = map(float, text.split(","))
        except ValueError:
            x = y = np.nan
        if not max(abs(x), abs(y)) <= FARTHEST:  # NaN compares as false
            raise attributes.fault(f"netOffset is {shown(text, 40)}, which is not a pair of metres", "correct it")
        self.offset = x, y

    def on_edge(self, attributes: Attributes) -> None:
        if self.edge is not None:
            raise attributes.fault("an edge is inside another one", "close it first")
        self.edge = attributes

    def _close_edge(self, attributes: Attributes) -> None:
        name = attributes.text("id")
        if name in self.edges:
            raise attributes.fault("another edge has the same id", "rename one")
        function = attributes.text("function", "")
        function = "" if function == "normal" else function
        is_road = function == ""
        begin, end = (attributes.text(key, None if is_road else "") for key in ("from", "to"))
        lanes = sorted(self.lanes, key=lambda lane: lane.index)
        if not lanes:
            raise attributes.fault("the edge has no lanes", "give it lanes")
        if [lane.index for lane in lanes] != list(range(len(lanes))):
            raise attributes.fault("the lanes are not numbered 0, 1, ... from the right", "number them so")
        self.edges[name] = Edge(name, function, begin, end, tuple(lanes), attributes.line)

    def on_lane(self, attributes: Attributes) -> None:
        if self.edge is None:
            raise attributes.fault("the lane stands outside of an edge", "move it into its edge")
        edge, index = self.edge.text("id"), attributes.integer("index", 0, MOST_LANES - 1)
        if any(lane.index == index for lane in self.lanes):
            message = f"the index {index} stands in {shown(edge, 60)} for the second time"
            raise attributes.fault(message, f"number the lanes from the right; this one is perhaps {len(self.lanes)}")
        if attributes.text("id") != f"{edge}_{index}":
            raise attributes.fault(f"lane {index} of {shown(edge, 60)} must be {shown(f'{edge}_{index}', 70)}", "rename it")
        self.lanes.append(
            Lane(
                edge=edge,
                index=index,
                shape=_shape(attributes),
                length=attributes.number("length", 0.0, LONGEST),
                limit=attributes.number("speed", SLOWEST, FASTEST),
                width=attributes.number("width", 0.1, WIDEST, DEFAULT_WIDTH),
                for_cars=_for_cars(attributes),
                line=attributes.line,
            )
        )

    def on_param(self, attributes: Attributes) -> None:
        """Takes the widths and limits of a lane, and what it was made of."""
        if self.edge is None or not self.lanes:
            return
        key = attributes.values.get("key")
        if key == WIDTHS:
            self.lanes[-1] = replace(self.lanes[-1], widths=_widths(attributes))
        elif key == LIMITS:
            self.lanes[-1] = replace(self.lanes[-1], limits=_limits(attributes))
        elif key == ORIGIN:
            origin = attributes.text("value", "")  # of networks of other sources, anything
            self.lanes[-1] = replace(self.lanes[-1], origin=origin if _ORIGIN.fullmatch(origin) else None)
        elif key == UNPLACED:
            self.lanes[-1] = replace(self.lanes[-1], unplaced=attributes.text("value", ""))

    def on_connection(self, attributes: Attributes) -> None:
        begin = attributes.text("from")
        connection = Connection(
            begin=begin,
            end=attributes.text("to"),
            from_lane=attributes.integer("fromLane", 0, MOST_LANES - 1),
            to_lane=attributes.integer("toLane", 0, MOST_LANES - 1),
            via=attributes.values.get("via"),
            light="tl" in attributes.values,
            state=attributes.text("state", ""),
            direction=attributes.text("dir", ""),
            for_cars=_for_cars(attributes),
            line=attributes.line,
        )
        others = self.connections.setdefault(begin, [])
        others.append(connection)
        if len(others) > MOST_CONNECTIONS:
            raise attributes.fault(f"{shown(begin, 60)} has more than {MOST_CONNECTIONS:,} connections", "build it again")

    def on_junction(self, attributes: Attributes) -> None:
        self.junction, self.foes = attributes, []

    def on_request(self, attributes: Attributes) -> None:
        if self.junction is None:
            raise attributes.fault("the request stands outside of a junction", "move it into its junction")
        index, bits = attributes.integer("index", 0, 10_000), attributes.text("foes")
        if index != len(self.foes) or len(bits) > 10_000 or not set(bits) <= {"0", "1"}:
            raise attributes.fault("the requests are not numbered 0, 1, ..., or their foes are not bits", "build it again")
        self.foes.append(bits)

    def _close_junction(self, attributes: Attributes) -> None:
        name = attributes.text("id")
        if name in self.junctions:
            raise attributes.fault("another junction has the same id", "rename one")
        lanes = tuple(attributes.text("incLanes", "").split())
        if len(lanes) > MOST_CONNECTIONS:
            raise attributes.fault(f"more than {MOST_CONNECTIONS:,} lanes lead into the junction", "build the network again")
        self.junctions[name] = Junction(name, attributes.text("type", ""), lanes, tuple(self.foes), attributes.line)

    def on_roundabout(self, attributes: Attributes) -> None:
        self.roundabouts |= set(attributes.text("edges", "").split())


def _for_cars(attributes: Attributes) -> bool:
    """Returns whether passenger cars may drive: SUMO's `allow` and `disallow`."""
    allowed, banned = attributes.values.get("allow"), attributes.values.get("disallow")
    if allowed:
        return bool({CAR, "all"} & set(allowed.split()))
    return not banned or not {CAR, "all"} & set(banned.split())


def _widths(attributes: Attributes) -> Floats:
    """Returns shares and widths (n, 2). Raises InvalidInputError."""
    widths = _pairs(attributes.text("value"))
    if len(widths) < 2 or not _are_shares(widths[:, 0]) or not np.all((widths[:, 1] >= 0.0) & (widths[:, 1] <= WIDEST)):
        raise attributes.fault("its widths are not pairs of a share and a width", "convert the file again")
    return widths


def _limits(attributes: Attributes) -> Floats:
    """Returns shares and limits (n, 2), NaN where the file gives none. Raises InvalidInputError."""
    limits = _pairs(attributes.text("value").replace(UNKNOWN, "nan"))
    known = limits[~np.isnan(limits[:, 1]), 1]
    if not _are_shares(limits[:, 0]) or not np.all((known >= SLOWEST) & (known <= FASTEST)):
        raise attributes.fault("its limits are not pairs of a share and a limit", "convert the file again")
    return limits


def _pairs(text: str) -> Floats:
    """Returns pairs of numbers (n, 2), none if the text holds something else."""
    try:
        return np.array([pair.split(",") for pair in text.split()], np.float64).reshape(-1, 2)
    except ValueError:
        return np.zeros((0, 2))


def _are_shares(shares: Floats) -> bool:
    return len(shares) > 0 and bool(np.all(np.diff(shares) >= 0.0) and shares[0] == 0.0 and shares[-1] <= 1.0)


def _shape(attributes: Attributes) -> Floats:
    """Returns the points of a lane, without heights. Raises InvalidInputError."""
    points = attributes.text("shape").split()
    if not 2 <= len(points) <= MOST_POINTS:
        raise attributes.fault(f"its shape has {len(points)} points", f"give it 2 to {MOST_POINTS:,}")
    parts = [point.split(",") for point in points]
    try:
        if not {len(part) for part in parts} <= {2, 3}:
            raise ValueError
        shape = np.array([part[:2] for part in parts], np.float64)
    except ValueError:
        raise attributes.fault("its shape holds a value that is not a point x,y or x,y,z", "correct the shape") from None
    if not np.all(np.abs(shape) <= FARTHEST):  # NaN compares as false
        raise attributes.fault(f"its shape has coordinates beyond {FARTHEST:g} m", "correct the shape")
    return shape


FIELD = "default_limit"
"""Field of a scenario: the limit (m/s) of lanes without one."""
MOST_NAMED = 5
"""Roads that a refusal names."""


def unlimited(network: Network) -> tuple[str, ...]:
    """Returns the ids of lanes that begin without a limit: SUMO's cars would keep netconvert's default there."""
    return tuple(
        f"{lane.edge}_{lane.index}"
        for edge in network.edges.values()
        for lane in edge.lanes
        if lane.limits is not None and np.isnan(lane.limits[0, 1])
    )


def limited(network: Network, default_limit: float | None) -> Network:
    """Returns the network with a limit (m/s) where lanes have none; the same if there is no such limit."""
    if default_limit is None:
        return network
    edges = {
        name: replace(edge, lanes=tuple(_limited(lane, default_limit) for lane in edge.lanes))
        if any(_is_open(lane) for lane in edge.lanes)
        else edge
        for name, edge in network.edges.items()
    }
    return replace(network, edges=edges)


def check_limits(network: Network, lanes: Iterable[Lane]) -> None:
    """Raises InvalidInputError with the field `default_limit`, naming their roads, if lanes have no limit."""
    bare = [lane for lane in lanes if _is_open(lane)]
    if bare:
        roads = dict.fromkeys(_road(lane) for lane in bare if lane.origin) or {_road(lane): None for lane in bare}
        named = ", ".join(shown(road, 60) for road in list(roads)[:MOST_NAMED])
        more = f" and {len(roads) - MOST_NAMED} more" if len(roads) > MOST_NAMED else ""
        message = f"{network.name}: lanes of the route have no speed limit: road {named}{more}"
        raise InvalidInputError(Problem(FIELD, message, f"give {FIELD}, in m/s, or limits in the file"))


def limits_at(lane: Lane, shares: Floats) -> Floats:
    """Returns the limit (m/s) at each share of a lane's length."""
    if lane.limits is None:
        return np.full(len(shares), lane.limit)
    rows = np.searchsorted(lane.limits[:, 0], shares + 1e-9, side="right") - 1
    return np.asarray(lane.limits[np.maximum(rows, 0), 1])


def _is_open(lane: Lane) -> bool:
    return lane.limits is not None and bool(np.isnan(lane.limits[:, 1]).any())


def _limited(lane: Lane, default_limit: float) -> Lane:
    if lane.limits is None or not _is_open(lane):
        return lane
    limits = np.column_stack([lane.limits[:, 0], np.nan_to_num(lane.limits[:, 1], nan=default_limit)])
    return replace(lane, limit=float(limits[0, 1]), limits=limits)


def _road(lane: Lane) -> str:
    """Returns the id of the road of the OpenDRIVE file, the edge if it is not known."""
    return (lane.origin or "").split(" ")[0].rpartition("_")[0] or lane.edge
