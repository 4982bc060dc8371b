"""OpenDRIVE files (ASAM OpenDRIVE 1.4 to 1.8): reads the roads of an `.xodr`, and where their lanes lie.

Reference lines are integrated from the file's geometries; a lane's centre follows from the lane offset and the widths between. Heights
and banking do not move a lane.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from math import ceil, cos, hypot, sin
from operator import itemgetter
from typing import Any

import numpy as np

from drivecal.contracts.input_errors import nearest
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.roads import GAUSS_POINTS, GAUSS_WEIGHTS, Floats
from drivecal.roads.documents import Attributes, JoinedNotes, read_elements

FARTHEST = 1e8
LONGEST = 1e6
LARGEST_COEFFICIENT = 1e9
SHARPEST = 10.0
"""Largest curvature (1/m)."""
PANEL = 1.0
"""Metres over which a clothoid is integrated by one rule of five points."""
MOST_PANELS = 1_000_000
VIRTUAL = "virtual"
"""Type of the junctions on whose roads nothing begins or ends, as at an entrance to a house."""


@dataclass(slots=True)
class Cubics:
    """Records a + b ds + c ds² + d ds³, each beginning at its place; 0 before the first."""

    records: list[tuple[float, float, float, float, float]] = field(default_factory=list)

    def append(self, attributes: Attributes, key: str) -> None:
        """Adds a record. `key`: the attribute of its begin."""
        coefficients = (attributes.number(name, -LARGEST_COEFFICIENT, LARGEST_COEFFICIENT) for name in "abcd")
        begin = attributes.number(key, 0.0, LONGEST)
        if self.records and begin < self.records[-1][0]:
            raise attributes.fault(f"the records of {attributes.element} are not in order", "order them")
        a, b, c, d = coefficients
        self.records.append((begin, a, b, c, d))

    def at(self, s: Floats) -> Floats:
        """Returns the values at each s."""
        if not self.records:
            return np.zeros(len(s))
        table = np.array(self.records)
        index = np.searchsorted(table[:, 0], s + 1e-9, side="right") - 1
        begin, a, b, c, d = table[np.maximum(index, 0)].T
        ds = s - begin
        return np.where(index >= 0, a + ds * (b + ds * (c + ds * d)), 0.0)


@dataclass(frozen=True, slots=True)
class Geometry:
    """A part of a reference line: its begin (s), pose, length, kind and coefficients."""

    begin: float
    x: float
    y: float
    heading: float
    length: float
    kind: str
    values: tuple[float, ...]

    def poses(self, ds: Floats) -> tuple[Floats, Floats, Floats]:
        """Returns x, y and heading at each distance from the begin."""
        u, v, turn = self._local(np.clip(ds, 0.0, self.length))
        forward, left = cos(self.heading), sin(self.heading)
        return self.x + u * forward - v * left, self.y + u * left + v * forward, self.heading + turn

    def _local(self, ds: Floats) -> tuple[Floats, Floats, Floats]:
        if self.kind == "line":
            return ds, np.zeros(len(ds)), np.zeros(len(ds))
        if self.kind in {"arc", "spiral"}:
            return self._clothoid(ds, *self.values)
        if self.kind == "poly3":
            return self._polynomial(ds, (0.0, 1.0, 0.0, 0.0), self.values)
        p = ds / self.length if self.values[8] else ds
        return _planar(p, self.values[:4], self.values[4:8])

    def _clothoid(self, ds: Floats, first: float, last: float) -> tuple[Floats, Floats, Floats]:
        """Integrates cos and sin of the turned angle by the rule of Gauss-Legendre with five points."""
        bend = (last - first) / self.length
        panels = min(MOST_PANELS, max(1, ceil(self.length / PANEL)))
        whole = np.linspace(0.0, self.length, panels + 1)
        edges = np.unique(np.concatenate([whole[: np.searchsorted(whole, ds.max()) + 1], ds]))  # the rest is not asked for
        steps = np.diff(edges)
        points = edges[:-1, None] + 0.5 * (1.0 + GAUSS_POINTS) * steps[:, None]
        angle = points * (first + 0.5 * bend * points)
        rows = np.searchsorted(edges, ds)
        u, v = (
            np.concatenate([[0.0], np.cumsum(0.5 * steps * (function(angle) @ GAUSS_WEIGHTS))])[rows]
            for function in (np.cos, np.sin)
        )
        return u, v, ds * (first + 0.5 * bend * ds)

    def _polynomial(self, ds: Floats, u: tuple[float, ...], v: tuple[float, ...]) -> tuple[Floats, Floats, Floats]:
        """Returns the points of v(u) at lengths along the curve."""
        panels = min(MOST_PANELS, max(1, ceil(self.length / PANEL)))
        edges = np.linspace(0.0, self.length, panels + 1)
        points = edges[:-1, None] + 0.5 * (1.0 + GAUSS_POINTS) * np.diff(edges)[:, None]
        slope = v[1] + points * (2.0 * v[2] + 3.0 * v[3] * points)
        length = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(edges) * (np.hypot(1.0, slope) @ GAUSS_WEIGHTS))])
        return _planar(np.interp(ds, length, edges), u, v)


def _planar(p: Floats, u: tuple[float, ...], v: tuple[float, ...]) -> tuple[Floats, Floats, Floats]:
    """Returns u, v and heading of two cubic polynomials of p."""
    values = [a + p * (b + p * (c + p * d)) for a, b, c, d in (u, v)]
    slopes = [b + p * (2.0 * c + 3.0 * d * p) for _, b, c, d in (u, v)]
    return values[0], values[1], np.arctan2(slopes[1], slopes[0])


def geometry_of(place: Attributes, shape: Attributes) -> Geometry:
    """Returns a geometry from its element and the shape in it. Raises InvalidInputError."""
    length = place.number("length", 0.0, LONGEST)
    values: tuple[float, ...] = ()
    if shape.element == "arc":
        values = (shape.number("curvature", -SHARPEST, SHARPEST),) * 2
    elif shape.element == "spiral":
        values = tuple(shape.number(key, -SHARPEST, SHARPEST) for key in ("curvStart", "curvEnd"))
    elif shape.element == "poly3":
        values = tuple(shape.number(key, -LARGEST_COEFFICIENT, LARGEST_COEFFICIENT) for key in "abcd")
    elif shape.element == "paramPoly3":
        keys = [name + axis for axis in "UV" for name in "abcd"]
        values = tuple(shape.number(key, -LARGEST_COEFFICIENT, LARGEST_COEFFICIENT) for key in keys)
        normalized = shape.text("pRange", "normalized") != "arcLength"
        values = (*values, float(normalized))
        if hypot(values[1], values[5]) == 0.0 and hypot(values[2], values[6]) == 0.0:
            raise shape.fault("the polynomial does not move", "export the file again")
    return Geometry(
        begin=place.number("s", 0.0, LONGEST),
        x=place.number("x", -FARTHEST, FARTHEST),
        y=place.number("y", -FARTHEST, FARTHEST),
        heading=place.number("hdg", -1e3, 1e3),
        length=max(length, 1e-6),
        kind=shape.element,
        values=values,
    )


REVISION = 1
UNITS = {"": 1.0, "m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704}
NO_LIMIT, OPEN_LIMIT = "no limit", "undefined"
"""Words for a speed limit."""
SLOWEST, FASTEST = 0.5, 600.0
"""Least and largest speed limit, in any unit."""
SHORTEST = 0.01
"""Metres from the end of a lane at which a limit counts as one of the next lane."""
DRIVEN = frozenset({"driving", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "mwyEntry", "mwyExit", "slipLane"})
"""Types of lanes on which cars drive."""
LIGHTS = frozenset(map(str, (*range(1000001, 1000008), *range(1000009, 1000014), 1000020)))
"""Types of signals that are traffic lights."""
FLAT = 1e-3
"""Largest error (m) of a curve that is replaced by a simpler one, and of a geometry's end, in thousandths of its length."""
_NO_NAME = re.compile(r"[\s|\\'\";,<>&]|^:|^$")
"""Ids that SUMO refuses."""


