"""OpenDRIVE files for tests: motorways with curves, ramps and lanes that open, close and change their width."""

import re
from dataclasses import dataclass, field
from math import cos, sin
from xml.etree import ElementTree as ET

from tests.support.opendrive_reader import RoadFile

Shape = tuple[str, float, dict[str, float | str]]
"""Kind, length and attributes of a geometry."""
Widths = list[tuple[float, float, float, float, float]]
"""sOffset, a, b, c, d."""
PAVED: Widths = [(0.0, 3.5, 0.0, 0.0, 0.0)]


def line(length: float) -> Shape:
    """A straight."""
    return "line", length, {}


def arc(length: float, curvature: float) -> Shape:
    """An arc."""
    return "arc", length, {"curvature": curvature}


def spiral(length: float, first: float, last: float) -> Shape:
    """A clothoid."""
    return "spiral", length, {"curvStart": first, "curvEnd": last}


def opening(length: float, width: float) -> Widths:
    """A lane that opens smoothly over a length."""
    return [(0.0, 0.0, 0.0, 3 * width / length**2, -2 * width / length**3), (length, width, 0.0, 0.0, 0.0)]


def closing(length: float, width: float) -> Widths:
    """A lane that closes smoothly over a length."""
    return [(0.0, width, 0.0, -3 * width / length**2, 2 * width / length**3)]


LaneLinks = dict[int, dict[int, tuple[int | None, int | None]]]


@dataclass
class Road:
    """A road to be written. `sections`: begin, and type and widths by lane; `links`: predecessor and successor as type and id."""

    id: str
    shapes: list[Shape]
    sections: list[tuple[float, dict[int, tuple[str, Widths]]]]
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    junction: str = "-1"
    links: dict[str, tuple[str, str]] = field(default_factory=dict)
    offsets: Widths = field(default_factory=list)
    limit: tuple[str, str] | None = None
    """Largest speed and its unit."""
    lane_links: LaneLinks = field(default_factory=dict)
    """By section and lane: the predecessor and the successor."""

    @property
    def length(self) -> float:
        """Length of the reference line."""
        return sum(shape[1] for shape in self.shapes)

    def element(self) -> ET.Element:
        """The road as XML."""
        road = ET.Element("road", id=self.id, length=repr(self.length), junction=self.junction, name="")
        link = ET.SubElement(road, "link")
        for name, (kind, other) in self.links.items():
            place = {} if kind == "junction" else {"contactPoint": "end" if name == "predecessor" else "start"}
            ET.SubElement(link, name, {"elementType": kind, "elementId": other} | place)
        if self.limit is not None:
            ET.SubElement(ET.SubElement(road, "type", s="0", type="motorway"), "speed", max=self.limit[0], unit=self.limit[1])
        plan = ET.SubElement(road, "planView")
        s, pose = 0.0, self.start
        for kind, length, attributes in self.shapes:
            place = dict(zip(("x", "y", "hdg"), map(repr, pose), strict=True))
            geometry = ET.SubElement(plan, "geometry", {"s": repr(s), "length": repr(length)} | place)
            ET.SubElement(geometry, kind, {name: str(value) for name, value in attributes.items()})
            s += length
            pose = RoadFile(road).reference(s)
        lanes = ET.SubElement(road, "lanes")
        for begin, *coefficients in self.offsets:
            ET.SubElement(lanes, "laneOffset", {"s": repr(begin)} | _named(coefficients))
        for number, (begin, content) in enumerate(self.sections):
            section = ET.SubElement(lanes, "laneSection", s=repr(begin))
            for side, ids in (
                ("left", [i for i in content if i > 0]),
                ("center", [0]),
                ("right", [i for i in content if i < 0]),
            ):
                if ids:
                    self._side(ET.SubElement(section, side), sorted(ids, reverse=True), number, content)
        return road

    def _side(self, side: ET.Element, ids: list[int], number: int, content: dict[int, tuple[str, Widths]]) -> None:
        for index in ids:
            kind, widths = content.get(index, ("none", []))
            lane = ET.SubElement(side, "lane", id=str(index), type=kind, level="false")
            link = ET.SubElement(lane, "link")
            for name, other in zip(
                ("predecessor", "successor"), self.lane_links.get(number, {}).get(index, (None, None)), strict=True
            ):
                if other is not None:
                    ET.SubElement(link, name, id=str(other))
            for begin, *coefficients in widths:
                ET.SubElement(lane, "width", {"sOffset": repr(begin)} | _named(coefficients))

    def end(self) -> tuple[float, float, float]:
        """Pose of the end."""
        return RoadFile(self.element()).reference(self.length)


