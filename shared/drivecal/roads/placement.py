"""Lanes of a converted network at the places that the OpenDRIVE file gives them.

netconvert gives a lane one width and an edge one shape. Here each lane's points, widths and limit are computed from the file: between
the two stations of its road that netconvert chose as its ends. Lanes inside of junctions follow the connecting road, with the rest of
the lane before and the begin of the lane after.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise, product
from math import ceil, inf
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from drivecal.domain.roads import Floats
from drivecal.roads.documents import JoinedNotes
from drivecal.roads.lines import lengths
from drivecal.roads.network import LIMITS, ORIGIN, UNKNOWN, UNPLACED, WIDTHS
from drivecal.roads.opendrive import DRIVEN, SHORTEST, FileRoad, RoadFile

STEP = 1.0
DETAIL = 0.01
"""Metres that points may be left out for."""
CLOSED = "emergency authority"
"""SUMO's classes that may drive where cars may not."""
DECIMALS = 4
NO_LIMIT_SPEED = 70.0
"""Limit (m/s) of lanes on which any speed is allowed: above what cars reach, so that nothing exceeds it."""
LARGEST_GAP = 5.0
"""Metres between two parts of a way through a junction."""
OUTSIDE = "-1"
"""The junction of a road that lies in none."""
Limits = list[tuple[float, float | None]]
"""Metres along a lane from which on each limit (m/s) holds: infinite if any speed is allowed, None if the file does not say."""


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
        return self.road.centre(self.section, self.lane, self._stations())

    def limits(self, points: Floats) -> Limits:
        """Returns where along its `points` (m) each limit begins to hold, and the limit."""
        s, along = self._stations(), lengths(points)
        forwards = self.end >= self.begin
        changes = self.road.limits_between(self.section, self.lane, self.begin, self.end)
        return [
            (float(np.interp(at if forwards else -at, s if forwards else -s, along)) if number else 0.0, limit)
            for number, (at, limit) in enumerate(changes)
        ]

    def _stations(self) -> Floats:
        count = max(1, ceil(abs(self.end - self.begin) / STEP)) + 1
        low, high = sorted((self.road.sections[self.section].begin, self.road.end_of(self.section)))
        return np.clip(np.linspace(self.begin, self.end, count), low, high)