@dataclass(slots=True)
class FileLane:
    """A lane of a section: its type, widths over the section, limits (begin in the section, m/s), and linked lanes.

    A limit is infinite if the file says that there is none, and None if the road's holds.
    """

    id: int
    kind: str
    line: int
    widths: Cubics = field(default_factory=Cubics)
    limits: list[tuple[float, float | None]] = field(default_factory=list)
    successor: int | None = None
    predecessor: int | None = None


@dataclass(slots=True)
class LaneSection:
    """A lane section, from s = `begin` of its road on. `single`: its element, if it has the lanes of one side only."""

    begin: float
    lanes: dict[int, FileLane] = field(default_factory=dict)
    single: Attributes | None = None


@dataclass(slots=True)
class FileRoad:
    """A road of the file. `junction`: the id of the junction that it lies in, or -1."""

    id: str
    length: float
    junction: str
    line: int
    geometries: list[Geometry] = field(default_factory=list)
    offset: Cubics = field(default_factory=Cubics)
    sections: list[LaneSection] = field(default_factory=list)
    limits: list[tuple[float, float | None]] = field(default_factory=list)
    linked: list[tuple[str, str]] = field(default_factory=list)
    """Types (road, junction) and ids of the elements before and after it."""

    def reference(self, s: Floats) -> tuple[Floats, Floats, Floats]:
        """Returns x, y and heading of the reference line at each s."""
        begins = np.array([geometry.begin for geometry in self.geometries])
        at = np.clip(np.searchsorted(begins, s, side="right") - 1, 0, len(begins) - 1)
        x, y, heading = np.empty(len(s)), np.empty(len(s)), np.empty(len(s))
        for index in np.unique(at):
            here = at == index
            x[here], y[here], heading[here] = self.geometries[index].poses(s[here] - begins[index])
        return x, y, heading

    def section_at(self, s: float) -> int:
        """Returns the index of the section at s."""
        begins = [section.begin for section in self.sections]
        return int(np.clip(np.searchsorted(begins, s, side="right") - 1, 0, len(begins) - 1))

    def end_of(self, index: int) -> float:
        """Returns the s at which a section ends."""
        return self.sections[index + 1].begin if index + 1 < len(self.sections) else self.length

    def centre(self, index: int, lane: int, s: Floats) -> tuple[Floats, Floats]:
        """Returns the points (n, 2) of a lane's centre in a section, and its widths (n,)."""
        section, side = self.sections[index], 1 if lane > 0 else -1
        t = self.offset.at(s)
        width = np.zeros(len(s))
        for number in range(side, lane + side, side):
            t = t + side * 0.5 * width
            width = section.lanes[number].widths.at(s - section.begin)
            t = t + side * 0.5 * width
        x, y, heading = self.reference(s)
        return np.column_stack([x - t * np.sin(heading), y + t * np.cos(heading)]), width

    def limits_between(self, index: int, lane: int, begin: float, end: float) -> list[tuple[float, float | None]]:
        """Returns the speed limits (m/s) of a lane of a section from s = `begin` to `end`, in this order: where each begins to hold.

        A limit is infinite if the file says that there is none, None if it has none.
        """
        section = self.sections[index]
        begins = [s for s, _ in self.limits] + [section.begin + s for s, _ in section.lanes[lane].limits]
        low, high = min(begin, end), max(begin, end)
        inner = sorted({s for s in begins if low + SHORTEST < s < high - SHORTEST}, reverse=end < begin)
        result: list[tuple[float, float | None]] = []
        for first, last in pairwise([begin, *inner, end]):
            limit = self._limit(section, lane, 0.5 * (first + last))
            if not result or result[-1][1] != limit:
                result.append((first, limit))
        return result

    def _limit(self, section: LaneSection, lane: int, s: float) -> float | None:
        own = _last(section.lanes[lane].limits, s - section.begin)
        return own if own is not None else _last(self.limits, s)