def _named(coefficients: list[float]) -> dict[str, str]:
    return dict(zip("abcd", map(repr, coefficients), strict=True))


def document(roads: list[Road], junctions: dict[str, list[tuple[str, str, list[tuple[int, int]]]]] | None = None) -> bytes:
    """Returns a file. `junctions` maps ids to incoming road, connecting road and pairs of lanes."""
    root = ET.Element("OpenDRIVE")
    ET.SubElement(root, "header", revMajor="1", revMinor="6", name="", version="1", north="0", south="0", east="0", west="0")
    root.extend([road.element() for road in roads])
    for name, connections in (junctions or {}).items():
        junction = ET.SubElement(root, "junction", id=name, name="")
        for number, (incoming, connecting, pairs) in enumerate(connections):
            connection = ET.SubElement(
                junction, "connection", id=str(number), incomingRoad=incoming, connectingRoad=connecting, contactPoint="start"
            )
            for first, second in pairs:
                ET.SubElement(connection, "laneLink", {"from": str(first), "to": str(second)})
    return b'<?xml version="1.0"?>\n' + ET.tostring(root)


def exit_ramp() -> bytes:
    """A motorway in a clothoid and an arc, whose exit lane opens over 80 m and leaves on a ramp. Lanes of 3.9, 3.5 and 2.85 m."""
    wide, narrow = [(0.0, 3.9, 0.0, 0.0, 0.0)], [(0.0, 2.85, 0.0, 0.0, 0.0)]
    two = {-1: ("driving", wide), -2: ("driving", PAVED), -3: ("stop", narrow)}
    three = {-1: ("driving", wide), -2: ("driving", PAVED), -3: ("exit", opening(80.0, 3.5))}
    main = Road(
        "1",
        [line(150.0), spiral(120.0, 0.0, 1 / 700), arc(230.0, 1 / 700), spiral(100.0, 1 / 700, 0.0)],
        [(0.0, two), (300.0, three)],
        start=(1000.0, -200.0, 0.3),
        links={"successor": ("junction", "100")},
        offsets=[
            (0.0, 0.0, 0.0, 0.0, 0.0),
            (150.0, 0.0, 0.0, 3 * 1.2 / 150**2, -2 * 1.2 / 150**3),
            (300.0, 1.2, 0.0, 0.0, 0.0),
        ],
        limit=("130", "km/h"),
        lane_links={0: {-1: (None, -1), -2: (None, -2)}, 1: {-1: (-1, None), -2: (-2, None)}},
    )
    onward = {-1: ("driving", wide), -2: ("driving", PAVED)}
    through = Road(
        "10", [line(60.0)], [(0.0, onward)], main.end(), "100", {"predecessor": ("road", "1"), "successor": ("road", "2")},
        [(0.0, 1.2, 0.0, 0.0, 0.0)], ("130", "km/h"), {0: {-1: (-1, -1), -2: (-2, -2)}},
    )  # fmt: skip
    after = Road(
        "2", [line(300.0)], [(0.0, onward)], through.end(), "-1", {"predecessor": ("junction", "100")},
        [(0.0, 1.2, 0.0, 0.0, 0.0)], ("100", "km/h"),
    )  # fmt: skip
    _, _, heading = main.end()
    ramp_start = RoadFile(main.element()).centre(main.element().findall("lanes/laneSection")[1], -3, main.length)
    start = (ramp_start[0] - 1.75 * sin(heading), ramp_start[1] + 1.75 * cos(heading), heading)
    single = {-1: ("exit", PAVED)}
    leaving = Road(
        "11", [spiral(60.0, 0.0, -1 / 250)], [(0.0, single)], start, "100", {"predecessor": ("road", "1"), "successor": ("road", "3")},
        [], ("80", "km/h"), {0: {-1: (-3, -1)}},
    )  # fmt: skip
    ramp = Road(
        "3", [arc(200.0, -1 / 250)], [(0.0, single)], leaving.end(), "-1", {"predecessor": ("junction", "100")}, [], ("60", "km/h"),
    )  # fmt: skip
    pairs = {"100": [("1", "10", [(-1, -1), (-2, -2)]), ("1", "11", [(-3, -1)])]}
    return document([main, through, after, leaving, ramp], pairs)


