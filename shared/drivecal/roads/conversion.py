"""Conversion of OpenDRIVE files into SUMO networks, by netconvert of `eclipse-sumo`. The only module here that reads or writes files.

Equal files give equal bytes, if netconvert is the same: without the comment on time and place. netconvert does not read direct junctions
(OpenDRIVE 1.7): they become junctions with short connecting roads first. These give netconvert the ways between lanes only: `placement`
does not know them, and lets one lane follow the other.
"""

import os
import re
import shutil
import signal
import subprocess
import sysconfig
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, inf, pi, sin
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, fromstring, indent, tostring

import numpy as np

from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem, UnavailableError
from drivecal.domain.roads import Floats
from drivecal.roads.documents import cut
from drivecal.roads.network import WIDEST, read_network, source_comment
from drivecal.roads.opendrive import (
    DRIVEN,
    FLAT,
    IGNORED,
    LIGHTS,
    NO_LIMIT,
    READ,
    VIRTUAL,
    FileLane,
    FileRoad,
    RoadFile,
    leaves_open,
    read_opendrive,
)
from drivecal.roads.placement import OUTSIDE, place

LEFT_OUT = frozenset({"connectingRamp", "slipLane"})
"""Types of driven lanes that netconvert does not know, and would leave out without a word."""
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
                lanes = int(pair.get("from", "0")), int(pair.get("to", "0"))
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


DEFAULT_WIDTH = 3.65
"""Metres; netconvert's own for lanes without a width."""
TIMEOUT = 300.0
"""Seconds, wall-clock: a busy machine runs `SECONDS` slowly."""
SECONDS, MEGABYTES = 60, 2048
"""Processor time and address space of netconvert: it may take both without end for a curve that is nearly an arc."""
SUMO = Path(sysconfig.get_path("platlib"), "sumo")  # the script of its netconvert takes as long to start as netconvert runs
_LIMITED = 'ulimit -v "$1" && ulimit -t "$2" && shift 2 && exec "$@"'
OPTIONS = (
    "--opendrive.curve-resolution", "1", "--opendrive.internal-shapes", "true", "--offset.disable-normalization", "true",
    "--no-turnarounds", "true", "--output.original-names", "true", "--precision", "4", "--xml-validation", "never",
    "--flatten", "true",
)  # fmt: skip
_VARYING = re.compile(r"'[^']*'|[-+0-9.]+")
"""Names and numbers of a warning."""


@dataclass(frozen=True, slots=True)
class Conversion:
    """A converted file: the SUMO network, and what netconvert assumed or ignored."""

    network: bytes
    notes: tuple[str, ...]


def converted(content: bytes, name: str) -> Conversion:
    """Returns the network of an OpenDRIVE file. `name`: the file's name in messages.

    Raises InvalidInputError naming file, road and cause if it cannot be driven, and UnavailableError if netconvert is missing.
    """
    file = read_opendrive(content, name)
    _complete(file)
    raw, warnings = _run(_normalized(content, file), file)
    net = fromstring(raw)  # noqa: S314  # written by netconvert
    notes = file.notes.texts() + place(net, file).texts()
    indent(net, "    ")
    network = b'<?xml version="1.0" encoding="UTF-8"?>\n' + source_comment(content) + tostring(net) + b"\n"
    read_network(network, f"the network that netconvert makes of {name}")
    notes += [f"{count} x {_named(element)}: ignored" for element, count in sorted(file.ignored.items())]
    notes += _told(warnings)
    return Conversion(network, cut(notes))


def _named(element: str) -> str:
    """Returns an element's tag, and what it is if that is known."""
    return f"{element} ({IGNORED[element]})" if element in IGNORED else shown(element, 60)


def _told(warnings: list[str]) -> list[str]:
    """Returns netconvert's warnings; if several differ in names and numbers only, the first."""
    alike: dict[str, list[str]] = {}
    for warning in warnings:
        alike.setdefault(_VARYING.sub("", warning), []).append(warning)
    counts = [(same[0], len(same)) for same in alike.values()]
    return [f"netconvert: {first}" + (f" (and {count - 1} like it)" if count > 1 else "") for first, count in counts]


def netconvert() -> str:
    """Returns the path of netconvert, preferably of this environment. Raises UnavailableError if it is missing."""
    executable = shutil.which("netconvert", path=f"{SUMO}/bin:{sysconfig.get_path('scripts')}") or shutil.which("netconvert")
    if executable is None:
        message = "netconvert, which makes networks, is not installed; type: pip install 'drivecal[opendrive]'"
        raise UnavailableError(message)
    return executable


