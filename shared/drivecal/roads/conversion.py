"""Conversion of OpenDRIVE files into SUMO networks, by netconvert of `eclipse-sumo`. The only module here that reads or writes files.

Equal files give equal bytes, if netconvert is the same: without the comment on time and place.
"""

import re
import shutil
import subprocess
import sysconfig
import tempfile
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import fromstring, indent, tostring

from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem, UnavailableError
from drivecal.roads.direct import connect_directly
from drivecal.roads.network import read_network, source_comment
from drivecal.roads.notes import JoinedNotes, cut
from drivecal.roads.opendrive import DRIVEN, IGNORED, NO_LIMIT, OPEN_LIMIT, RoadFile, read_opendrive
from drivecal.roads.placement import place

DEFAULT_WIDTH = 3.65
"""Metres; netconvert's own for lanes without a width."""
TIMEOUT = 300.0
"""Seconds, wall-clock."""
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
    notes = _completed(file).texts()
    raw, warnings = _run(_normalized(content, file), name)
    net = fromstring(raw)  # noqa: S314  # written by netconvert
    notes += place(net, file).texts()
    indent(net, "    ")
    network = b'<?xml version="1.0" encoding="UTF-8"?>\n' + source_comment(content) + tostring(net) + b"\n"
    read_network(network, name)
    notes += [f"{count} x {_named(element)}: ignored" for element, count in sorted(file.ignored.items())]
    notes += _told(warnings)
    return Conversion(network, cut(notes))


def _named(element: str) -> str:
    """Returns an element's tag, and what it is if that is known."""
    return f"{element} ({IGNORED[element]})" if element in IGNORED else shown(element, 60)


def _told(warnings: list[str]) -> list[str]:
    """Returns netconvert's warnings, of those that differ in names and numbers only the first."""
    alike: dict[str, list[str]] = {}
    for warning in warnings:
        alike.setdefault(_VARYING.sub("", warning), []).append(warning)
    counts = [(same[0], len(same)) for same in alike.values()]
    return [f"netconvert: {first}" + (f" (and {count - 1} like it)" if count > 1 else "") for first, count in counts]


def netconvert() -> str:
    """Returns the path of netconvert, preferably of this environment. Raises UnavailableError if it is missing."""
    executable = shutil.which("netconvert", path=sysconfig.get_path("scripts")) or shutil.which("netconvert")
    if executable is None:
        message = "netconvert, which makes networks, is not installed; type: pip install 'drivecal[opendrive]'"
        raise UnavailableError(message)
    return executable


def _completed(file: RoadFile) -> JoinedNotes:
    """Gives lanes without a width netconvert's; returns notes on them. Raises InvalidInputError for lanes given by borders."""
    notes = JoinedNotes()
    for road in file.roads.values():
        for section in road.sections:
            for lane in section.lanes.values():
                if lane.id == 0 or lane.widths.records:
                    continue
                if "border" in file.ignored:
                    message = (
                        f"line {lane.line}, road {shown(road.id, 60)}, lane {lane.id}: it has no width, but perhaps a border"
                    )
                    raise InvalidInputError(Problem(file.name, message, "export the file with widths"))
                if lane.kind in DRIVEN:
                    lane.widths.records.append((0.0, DEFAULT_WIDTH, 0.0, 0.0, 0.0))
                    notes.add(
                        f"road {road.id}, lane {lane.id}", f"no width; the network has {DEFAULT_WIDTH} m, netconvert's default"
                    )
    return notes


def _normalized(content: bytes, file: RoadFile) -> bytes:
    """Returns the file as netconvert wants it: lanes from the left to the right, and no direct junctions."""
    document = fromstring(content)  # noqa: S314  # `read_opendrive` has refused document types
    for section in document.iter("laneSection"):
        for side in section:
            if side.tag in {"left", "right"}:
                side[:] = sorted(side, key=lambda lane: -int(lane.get("id", "0")))
    for lane in document.iter("lane"):
        lane.attrib.setdefault("type", "none")
        for speed in lane.findall("speed"):
            if speed.get("max") in {NO_LIMIT, OPEN_LIMIT}:  # netconvert reads them as numbers, and gives up
                lane.remove(speed)
    connect_directly(document, file)
    return tostring(document)


def _run(content: bytes, name: str) -> tuple[bytes, list[str]]:
    """Returns netconvert's network and its warnings."""
    executable = netconvert()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder)
        (path / "road.xodr").write_bytes(content)
        command = [executable, *OPTIONS, "--opendrive-files", "road.xodr", "-o", "road.net.xml"]
        try:
            process = subprocess.run(  # noqa: S603  # no words of a user
                command, cwd=path, capture_output=True, text=True, errors="replace", check=False, timeout=TIMEOUT
            )
        except subprocess.TimeoutExpired as error:
            message = f"netconvert did not finish in {TIMEOUT:g} s"
            raise InvalidInputError(Problem(name, message, "cut the part out that is driven")) from error
        said = [line.strip() for line in (process.stdout + process.stderr).splitlines()]
        errors, warnings = (
            [line.partition(": ")[2] for line in said if line.startswith(kind)] for kind in ("Error", "Warning")
        )
        result = path / "road.net.xml"
        if process.returncode != 0 or not result.is_file():
            message = shown(errors[0] if errors else f"it ended with {process.returncode}", 300)
            raise InvalidInputError(Problem(name, f"netconvert cannot convert it: {message}", "correct the file there"))
        return re.sub(rb"<!--.*?-->\s*", b"", result.read_bytes(), count=1, flags=re.DOTALL), warnings