@dataclass(slots=True)
class RoadFile:
    """The content of an `.xodr`. `ignored`: how often each element stands in it that the conversion ignores; `notes`: on the rest;
    `lost`: the first link to a road that is not there."""

    name: str
    roads: dict[str, FileRoad]
    ignored: Mapping[str, int]
    notes: JoinedNotes
    lost: Problem | None = None


def read_opendrive(content: bytes, name: str) -> RoadFile:
    """Returns the roads of an OpenDRIVE file. `name`: the file's name in messages.

    Raises InvalidInputError naming file, road, cause and remedy.
    """
    reader = _Reader(name)
    read_elements(content, name, "OpenDRIVE", reader.start, reader.end)
    return reader.finished()


IGNORED = {
    "elevation": "heights",
    "superelevation": "banking",
    "shape": "lateral profiles",
    "object": "objects",
    "signal": "signals but traffic lights",
    "bridge": "bridges",
    "tunnel": "tunnels",
    "roadMark": "road marks",
    "access": "restrictions of lanes",
    "material": "surfaces",
    "border": "lane borders",
    "height": "heights of lanes",
    "rule": "rules of lanes",
    "railroad": "railways",
    "station": "stations",
}
"""Elements without effect on the network, and what they are."""
READ: Mapping[str, frozenset[str]] = {
    element: frozenset(children.split())
    for element, children in {
        "": "OpenDRIVE",
        "OpenDRIVE": "header road controller junction",
        "header": "geoReference",
        "controller": "control",
        "road": "link type planView elevationProfile lateralProfile lanes objects signals",
        "type": "speed",
        "planView": "geometry",
        "geometry": "line arc spiral poly3 paramPoly3",
        "lanes": "laneOffset laneSection",
        "laneSection": "left center right",
        "left": "lane",
        "center": "lane",
        "right": "lane",
        "lane": "link width speed",
        "link": "predecessor successor",
        "junction": "connection",
        "connection": "laneLink",
    }.items()
}
"""Elements that are read here or by netconvert, by the element around them; others are counted with all that they hold."""
GEOMETRIES = {"line", "arc", "spiral", "poly3", "paramPoly3"}