def _complete(file: RoadFile) -> None:
    """Gives lanes without a width netconvert's, with a note. Raises InvalidInputError for lanes given by borders, or of absurd width."""
    for road in file.roads.values():
        for index, section in enumerate(road.sections):
            for lane in section.lanes.values():
                _check_width(file, road, lane, road.end_of(index) - section.begin)


def _check_width(file: RoadFile, road: FileRoad, lane: FileLane, length: float) -> None:
    place = f"line {lane.line}, road {shown(road.id, 60)}, lane {lane.id}"
    if lane.widths.records:
        widths = lane.widths.at(np.linspace(0.0, length, 21))
        fits = (widths >= -0.01) & (widths <= (WIDEST if lane.kind in DRIVEN else inf))  # exporters round
        if not fits.all():
            message = f"{place}: the lane is {max(widths[~fits].tolist(), key=abs):g} m wide"
            raise InvalidInputError(Problem(file.name, message, f"give widths from 0 to {WIDEST:g} m"))
    elif lane.id != 0 and "border" in file.ignored:
        message = f"{place}: it has no width, but perhaps a border"
        raise InvalidInputError(Problem(file.name, message, "export the file with widths"))
    elif lane.id != 0 and lane.kind in DRIVEN:
        lane.widths.records.append((0.0, DEFAULT_WIDTH, 0.0, 0.0, 0.0))
        text = f"no width; the network has {DEFAULT_WIDTH} m, netconvert's default"
        file.notes.add(f"road {road.id}, lane {lane.id}", text)


def _normalized(content: bytes, file: RoadFile) -> bytes:
    """Returns the file as netconvert wants it: what is read alone, lanes from left to right, no flat spirals, no direct junctions."""
    document = fromstring(content)  # noqa: S314  # `read_opendrive` has refused document types
    namespace = document.tag.removesuffix("OpenDRIVE")
    for element in document.iter():
        element.tag = element.tag.removeprefix(namespace) if namespace else element.tag
    for element in document.iter():
        known = READ.get(element.tag, frozenset()) | ({"signal"} if element.tag == "signals" else set())
        for child in list(element):
            if child.tag not in known or (child.tag == "signal" and not _is_light(child)):
                element.remove(child)
    document[:] = [child for child in document if child.get("type") != VIRTUAL]
    for road in document.iter("road"):
        road.set("junction", road.get("junction") or OUTSIDE)  # netconvert refuses a road without
    for header in document.iter("header"):
        header.set("revMinor", minor if (minor := header.get("revMinor", "")).isdigit() else "4")
    for geometry in document.iter("geometry"):
        for curve in [child for child in geometry if child.tag in {"arc", "spiral"}]:
            _flatten(geometry, curve)
    for section in document.iter("laneSection"):
        for side in section:
            if side.tag in {"left", "right"}:
                side[:] = sorted(side, key=lambda lane: -int(lane.get("id", "0")))
    for lane in document.iter("lane"):
        kind = lane.get("type", "none")
        lane.set("type", "driving" if kind in LEFT_OUT else kind)
    for holder in (*document.iter("lane"), *document.iter("type")):
        for speed in holder.findall("speed"):
            limit = speed.get("max", "")  # netconvert reads all of lanes as numbers, and gives up
            if leaves_open(limit) or (limit == NO_LIMIT and holder.tag == "lane"):
                holder.remove(speed)
    connect_directly(document, file)
    return tostring(document)


def _is_light(signal: Element) -> bool:
    """Returns whether a signal is a traffic light, which netconvert reads."""
    kind = signal.get("type", "")
    return all(signal.get(key) for key in ("id", "s", "dynamic", "orientation")) and kind in LIGHTS


def _flatten(geometry: Element, curve: Element) -> None:
    """Replaces a spiral that is an arc within a millimetre, and an arc that is a line: netconvert divides by their curvatures."""
    keys = ("curvature", "curvature") if curve.tag == "arc" else ("curvStart", "curvEnd")
    first, last = (float(curve.get(key, "0")) for key in keys)
    square = float(geometry.get("length", "0")) ** 2 / 8.0
    if curve.tag == "spiral" and abs(last - first) * square > FLAT:
        return
    mean = 0.5 * (first + last)
    curve.attrib.clear()
    curve.tag = "line" if abs(mean) * square <= FLAT else "arc"
    if curve.tag == "arc":
        curve.set("curvature", repr(mean))