def entrance() -> bytes:
    """A ramp, given by polynomials, that joins a motorway on a third lane, which closes. Without any speed limit on the ramp."""
    two = {-1: ("driving", PAVED), -2: ("driving", PAVED)}
    main = Road("1", [line(250.0)], [(0.0, two)], (0.0, 0.0, 0.0), "-1", {"successor": ("junction", "7")}, [], ("75", "mph"))
    joined = Road(
        "10", [line(50.0)], [(0.0, two)], main.end(), "7", {"predecessor": ("road", "1"), "successor": ("road", "2")},
        [], ("75", "mph"), {0: {-1: (-1, -1), -2: (-2, -2)}},
    )  # fmt: skip
    merging = Road(
        "11", [line(50.0)], [(0.0, {-1: ("onRamp", PAVED)})], (250.0, -7.0, 0.0), "7",
        {"predecessor": ("road", "3"), "successor": ("road", "2")}, [], ("75", "mph"), {0: {-1: (-1, -3)}},
    )  # fmt: skip
    three = two | {-3: ("entry", PAVED)}
    dropped = two | {-3: ("entry", closing(60.0, 3.5))}
    after = Road(
        "2", [line(100.0), arc(300.0, 1 / 900), line(50.0)], [(0.0, three), (200.0, dropped), (260.0, two)], joined.end(), "-1",
        {"predecessor": ("junction", "7")}, [], ("120", "km/h"),
        {
            0: {-1: (None, -1), -2: (None, -2), -3: (None, -3)}, 1: {-1: (-1, -1), -2: (-2, -2), -3: (-3, None)},
            2: {-1: (-1, None), -2: (-2, None)},
        },
    )  # fmt: skip
    # v = c p² + d p³ comes from 20 m to the right with the same heading at the end
    cubic: Shape = (
        "paramPoly3",
        200.99,
        {"pRange": "normalized", "aU": 0, "bU": 200, "cU": 0, "dU": 0, "aV": 0, "bV": 0, "cV": 60, "dV": -40},
    )
    ramp = Road("3", [cubic], [(0.0, {-1: ("onRamp", PAVED)})], (50.0, -27.0, 0.0), "-1", {"successor": ("junction", "7")})
    pairs = {"7": [("1", "10", [(-1, -1), (-2, -2)]), ("3", "11", [(-1, -1)])]}
    return document([main, joined, merging, after, ramp], pairs)


def two_way() -> bytes:
    """A road with three lanes in one direction and two in the other: one of the three opens and closes, widths change, a poly3."""
    poly: Shape = ("poly3", 180.0, {"a": 0, "b": 0, "c": 2e-4, "d": -4e-7})
    swelling: Widths = [(0.0, 2.85, 0.0, 3 * 1.05 / 200**2, -2 * 1.05 / 200**3), (200.0, 3.9, 0.0, 0.0, 0.0)]
    base = {2: ("driving", PAVED), 1: ("driving", swelling), -1: ("driving", swelling), -2: ("driving", PAVED)}
    more = {
        2: ("driving", PAVED), 1: ("driving", [(0.0, 3.9, 0.0, 0.0, 0.0)]), -1: ("driving", [(0.0, 3.9, 0.0, 0.0, 0.0)]),
        -2: ("driving", PAVED), -3: ("driving", opening(60.0, 3.2)),
    }  # fmt: skip
    same: dict[int, tuple[int | None, int | None]] = {index: (index, index) for index in (2, 1, -1, -2)}
    road = Road(
        "5", [line(120.0), poly, arc(300.0, -1 / 500)],
        [
            (0.0, base), (240.0, more), (400.0, more | {-3: ("driving", closing(60.0, 3.2))}),
            (460.0, base | {-1: more[-1], 1: more[1]}),
        ],
        (-300.0, 80.0, -1.0), limit=("33.5", "m/s"),
        lane_links={0: same, 1: same | {-3: (None, -3)}, 2: same | {-3: (-3, None)}, 3: same},
    )  # fmt: skip
    return document([road])


