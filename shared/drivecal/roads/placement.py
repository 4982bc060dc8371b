"""Lanes of a converted network at the places that the OpenDRIVE file gives them.

netconvert gives a lane one width and an edge one shape. Here each lane's points, widths and limit are computed from the file: between
the two stations of its road that netconvert chose as its ends. Lanes inside of junctions follow the connecting road, with the rest of
the lane before and the begin of the lane after.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from math import ceil
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from drivecal.domain.roads import Floats
from drivecal.roads.lines import lengths
from drivecal.roads.network import ORIGIN, WIDTHS
from drivecal.roads.opendrive import DRIVEN, FileRoad, RoadFile

STEP = 1.0
DETAIL = 0.01
"""Metres that points may be left out for."""
CLOSED = "emergency authority"
"""SUMO's classes that may drive where cars may not."""
DECIMALS = 4


@dataclass(frozen=True, slots=True)
class Piece:
    """A lane of a section from s = `begin` to `end` of its road, in driving direction."""

    road: FileRoad
    section: int
    lane: int
    begin: float
    end: float

    def points(self) -> tuple[Floats, Floats]:
        """Returns points (n, 2) and widths (n,)."""
        count = max(1, ceil(abs(self.end - self.begin) / STEP)) + 1
        low, high = sorted((self.road.sections[self.section].begin, self.road.end_of(self.section)))
        s = np.clip(np.linspace(self.begin, self.end, count), low, high)
        return self.road.centre(self.section, self.lane, s)


def place(net: Element, file: RoadFile) -> list[str]:
    """Moves the lanes of a network to their places in the file; returns notes on limits that are not the file's."""
    return _Placement(net, file).placed()


class _Placement:
    """The work on one network."""

    def __init__(self, net: Element, file: RoadFile) -> None:
        self.file = file
        self.lanes = {lane.get("id", ""): lane for edge in net.iter("edge") for lane in edge.iter("lane")}
        self.inner = {lane.get("id", "") for edge in net.iter("edge") if edge.get("function") for lane in edge.iter("lane")}
        self.connections = list(net.iter("connection"))
        self.onward: dict[str, str | None] = {}
        """The lane inside of a junction that follows another one."""
        for connection in self.connections:
            self.onward.setdefault(f"{connection.get('from')}_{connection.get('fromLane')}", connection.get("via"))
        self.pieces: dict[str, Piece] = {}
        self.default: dict[str, set[str]] = {}
        self.changing: set[str] = set()

    def placed(self) -> list[str]:
        """Moves all lanes."""
        for name, lane in self.lanes.items():
            piece = None if name in self.inner else self._piece(lane)
            if piece is not None:
                self.pieces[name] = piece
                self._write(lane, *piece.points())
                self._limit(lane, piece)
                if piece.road.sections[piece.section].lanes[piece.lane].kind not in DRIVEN:
                    _close(lane)
        for connection in self.connections:
            if not connection.get("from", "").startswith(":"):
                self._connect(connection)
        notes = [
            f"road {', '.join(sorted(roads))}: no speed limit; the network has {float(speed) * 3.6:.0f} km/h, netconvert's default"
            for speed, roads in sorted(self.default.items())
        ]
        notes += [
            f"road {road}: the limit changes along a lane; the network has the first one" for road in sorted(self.changing)
        ]
        return notes

    def _piece(self, lane: Element) -> Piece | None:
        """Returns the part of the file that a lane was made from."""
        road, index = _origin(lane, self.file)
        if road is None:
            return None
        shape = _shape(lane)
        begin, end = (float(s) for s in _stations(road, shape[[0, -1]]))
        section = road.section_at(0.5 * (begin + end))
        return Piece(road, section, index, begin, end) if index in road.sections[section].lanes else None

    def _limit(self, lane: Element, piece: Piece) -> None:
        """Writes the file's limit."""
        inside = np.linspace(piece.begin, piece.end, 7)[1:-1]
        limits = [piece.road.limit(piece.section, piece.lane, float(s)) for s in inside]
        if limits[0] is None:
            self.default.setdefault(lane.get("speed", "0"), set()).add(piece.road.id)
        else:
            lane.set("speed", f"{limits[0]:.{DECIMALS}f}")
        if len(set(limits)) > 1:
            self.changing.add(piece.road.id)

    def _connect(self, connection: Element) -> None:
        """Moves the lanes inside of a junction that a connection takes."""
        names = [f"{connection.get(edge)}_{connection.get(lane)}" for edge, lane in (("from", "fromLane"), ("to", "toLane"))]
        before, after = (self.pieces.get(name) for name in names)
        inner = list(self._inside(connection))
        if before is None or after is None or not inner:
            return
        origins = [_origin(lane, self.file) for lane in inner]
        road, index = next((origin for origin in origins if origin[0] is not None), (None, 0))
        pieces = list(_between(before, after, road, index))
        if not pieces:
            return
        parts = [piece.points() for piece in pieces]
        points, widths = np.vstack([part[0] for part in parts]), np.concatenate([part[1] for part in parts])
        total = lengths(points)
        borders = np.concatenate([[0.0], np.cumsum([float(lane.get("length", "1")) for lane in inner])])
        borders *= total[-1] / borders[-1]
        speed = self.lanes[names[0]].get("speed", "")
        own = None if road is None else road.limit(road.section_at(0.5 * road.length), index, 0.5 * road.length)
        for lane, (first, last) in zip(inner, pairwise(borders), strict=True):
            s = np.concatenate([[first], total[(total > first) & (total < last)], [last]])
            at = [np.interp(s, total, column) for column in (points[:, 0], points[:, 1], widths)]
            self._write(lane, np.column_stack(at[:2]), at[2])
            lane.set("speed", speed if own is None else f"{own:.{DECIMALS}f}")
            lane.set("length", f"{max(0.1, last - first):.{DECIMALS}f}")

    def _inside(self, connection: Element) -> Iterator[Element]:
        via = connection.get("via")
        for _ in range(10):
            if via is None or via not in self.lanes:
                return
            yield self.lanes[via]
            via = self.onward.get(via)

    def _write(self, lane: Element, points: Floats, widths: Floats) -> None:
        """Writes points and widths of a lane."""
        kept = _simplified(np.column_stack([points, widths]))
        shape = kept[:, :2] if len(kept) > 1 else np.vstack([kept[:, :2]] * 2)
        lane.set("shape", " ".join(f"{x:.{DECIMALS}f},{y:.{DECIMALS}f}" for x, y in shape))
        lane.set("width", f"{max(0.1, float(np.mean(widths))):.{DECIMALS}f}")
        if np.ptp(widths) > DETAIL:
            along = lengths(shape) / max(lengths(shape)[-1], 1e-9)
            text = " ".join(f"{share:.6f},{width:.{DECIMALS}f}" for share, width in zip(along, kept[:, 2], strict=True))
            SubElement(lane, "param", key=WIDTHS, value=text)