def run_netconvert(arguments: Sequence[str], folder: Path) -> "subprocess.CompletedProcess[str]":
    """Runs netconvert in a folder, within `SECONDS` of processor time and `MEGABYTES` of memory.

    Raises UnavailableError if it is missing, and subprocess.TimeoutExpired after `TIMEOUT` seconds.
    """
    command = ["/bin/sh", "-c", _LIMITED, "sh", str(MEGABYTES * 1024), str(SECONDS), netconvert(), *arguments]
    own = {"SUMO_HOME": str(SUMO), "PROJ_LIB": f"{SUMO}/data/proj", "PROJ_DATA": f"{SUMO}/data/proj"} if SUMO.is_dir() else {}
    return subprocess.run(  # noqa: S603  # no words of a user
        command, cwd=folder, env=own | os.environ, capture_output=True, errors="replace", check=False, timeout=TIMEOUT
    )


def _run(content: bytes, file: RoadFile) -> tuple[bytes, list[str]]:
    """Returns netconvert's network and its warnings."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder)
        (path / "road.xodr").write_bytes(content)
        try:
            process = run_netconvert([*OPTIONS, "--opendrive-files", "road.xodr", "-o", "road.net.xml"], path)
        except subprocess.TimeoutExpired as error:
            message = f"netconvert did not finish in {TIMEOUT:g} s"
            raise InvalidInputError(Problem(file.name, message, "cut the part out that is driven")) from error
        said = [line.strip() for line in (process.stdout + process.stderr).splitlines()]
        errors, warnings = ([row.partition(": ")[2] for row in said if row.startswith(kind)] for kind in ("Error", "Warning"))
        result = path / "road.net.xml"
        if process.returncode != 0 or not result.is_file():
            raise InvalidInputError(_cause(file, process.returncode, errors))
        return re.sub(rb"<!--.*?-->\s*", b"", result.read_bytes(), count=1, flags=re.DOTALL), warnings


def _cause(file: RoadFile, code: int, errors: list[str]) -> Problem:
    """Returns why netconvert has failed: roads that it cannot read, its limits, or its own words with the roads that they name."""
    said = errors[0] if errors else f"it ended with {code}"
    if code in {-signal.SIGXCPU, -signal.SIGKILL} or "bad_alloc" in said:
        message = f"netconvert takes more than {SECONDS} s of processor time, or more than {MEGABYTES} MB"
        return Problem(file.name, message, "cut the part out that is driven, and look for curves of absurd curvature or length")
    for road in file.roads.values():
        for kind, link in road.linked:
            junction = link if kind == "junction" else file.roads[link].junction if link in file.roads else OUTSIDE
            if OUTSIDE not in {road.junction, junction} and road.junction != junction:
                there = f"road {shown(link, 60)} of junction" if kind == "road" else "junction"
                message = (
                    f"line {road.line}, the road {shown(road.id, 60)} of junction {shown(road.junction, 60)} leads to the {there} "
                    f"{shown(junction, 60)}, which netconvert cannot convert"
                )
                return Problem(file.name, message, "put a road between the junctions, or make them one junction")
    if file.lost and "is not known" in said:
        return file.lost
    if "No edges" in said:
        roads = file.roads.values()
        kinds = {lane.kind for road in roads for section in road.sections for lane in section.lanes.values() if lane.id}
        given = [shown(", ".join(sorted(names)) or "none", 200) for names in (kinds, {road.junction for road in roads})]
        longest = f"roads up to {max(road.length for road in roads):g} m long and in the junctions {given[1]}"
        message = f"no road outside of junctions has a length and a lane for cars: lanes of type {given[0]}, {longest}"
        return Problem(file.name, message, f'give such a road: a lane of type driving, and junction="{OUTSIDE}"')
    named = [road for name, road in file.roads.items() if f"'{name}'" in said or len(file.roads) == 1]
    where = "".join(f"line {road.line}, road {shown(road.id, 60)}: " for road in named[:1])
    remedy = "correct the road there" if named else "export the file again, or leave out roads until it can be converted"
    return Problem(file.name, f"{where}netconvert cannot convert it: {shown(said, 300)}", remedy)