def direct() -> bytes:
    """Two motorways with direct junctions, i.e. without connecting roads: a ramp leaves the first, and a ramp joins the second."""
    two = {-1: ("driving", PAVED), -2: ("driving", PAVED)}
    three = two | {-3: ("exit", opening(80.0, 3.5))}
    main = Road(
        "1", [line(120.0), arc(180.0, 1 / 800)], [(0.0, two), (150.0, three)], (10.0, 20.0, 2.0), "-1",
        {"successor": ("junction", "8")}, [], ("120", "km/h"), {0: {-1: (None, -1), -2: (None, -2)}, 1: {-1: (-1, None), -2: (-2, None)}},
    )  # fmt: skip
    after = Road(
        "2", [line(250.0)], [(0.0, two)], main.end(), "-1", {"predecessor": ("junction", "8"), "successor": ("junction", "9")}
    )
    x, y, heading = main.end()
    side = (x + 7.0 * sin(heading), y - 7.0 * cos(heading), heading)
    ramp = Road(
        "3", [spiral(150.0, 0.0, -1 / 300)], [(0.0, {-1: ("offRamp", PAVED)})], side, "-1", {"predecessor": ("junction", "8")}
    )
    joined = Road(
        "4", [line(300.0)], [(0.0, two | {-3: ("entry", PAVED)}), (200.0, two | {-3: ("entry", closing(60.0, 3.5))}), (260.0, two)],
        after.end(), "-1", {"predecessor": ("junction", "9")},
        lane_links={
            0: {-1: (None, -1), -2: (None, -2), -3: (None, -3)}, 1: {-1: (-1, -1), -2: (-2, -2), -3: (-3, None)},
            2: {-1: (-1, None), -2: (-2, None)},
        },
    )  # fmt: skip
    x, y, heading = after.end()
    x, y = x + 7.0 * sin(heading) - 150.0 * cos(heading), y - 7.0 * cos(heading) - 150.0 * sin(heading)
    entry = Road("5", [line(150.0)], [(0.0, {-1: ("onRamp", PAVED)})], (x, y, heading), "-1", {"successor": ("junction", "9")})
    root = ET.fromstring(document([main, after, ramp, joined, entry]))
    pairs = {
        "8": [("1", "2", [(-1, -1), (-2, -2)]), ("1", "3", [(-3, -1)])],
        "9": [("4", "2", [(-1, -1), (-2, -2)]), ("5", "4", [(-1, -3)])],
    }
    for name, connections in pairs.items():
        junction = ET.SubElement(root, "junction", id=name, name="", type="direct")
        for number, (incoming, linked, lanes) in enumerate(connections):
            contact = "end" if linked == "2" and name == "9" else "start"
            connection = ET.SubElement(
                junction, "connection", id=str(number), incomingRoad=incoming, linkedRoad=linked, contactPoint=contact
            )
            for first, second in lanes:
                ET.SubElement(connection, "laneLink", {"from": str(first), "to": str(second)})
    return ET.tostring(root)


FILES = {"exit_ramp": exit_ramp, "entrance": entrance, "two_way": two_way, "direct": direct}


def edited(file: str, pattern: str, replacement: str, count: int = 1) -> bytes:
    """Returns a file with a pattern replaced."""
    text, done = re.subn(pattern, replacement, FILES[file]().decode(), count=count, flags=re.DOTALL)
    assert done
    return text.encode()