def place(net: Element, file: RoadFile) -> JoinedNotes:
    """Moves the lanes of a network to their places in the file; returns notes on limits that the file does not give, or that change, and
    on lanes that have no place in it.
    """
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
        self.last: dict[str, float | None] = {}
        """The limit at the end of each lane."""
        self.sampled: dict[str, tuple[Floats, Floats]] = {}
        """Stations of each road, and where they are (n, 2)."""
        self.notes = JoinedNotes()

    def placed(self) -> JoinedNotes:
        """Moves all lanes."""
        for name, lane in self.lanes.items():
            if name in self.inner:
                continue
            piece = self._piece(lane)
            if piece is None:
                self._leave(lane, f"edge {name.rpartition('_')[0]}, lane {lane.get('index')}", "the file has no such lane")
                continue
            self.pieces[name] = piece
            points, widths = piece.points()
            self._write(lane, points, widths)
            limits = piece.limits(points)
            self.last[name] = limits[-1][1]
            is_driven = piece.road.sections[piece.section].lanes[piece.lane].kind in DRIVEN
            self._limit(lane, limits, float(lengths(points)[-1]), f"road {piece.road.id}" if is_driven else None)
            if not is_driven:
                lane.attrib.pop("disallow", None)
                lane.set("allow", CLOSED)
        for connection in self.connections:
            if not connection.get("from", "").startswith(":"):
                self._connect(connection)
        return self.notes

    def _piece(self, lane: Element) -> Piece | None:
        """Returns the part of the file that a lane was made from."""
        road, index = _origin(lane, self.file)
        if road is None:
            return None
        shape = np.array([point.split(",")[:2] for point in lane.get("shape", "").split()], np.float64)
        along = float(lengths(shape)[-1]) * (1.0 if index < 0 else -1.0)
        ends = product(*(self._stations(road, point) for point in shape[[0, -1]]))
        begin, end = min(ends, key=lambda pair: abs(pair[1] - pair[0] - along))
        section = road.section_at(0.5 * (begin + end))
        return Piece(road, section, index, begin, end) if index in road.sections[section].lanes else None

    def _stations(self, road: FileRoad, point: Floats) -> list[float]:
        """Returns the station of a road nearest to a point (2,): both ends of the road where it closes."""
        if road.id not in self.sampled:
            s = np.linspace(0.0, road.length, max(2, ceil(road.length / STEP) + 1))
            self.sampled[road.id] = s, np.column_stack(road.reference(s)[:2])
        s, places = self.sampled[road.id]
        row = int(np.argmin(np.hypot(*(places - point).T)))
        closes = np.hypot(*(places[0] - places[-1])) < STEP and min(row, len(s) - 1 - row) < 2
        best = s[[0, -1] if closes else [row]]
        for _ in range(5):
            x, y, heading = road.reference(best)
            ahead = (point[0] - x) * np.cos(heading) + (point[1] - y) * np.sin(heading)
            best = np.clip(best + np.clip(ahead, -STEP, STEP), 0.0, road.length)
        return [float(each) for each in best]

    def _leave(self, lane: Element, place: str, cause: str) -> None:
        """Marks a lane that stays where netconvert has put it, so that no route may use it."""
        named = _named(lane) or "no road"
        SubElement(lane, "param", key=UNPLACED, value=f"{cause} (netconvert names {named})")
        self.notes.add(f"{place}, from {named}", "not at its place in the file; a route over it is refused")

    def _limit(self, lane: Element, limits: Limits, length: float, place: str | None) -> None:
        """Writes the file's limits. Notes on them name the `place`."""
        known = [(at, NO_LIMIT_SPEED if limit == inf else limit) for at, limit in limits]
        speed = float(lane.get("speed", "0"))
        if place is not None:
            if any(limit == inf for _, limit in limits):
                self.notes.add(place, f"'no limit'; the network has {NO_LIMIT_SPEED:g} m/s")
            if any(limit is None for _, limit in limits):
                self.notes.add(
                    place,
                    "no speed limit; give `default_limit` if the route leads over it, without which SUMO's cars there have "
                    f"{speed * 3.6:.0f} km/h, netconvert's default",
                )
            if len(known) > 1:
                self.notes.add(
                    place, "the limit changes along a lane; SUMO's cars keep the first one there, the ego has each at its place"
                )
        if known[0][1] is not None:
            lane.set("speed", f"{known[0][1]:.{DECIMALS}f}")
        if len(known) > 1 or known[0][1] is None:
            pairs = [(at / max(length, 1e-9), UNKNOWN if limit is None else f"{limit:.{DECIMALS}f}") for at, limit in known]
            SubElement(lane, "param", key=LIMITS, value=" ".join(f"{min(share, 1.0):.6f},{limit}" for share, limit in pairs))

    def _connect(self, connection: Element) -> None:
        """Moves the lanes inside of a junction that a connection takes."""
        names = [f"{connection.get(edge)}_{connection.get(lane)}" for edge, lane in (("from", "fromLane"), ("to", "toLane"))]
        before, after = (self.pieces.get(name) for name in names)
        inner = list(self._inside(connection))
        if not inner:  # nothing to move
            return
        origins = [_origin(lane, self.file) for lane in inner]
        road, index = next((origin for origin in origins if origin[0] is not None), (None, 0))
        pieces = [] if before is None or after is None else list(_between(before, after, road, index))
        parts = [piece.points() for piece in pieces]
        if not _is_joined([part[0] for part in parts]):
            for lane in inner:
                self._leave(lane, f"junction between {names[0]} and {names[1]}", "the file has no lane between them")
            return
        points, widths = np.vstack([part[0] for part in parts]), np.concatenate([part[1] for part in parts])
        total = lengths(points)
        borders = np.concatenate([[0.0], np.cumsum([float(lane.get("length", "1")) for lane in inner])])
        borders *= total[-1] / borders[-1]
        limits = _limits_of(pieces, [part[0] for part in parts], total, self.last[names[0]])
        for lane, (first, last) in zip(inner, pairwise(borders), strict=True):
            s = np.concatenate([[first], total[(total > first) & (total < last)], [last]])
            at = [np.interp(s, total, column) for column in (points[:, 0], points[:, 1], widths)]
            self._write(lane, np.column_stack(at[:2]), at[2])
            self._limit(lane, _part(limits, float(first), float(last)), float(last - first), None)
            lane.set("length", f"{max(0.1, last - first):.{DECIMALS}f}")

    def _inside(self, connection: Element) -> Iterator[Element]:
        via = connection.get("via")
        for _ in range(10):
            if via is None or via not in self.lanes:
                return
            yield self.lanes[via]
            via = self.onward.get(via)

    def _write(self, lane: Element, points: Floats, widths: Floats) -> None:
        widths = np.maximum(widths, 0.0)
        kept = _simplified(np.column_stack([points, widths]))
        shape = kept[:, :2] if len(kept) > 1 else np.vstack([kept[:, :2]] * 2)
        lane.set("shape", " ".join(f"{x:.{DECIMALS}f},{y:.{DECIMALS}f}" for x, y in shape))
        lane.set("width", f"{max(0.1, float(np.mean(widths))):.{DECIMALS}f}")
        if np.ptp(widths) > DETAIL:
            along = lengths(shape) / max(lengths(shape)[-1], 1e-9)
            text = " ".join(f"{share:.6f},{width:.{DECIMALS}f}" for share, width in zip(along, kept[:, 2], strict=True))
            SubElement(lane, "param", key=WIDTHS, value=text)