def _origin(lane: Element, file: RoadFile) -> tuple[FileRoad | None, int]:
    """Returns the road and the lane of the file that a lane was made from."""
    value = next((param.get("value", "") for param in lane.iter("param") if param.get("key") == ORIGIN), "")
    road, _, index = value.rpartition("_")
    is_number = index.removeprefix("-").isdigit()
    return (file.roads.get(road), int(index)) if is_number else (None, 0)


def _shape(lane: Element) -> Floats:
    return np.array([point.split(",")[:2] for point in lane.get("shape", "").split()], np.float64)


def _stations(road: FileRoad, points: Floats) -> Floats:
    """Returns the stations of a road beside points (n, 2)."""
    s = np.linspace(0.0, road.length, max(2, ceil(road.length / STEP) + 1))
    x, y, _ = road.reference(s)
    best = np.array([s[int(np.argmin(np.hypot(x - point[0], y - point[1])))] for point in points])
    for _ in range(5):
        x, y, heading = road.reference(best)
        ahead = (points[:, 0] - x) * np.cos(heading) + (points[:, 1] - y) * np.sin(heading)
        best = np.clip(best + np.clip(ahead, -STEP, STEP), 0.0, road.length)
    return best


def _between(before: Piece, after: Piece, road: FileRoad | None, index: int) -> Iterator[Piece]:
    """Yields the parts of the file between two lanes: the rest of the first, the connecting road, the begin of the second."""
    if before.road is after.road and road is None:
        if before.section == after.section:
            yield Piece(before.road, before.section, before.lane, before.end, after.begin)
        else:
            first = before.road.end_of(before.section) if before.lane < 0 else before.road.sections[before.section].begin
            last = after.road.sections[after.section].begin if after.lane < 0 else after.road.end_of(after.section)
            yield Piece(before.road, before.section, before.lane, before.end, first)
            yield Piece(after.road, after.section, after.lane, last, after.begin)
        return
    yield Piece(before.road, before.section, before.lane, before.end, before.road.length if before.lane < 0 else 0.0)
    if road is not None:
        yield from _whole(road, index)
    yield Piece(after.road, after.section, after.lane, 0.0 if after.lane < 0 else after.road.length, after.begin)


def _whole(road: FileRoad, index: int) -> Iterator[Piece]:
    """Yields the parts of a connecting road, along the lane that netconvert names, through all of its sections."""
    order = range(len(road.sections)) if index < 0 else reversed(range(len(road.sections)))
    for section in order:
        if index not in road.sections[section].lanes:
            return
        ends = (road.sections[section].begin, road.end_of(section))
        yield Piece(road, section, index, *(ends if index < 0 else ends[::-1]))
        lane = road.sections[section].lanes[index]
        index = (lane.successor if index < 0 else lane.predecessor) or index


def _close(lane: Element) -> None:
    lane.attrib.pop("disallow", None)
    lane.set("allow", CLOSED)


def _simplified(points: Floats) -> Floats:
    """Leaves out points (n, 3) that lie on the straight between others, within `DETAIL` (Douglas and Peucker 1973)."""
    keep = np.zeros(len(points), np.bool_)
    keep[[0, -1]] = True
    waiting = [(0, len(points) - 1)]
    while waiting:
        first, last = waiting.pop()
        if last - first < 2:
            continue
        chord = points[last] - points[first]
        share = np.linspace(0.0, 1.0, last - first + 1)[1:-1, None]
        inner = points[first + 1 : last] - points[first]
        square = float(chord @ chord)
        share = np.clip(inner @ chord / square, 0.0, 1.0)[:, None] if square > 0 else share
        off = np.sqrt(np.sum((inner - share * chord) ** 2, axis=1))
        worst = int(np.argmax(off))
        if off[worst] > DETAIL:
            middle = first + 1 + worst
            keep[middle] = True
            waiting += [(first, middle), (middle, last)]
    return points[keep]
