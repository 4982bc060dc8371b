"""Direct junctions (OpenDRIVE 1.7), which netconvert does not read: turns them into junctions with short connecting roads.

The connecting roads give netconvert the ways between lanes only: `placement` does not know them, and lets one lane follow the other.
"""

from dataclasses import dataclass
from math import cos, pi, sin
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.roads import Floats
from drivecal.roads.opendrive import DRIVEN, FileRoad, RoadFile

LENGTH = 0.1
"""Metres of a connecting road."""
START, END = "start", "end"


@dataclass(frozen=True, slots=True)
class _Side:
    """An end of a road at a junction."""

    road: FileRoad
    contact: str

    @property
    def section(self) -> int:
        """Index of the section there."""
        return 0 if self.contact == START else len(self.road.sections) - 1

    @property
    def s(self) -> float:
        """s of the end."""
        return 0.0 if self.contact == START else self.road.length

    def leaves(self, lane: int) -> bool:
        """Returns whether a lane's traffic leaves the road here, into the junction."""
        return (lane < 0) == (self.contact == END)

    def has(self, lane: int) -> bool:
        """Returns whether cars drive on a lane here."""
        lanes = self.road.sections[self.section].lanes
        return lane in lanes and lanes[lane].kind in DRIVEN


def connect_directly(document: Element, file: RoadFile) -> None:
    """Replaces the direct junctions of a document. Raises InvalidInputError naming a junction that links what is not there."""
    names = {road.get("id", ""): road for road in document.findall("road")}
    for junction in document.findall("junction"):
        if junction.get("type") != "direct":
            continue
        del junction.attrib["type"]
        name = junction.get("id", "")
        ways: dict[tuple[str, str, str, str], list[tuple[int, int]]] = {}
        sides: dict[tuple[str, str], _Side] = {}
        for connection in junction.findall("connection"):
            first, second = _sides(file, names, name, connection)
            for side in (first, second):
                sides[side.road.id, side.contact] = side
                _link(names[side.road.id], side.contact, name)
            for pair in connection.findall("laneLink"):
                lanes = _number(pair.get("from")), _number(pair.get("to"))
                if first.has(lanes[0]) and second.has(lanes[1]):
                    forwards = first.leaves(lanes[0])
                    before, after = (first, second) if forwards else (second, first)
                    key = (before.road.id, before.contact, after.road.id, after.contact)
                    ways.setdefault(key, []).append(lanes if forwards else (lanes[1], lanes[0]))
            junction.remove(connection)
        for number, (key, pairs) in enumerate(ways.items()):
            road = f"direct-{name}-{number}"
            while road in names:
                road += "-"
            document.insert(list(document).index(junction), _road(road, name, sides[key[:2]], sides[key[2:]], pairs))
            connection = SubElement(
                junction, "connection", id=str(number), incomingRoad=key[0], connectingRoad=road, contactPoint=START
            )
            for index, (before_lane, _) in enumerate(_ordered(pairs)):
                SubElement(connection, "laneLink", {"from": str(before_lane), "to": str(-1 - index)})


def _sides(file: RoadFile, names: dict[str, Element], junction: str, connection: Element) -> tuple[_Side, _Side]:
    """Returns the ends of the two roads that a connection joins."""
    incoming, linked = (connection.get(key, "") for key in ("incomingRoad", "linkedRoad"))
    for road in (incoming, linked):
        if road not in file.roads or road not in names:
            message = f"the direct junction {shown(junction, 60)} links the road {shown(road, 60)}, which is not there"
            raise InvalidInputError(Problem(file.name, message, "correct the junction"))
    other = connection.get("contactPoint", START)
    successor = names[incoming].find("link/successor")
    is_end = successor is not None and successor.get("elementId") == junction and successor.get("elementType") == "junction"
    return _Side(file.roads[incoming], END if is_end else START), _Side(file.roads[linked], END if other == END else START)


def _link(road: Element, contact: str, junction: str) -> None:
    """Links an end of a road to the junction."""
    link = road.find("link")
    if link is None:
        link = SubElement(road, "link")
    tag = "predecessor" if contact == START else "successor"
    for old in link.findall(tag):
        link.remove(old)
    SubElement(link, tag, elementType="junction", elementId=junction)


def _ordered(pairs: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Returns pairs of lanes from left to right in driving direction: a lane's number grows from the middle to the right."""
    return sorted(pairs, key=lambda pair: abs(pair[1]))


def _road(name: str, junction: str, before: _Side, after: _Side, pairs: list[tuple[int, int]]) -> Element:
    """Returns a connecting road of `LENGTH` that ends where the next road begins."""
    ordered = _ordered(pairs)
    s = np.array([after.s])
    x, y = _left_border(after, ordered[0][1], s)
    heading = float(after.road.reference(s)[2][0]) + (0.0 if after.contact == START else pi)
    road = Element("road", id=name, name="", length=repr(LENGTH), junction=junction)
    link = SubElement(road, "link")
    for tag, side in (("predecessor", before), ("successor", after)):
        SubElement(link, tag, elementType="road", elementId=side.road.id, contactPoint=side.contact)
    place = {"x": repr(x - LENGTH * cos(heading)), "y": repr(y - LENGTH * sin(heading)), "hdg": repr(heading)}
    geometry = SubElement(SubElement(road, "planView"), "geometry", {"s": "0.0", "length": repr(LENGTH)} | place)
    SubElement(geometry, "line")
    section = SubElement(SubElement(road, "lanes"), "laneSection", s="0.0")
    SubElement(SubElement(section, "center"), "lane", id="0", type="none", level="false")
    right = SubElement(section, "right")
    for index, (first, second) in enumerate(ordered):
        lane = SubElement(right, "lane", id=str(-1 - index), type="driving", level="false")
        links = SubElement(lane, "link")
        SubElement(links, "predecessor", id=str(first))
        SubElement(links, "successor", id=str(second))
        width = max(2.0, float(after.road.centre(after.section, second, s)[1][0]))
        SubElement(lane, "width", sOffset="0.0", a=repr(width), b="0.0", c="0.0", d="0.0")
    return road


def _left_border(side: _Side, lane: int, s: Floats) -> tuple[float, float]:
    """Returns the point of a lane's border towards the middle of the road."""
    (x, y), width = side.road.centre(side.section, lane, s)[0][0], side.road.centre(side.section, lane, s)[1][0]
    heading = float(side.road.reference(s)[2][0])
    left = 0.5 * width if lane < 0 else -0.5 * width
    return float(x - left * sin(heading)), float(y + left * cos(heading))


def _number(text: str | None) -> int:
    """Returns a lane's number, 0 if the text is not a number."""
    plain = (text or "").removeprefix("-")
    return int(text or "0") if plain.isascii() and plain.isdigit() and len(plain) < 3 else 0