class _Reader:
    """Collects the elements of an OpenDRIVE file."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.roads: dict[str, FileRoad] = {}
        self.ignored: dict[str, int] = {}
        self.path: list[str] = []
        self.unread: int | None = None
        """Depth of the outermost element around that is not read."""
        self.road: FileRoad | None = None
        self.lane: FileLane | None = None
        self.geometry: Attributes | None = None
        self.kind_begin = 0.0
        self.is_virtual = False
        self.notes = JoinedNotes()
        self.named: list[tuple[Attributes, str]] = []
        """Elements that name a road, with the attribute."""

    def start(self, attributes: Attributes) -> None:
        """Takes an element of a known place. Refuses what would let netconvert read other files."""
        element = attributes.element
        if element == "include":
            raise attributes.fault("the element names another file, which netconvert would read", "give the roads in one file")
        inside = self.path[-1] if self.path else ""
        self.path.append(element)
        if self.unread is None and element not in READ.get(inside, ()):
            self.unread = len(self.path)
            self.ignored[element] = self.ignored.get(element, 0) + 1
        if self.unread is not None:
            return
        if element in GEOMETRIES and inside == "geometry" and self.road is not None and self.geometry is not None:
            self.road.geometries.append(geometry_of(self.geometry, attributes))
            self.geometry = None
        method: Any = getattr(self, f"on_{inside}_{element}".lower(), None)
        if method is not None:
            method(attributes)

    def end(self, tag: str) -> None:
        """Leaves an element."""
        is_read = self.unread is None
        if self.unread == len(self.path):
            self.unread = None
        self.path.pop()
        if not is_read:
            return
        if tag == "road":
            self._close_road()
        elif tag == "lane":
            self.lane = None
        elif tag == "geometry" and self.geometry is not None:
            raise self.geometry.fault("its kind is missing or unknown", f"give one of {', '.join(sorted(GEOMETRIES))}")

    def finished(self) -> RoadFile:
        """Returns the file's content."""
        if not self.roads:
            raise InvalidInputError(Problem(self.name, "the file has no roads", "give a file with roads"))
        lost: Problem | None = None
        for attributes, key in self.named:
            if (name := attributes.text(key)) not in self.roads:
                if lost is None:
                    message = f"{key} is {shown(name, 60)}, and there is no such road"
                    (lost,) = attributes.fault(message, nearest(name, list(self.roads))).problems
                self.notes.add(f"line {attributes.line}, <{attributes.element}>", f"{key} names a road that is not there")
        return RoadFile(self.name, self.roads, self.ignored, self.notes, lost)

    def on_opendrive_header(self, attributes: Attributes) -> None:
        """Checks the version."""
        if attributes.text("revMajor") != str(REVISION):
            message = f"OpenDRIVE of version {shown(attributes.text('revMajor'), 10)} cannot be read, only 1.x"
            raise attributes.fault(message, "export the file as OpenDRIVE 1.4 to 1.8")

    def on_opendrive_road(self, attributes: Attributes) -> None:
        """Opens a road."""
        name = attributes.text("id")
        if attributes.values.get("rule", "RHT") != "RHT":
            raise attributes.fault("the road is for left-hand traffic", "give a file for right-hand traffic")
        if name in self.roads:
            raise attributes.fault("another road has the same id", "rename one")
        _check_name(attributes, "id")
        junction = attributes.text("junction", "") or "-1"
        if not attributes.text("junction", ""):
            self.notes.add(f"road {name}", "no junction is given: taken as -1, which is none")
        self.road = FileRoad(name, attributes.number("length", 0.0, LONGEST), junction, attributes.line)
        self.roads[name] = self.road

    def on_planview_geometry(self, attributes: Attributes) -> None:
        """Opens a geometry."""
        self.geometry = attributes

    def on_lanes_laneoffset(self, attributes: Attributes) -> None:
        """Takes a lane offset."""
        self._open_road(attributes).offset.append(attributes, "s")

    def on_lanes_lanesection(self, attributes: Attributes) -> None:
        """Opens a lane section."""
        road = self._open_road(attributes)
        begin = attributes.number("s", 0.0, LONGEST)
        if road.sections and begin < road.sections[-1].begin:
            raise attributes.fault(f"road {shown(road.id, 60)}: the lane sections are not in order of s", "order them")
        road.sections.append(LaneSection(begin, single=attributes if attributes.truth("singleSide") else None))

    def _on_lane(self, attributes: Attributes) -> None:
        road, index = self._open_road(attributes), attributes.integer("id", -64, 64)
        if not road.sections or index in road.sections[-1].lanes:
            raise attributes.fault(f"road {shown(road.id, 60)}: the lane appears twice, or outside of a section", "rename it")
        kind, place = attributes.text("type", "none"), f"road {road.id}, lane {index}"
        direction = attributes.text("direction", "standard")
        if kind in DRIVEN and direction == "reversed":
            self.notes.add(place, 'driven against its side of the road (direction="reversed"): closed to all vehicles')
            kind = "reversed"
        elif kind in DRIVEN and direction != "standard":
            self.notes.add(place, f"direction {shown(direction, 30)}: driven in the direction of its side of the road only")
        elif kind not in DRIVEN and kind != "none":
            self.notes.add(place, f"of type {shown(kind, 30)}: no vehicle drives there")
        self.lane = FileLane(index, kind, attributes.line)
        road.sections[-1].lanes[index] = self.lane

    on_left_lane = on_right_lane = _on_lane

    def on_lane_width(self, attributes: Attributes) -> None:
        """Takes a lane's width."""
        if self.lane is not None:
            self.lane.widths.append(attributes, "sOffset")

    def on_lane_speed(self, attributes: Attributes) -> None:
        """Takes a lane's speed limit."""
        if self.lane is not None:
            self.lane.limits.append((attributes.number("sOffset", 0.0, LONGEST), self._speed(attributes)))

    def _on_link(self, attributes: Attributes) -> None:
        if self.path[-3] == "road":
            _check_name(attributes, "elementId")
            kind = attributes.text("elementType")
            self._open_road(attributes).linked.append((kind, attributes.text("elementId")))
            self.named += [(attributes, "elementId")] if kind == "road" else []
        elif self.lane is not None:  # one of the centre lane leads nowhere
            setattr(self.lane, attributes.element, attributes.integer("id", -64, 64))

    on_link_successor = on_link_predecessor = _on_link

    def on_opendrive_junction(self, attributes: Attributes) -> None:
        """Checks a junction, which netconvert reads."""
        _check_name(attributes, "id")
        self.is_virtual = attributes.text("type", "default") == VIRTUAL
        if self.is_virtual:
            self.notes.add(f"junction {attributes.text('id')}", "virtual: left out, and no vehicle turns there")

    def on_junction_connection(self, attributes: Attributes) -> None:
        """Checks a connection, which netconvert reads."""
        if self.is_virtual:
            return
        attributes.text("id")
        self.named += [
            (attributes, key) for key in ("incomingRoad", "connectingRoad", "linkedRoad") if key in attributes.values
        ]
        if len(self.named) < 2 or self.named[-2][0] is not attributes:
            raise attributes.fault("it names less than two roads", "give incomingRoad and connectingRoad")
        if "connectingRoad" in attributes.values and attributes.text("contactPoint") not in {"start", "end"}:
            raise attributes.fault(f"contactPoint is {shown(attributes.text('contactPoint'), 20)}", "give start or end")

    def on_connection_lanelink(self, attributes: Attributes) -> None:
        """Checks a link of lanes, which netconvert reads."""
        for key in ("from", "to"):
            attributes.integer(key, -64, 64)

    def on_road_type(self, attributes: Attributes) -> None:
        """Takes a road's type, which has no limit until one is found in it."""
        self.kind_begin = attributes.number("s", 0.0, LONGEST)
        self._open_road(attributes).limits.append((self.kind_begin, None))

    def on_type_speed(self, attributes: Attributes) -> None:
        """Takes a road's speed limit."""
        self._open_road(attributes).limits[-1] = (self.kind_begin, self._speed(attributes))

    def _speed(self, attributes: Attributes) -> float | None:
        """Returns a speed limit in m/s: infinite if there is none, None if the file leaves it open."""
        limit = attributes.text("max")
        if limit == NO_LIMIT:
            return math.inf
        if leaves_open(limit):
            if limit != OPEN_LIMIT:
                self.notes.add(f"line {attributes.line}, <speed>", f"max is {shown(limit, 20)}: taken as {OPEN_LIMIT}")
            return None
        unit = attributes.text("unit", "")
        if unit not in UNITS:
            raise attributes.fault(f"the unit {shown(unit, 20)} is unknown", "give m/s, km/h or mph")
        return attributes.number("max", SLOWEST, FASTEST) * UNITS[unit]

    def _open_road(self, attributes: Attributes) -> FileRoad:
        if self.road is None:
            raise attributes.fault("the element stands outside of a road", "move it into its road")
        return self.road

    def _close_road(self) -> None:
        road, self.road = self.road, None
        if road is None:
            return
        where = f"line {road.line}, the road {shown(road.id, 60)}"
        message = ""
        if not road.geometries:
            message = "has no reference line"
        elif not road.sections:
            message = "has no lane sections"
        elif any(first.begin > second.begin for first, second in pairwise(road.geometries)):
            message = "has geometries that are not in order of s"
        sides = {index > 0 for section in road.sections for index in section.lanes if index}
        for section in road.sections:
            if section.single is not None and {index > 0 for index in section.lanes if index} != sides:
                message = f'road {shown(road.id, 60)}: singleSide="true" is not supported, for the road has lanes on both sides'
                raise section.single.fault(message, "give each section the lanes of both sides")
            for side in (1, -1):
                numbers = sorted(abs(index) for index in section.lanes if index * side > 0)
                if numbers != list(range(1, len(numbers) + 1)):
                    message = "has lanes that are not numbered 1, 2, ... from the middle"
        if message:
            raise InvalidInputError(Problem(self.name, f"{where} {message}", "export the file again"))
        if road.sections[0].begin > FLAT:
            place = f"road {road.id}, s = 0 m to {road.sections[0].begin:g} m"
            self.notes.add(place, "no lane section: the lanes of the first one are there, too")
        ends = [*(geometry.begin for geometry in road.geometries[1:]), road.length]
        for geometry, end in zip(road.geometries, ends, strict=True):
            if abs(geometry.begin + geometry.length - end) > FLAT * max(1.0, geometry.length):
                first, last = sorted((geometry.begin + geometry.length, end))
                place = f"road {road.id}, s = {first:g} m to {last:g} m"
                self.notes.add(place, "the geometries leave it out, or are there twice; it is not driven")
            if geometry.kind != "paramPoly3":  # the others are as long as they say
                continue
            curve = float(np.hypot(*np.diff(geometry.poses(np.linspace(0.0, geometry.length, 101))[:2])).sum())
            if abs(curve - geometry.length) > FLAT * max(1.0, geometry.length):
                place = f"road {road.id}, s = {geometry.begin:g} m, length {geometry.length:g} m"
                self.notes.add(place, f"its paramPoly3 is {curve:g} m long, and the lanes are as long as that")


def _check_name(attributes: Attributes, key: str) -> None:
    """Raises InvalidInputError if SUMO cannot have an id."""
    if _NO_NAME.search(attributes.text(key)):
        message = f"{key} is {shown(attributes.text(key), 60)}: empty, or with a character that ids of SUMO cannot have"
        raise attributes.fault(message, "rename it in the whole file")


def leaves_open(limit: str) -> bool:
    """Returns whether the text of a speed limit says that there is none in the file: `undefined`, or a speed of no vehicle, such as 0."""
    try:
        return limit == OPEN_LIMIT or float(limit) < SLOWEST
    except ValueError:
        return False


def _last(limits: list[tuple[float, float | None]], s: float) -> float | None:
    before = [limit for begin, limit in sorted(limits, key=itemgetter(0)) if begin <= s + 1e-6]
    return before[-1] if before else None