def _named(lane: Element) -> str:
    return next((param.get("value", "") for param in lane.iter("param") if param.get("key") == ORIGIN), "")


def _origin(lane: Element, file: RoadFile) -> tuple[FileRoad | None, int]:
    """Returns the road and the lane of the file that a lane was made from."""
    road, _, index = _named(lane).rpartition("_")
    is_number = index.removeprefix("-").isdigit()
    return (file.roads.get(road), int(index)) if is_number else (None, 0)


def _between(before: Piece, after: Piece, road: FileRoad | None, index: int) -> Iterator[Piece]:
    """Yields the parts of the file between two lanes: the rest of the first, the connecting road, the begin of the second."""
    if before.road is after.road and road is None:
        ahead = after.begin - before.end if before.lane < 0 else before.end - after.begin
        if before.section == after.section and ahead > -STEP:  # else the road is closed, and its end lies between
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


def _is_joined(parts: list[Floats]) -> bool:
    """Returns whether there are parts, and each begins near the end of the one before, so that no lane of the file is missing between."""
    return bool(parts) and all(float(np.hypot(*(after[0] - before[-1]))) <= LARGEST_GAP for before, after in pairwise(parts))


def _limits_of(pieces: list[Piece], parts: list[Floats], total: Floats, before: float | None) -> Limits:
    """Returns the limits along the parts of a way through a junction. A connecting road without limits has that of the lane before."""
    result: Limits = []
    row, last = 0, before
    for piece, points in zip(pieces, parts, strict=True):
        for at, limit in piece.limits(points):
            kept = last if limit is None and piece.road.junction != OUTSIDE else limit
            if not result or result[-1][1] != kept:
                result.append((float(total[row]) + at if result else 0.0, kept))
            last = kept
        row += len(points)
    return result


def _part(limits: Limits, first: float, last: float) -> Limits:
    """Returns the limits between two places (m) along the way, from the first of them."""
    here = [limit for at, limit in limits if at <= first + SHORTEST][-1]
    return [(0.0, here), *((at - first, limit) for at, limit in limits if first + SHORTEST < at < last - SHORTEST)]


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
