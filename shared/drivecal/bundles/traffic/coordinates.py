"""Places on SUMO's lanes by coordinates; several roads may lie above each other."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import cos, isfinite, pi, sin
from typing import NamedTuple

import numpy as np

from drivecal.bundles.traffic.elements import Element
from drivecal.bundles.traffic.routes import links
from drivecal.contracts.strict_json import shown
from drivecal.domain.roads import Floats
from drivecal.roads.lines import lengths
from drivecal.roads.network import Lane, Network

FARTHEST = 2.0
"""Metres between a place of the file and the lane of the network: more, and the place lies in a junction."""
BESIDE = 50.0
"""Metres between the carriageways of a motorway, at most."""
ALIGNED, PARALLEL = cos(pi / 4.0), sin(pi / 6.0)
"""Cosine of the angle to a heading, and sine of that to another road, at most."""
DECIMALS, ROUNDING = 6, 1e-6


@dataclass(frozen=True, slots=True)
class FilePlace:
    """A place on a lane of the network: `position` along it (m, as SUMO counts), `offset` to the left of its centre (m).

    `road`, `lane`, `s`, `t`: in the OpenDRIVE file, if it was given so.
    """

    edge: str
    index: int
    position: float
    offset: float
    road: str | None = None
    lane: int = 0
    s: float = 0.0
    t: float = 0.0


class _Candidate(NamedTuple):
    """A lane near coordinates: their distance from its centre line and to its left (m), the place on it, its direction (rad) there."""

    off: float
    left: float
    lane: Lane
    place: FilePlace
    direction: float

    @property
    def holds(self) -> bool:
        """Whether the coordinates are on the lane."""
        return self.beyond <= ROUNDING and abs(self.left) <= 0.5 * self.lane.width

    @property
    def beyond(self) -> float:
        """Metres by which the coordinates lie before the begin of the lane, or behind its end."""
        return max(self.off - abs(self.left), 0.0)


def nearest(lanes: Iterable[Lane], x: float, y: float, element: Element) -> FilePlace:
    """Returns the place on one of these lanes that is closest to coordinates. Raises InvalidInputError if it lies on none of them."""
    return _closest(list(_candidates(lanes, x, y, None, element)), x, y, None, element)


class Ground:
    """The roads of a network by coordinates."""

    def __init__(self, network: Network) -> None:
        self._network = network
        self._lanes = [lane for edge in network.edges.values() if edge.function == "" for lane in edge.lanes]
        self._within: dict[tuple[str, ...], frozenset[str]] = {}

    def place(self, x: float, y: float, heading: float | None, route: Sequence[str], element: Element) -> FilePlace:
        """Returns the place at coordinates. Lanes count that belong to a drive along `route`: its own, those from which it is reached or
        which are reached from it, and those beside them; without a route, all. `heading`: of the vehicle (rad), if it is known.

        If several roads without a common junction hold the coordinates, that of the heading counts, then that of the route. Raises
        InvalidInputError if none does, or that decides nothing.
        """
        route = [edge for edge in route if edge in self._network.edges]  # others are refused with the route itself
        near = list(_candidates(self._around(x, y, FARTHEST), x, y, heading, element))
        drive = [candidate for candidate in near if not route or self._belongs(candidate, x, y, route)]
        if near and not drive:
            edges = ", ".join(dict.fromkeys(shown(candidate.place.edge, 60) for candidate in near))
            message = f"at x = {x:.2f}, y = {y:.2f} there is only {edges}, from which no way leads to the route, nor back"
            raise element.fault(message, "give a place on a road that belongs to the drive")
        above = [candidate for candidate in drive if candidate.holds]
        if len(self._roads(above)) > 1:
            drive = self._decided(above, heading, route, x, y, element)
        return _closest(drive, x, y, heading, element)

    def _decided(
        self, above: list[_Candidate], heading: float | None, route: Sequence[str], x: float, y: float, element: Element
    ) -> list[_Candidate]:
        """Returns the candidates of one of several roads above each other. Raises InvalidInputError if nothing decides."""
        aligned = [entry for entry in above if heading is not None and cos(heading - entry.direction) >= ALIGNED]
        of_route = [entry for entry in aligned or above if entry.place.edge in self._directions(route)]
        for candidates in (aligned, of_route):
            if len(self._roads(candidates)) == 1:
                return candidates
        edges = ", ".join(sorted({shown(candidate.place.edge, 60) for candidate in above}))
        message = f"at x = {x:.2f}, y = {y:.2f} several roads lie above each other: {edges}"
        raise element.fault(message, "give a heading `h`, a LanePosition, or `route` in the scenario")

    def _roads(self, candidates: Iterable[_Candidate]) -> list[set[str]]:
        """Returns the junctions of the roads of candidates: edges with a common junction are of one road, and of one level."""
        roads: list[set[str]] = []
        for candidate in candidates:
            edge = self._network.edges[candidate.place.edge]
            joined = {edge.begin, edge.end}
            for road in [road for road in roads if road & joined]:
                roads.remove(road)
                joined |= road
            roads.append(joined)
        return roads

    def _belongs(self, candidate: _Candidate, x: float, y: float, route: Sequence[str]) -> bool:
        """Returns whether a lane is within reach of a route, or beside one that is."""
        within = self._reach(route)
        return candidate.place.edge in within or any(
            abs(sin(other.direction - candidate.direction)) <= PARALLEL
            for other in _projections(self._around(x, y, BESIDE), x, y)
            if other.off <= BESIDE and other.place.edge in within
        )

    def _reach(self, route: Sequence[str]) -> frozenset[str]:
        """Returns the edges from which a route is reached, those that are reached from it, and the other directions of all."""
        key = tuple(route)
        if key not in self._within:
            there = _reached(route, lambda edge: (link.end for link in links(self._network, edge)))
            back = _reached(route, lambda edge: self._before.get(edge, ()))
            self._within[key] = self._directions(there | back)
        return self._within[key]

    def _directions(self, edges: Collection[str]) -> frozenset[str]:
        """Returns edges with those of the other direction."""
        known = self._network.edges
        turned = {(known[edge].end, known[edge].begin) for edge in edges}
        return frozenset(edges) | {
            lane.edge for lane in self._lanes if (known[lane.edge].begin, known[lane.edge].end) in turned
        }

    @cached_property
    def _before(self) -> Mapping[str, list[str]]:
        """Edges from which each edge is reached."""
        before: dict[str, list[str]] = {}
        for edge in self._network.connections:
            if edge in self._network.edges and self._network.edges[edge].function == "":
                for link in links(self._network, edge):
                    before.setdefault(link.end, []).append(edge)
        return before

    @cached_property
    def _boxes(self) -> tuple[Floats, Floats]:
        """Least and largest x and y of each lane."""
        reach = np.array([[0.5 * lane.width] for lane in self._lanes])
        lower, upper = (np.array([extreme(lane.shape, axis=0) for lane in self._lanes]) for extreme in (np.min, np.max))
        return lower - reach, upper + reach

    def _around(self, x: float, y: float, reach: float) -> list[Lane]:
        """Returns the lanes whose box is within reach of coordinates (m), and perhaps they themselves."""
        if not self._lanes:
            return []
        lower, upper = self._boxes
        here = np.array([x, y])
        rows = np.flatnonzero(((lower - reach <= here) & (here <= upper + reach)).all(axis=1))
        return [self._lanes[row] for row in rows.tolist()]


def _reached(begin: Iterable[str], following: Callable[[str], Iterable[str]]) -> set[str]:
    """Returns all edges that are reached step by step, with those at the begin."""
    done: set[str] = set()
    waiting = list(begin)
    while waiting:
        edge = waiting.pop()
        if edge not in done:
            done.add(edge)
            waiting += following(edge)
    return done


def _closest(candidates: list[_Candidate], x: float, y: float, heading: float | None, element: Element) -> FilePlace:
    """Returns the place of the candidate with the closest centre line, of equal ones the first. Raises InvalidInputError without any."""
    if not candidates:
        turned = f" in the direction {heading * 180.0 / pi:.0f}°" if heading is not None else ""
        message = f"there is no lane at x = {x:.2f}, y = {y:.2f}{turned}, but perhaps a junction"
        raise element.fault(message, "give a place on a lane")
    least = min(candidate.off for candidate in candidates)
    return next(candidate.place for candidate in candidates if candidate.off <= least + 1e-9)


def _candidates(lanes: Iterable[Lane], x: float, y: float, heading: float | None, element: Element) -> Iterator[_Candidate]:
    """Yields the lanes that coordinates are on, or at most `FARTHEST` beside, in whose direction the heading is."""
    if not (isfinite(x) and isfinite(y)):
        raise element.fault("the place is not finite", "correct it")
    for candidate in _projections(lanes, x, y):
        turned = heading is not None and cos(heading - candidate.direction) < 0.0
        if not turned and candidate.beyond <= FARTHEST and abs(candidate.left) <= 0.5 * candidate.lane.width + FARTHEST:
            yield candidate


def _projections(lanes: Iterable[Lane], x: float, y: float) -> Iterator[_Candidate]:
    for lane in lanes:
        along, left, off, direction = _projected(lane.shape, x, y)
        position = min(along * lane.length, lane.length)
        place = FilePlace(lane.edge, lane.index, round(position, DECIMALS), round(left, DECIMALS))
        yield _Candidate(off, left, lane, place, direction)


def _projected(shape: Floats, x: float, y: float) -> tuple[float, float, float, float]:
    """Returns the closest point of a polyline to coordinates: its share of the length, distance to its left, distance, direction there."""
    starts, steps = shape[:-1], np.diff(shape, axis=0)
    squares = np.maximum(np.einsum("ij,ij->i", steps, steps), 1e-12)
    rest = np.array([x, y]) - starts
    shares = np.clip(np.einsum("ij,ij->i", rest, steps) / squares, 0.0, 1.0)
    offs = rest - shares[:, None] * steps
    row = int(np.argmin(np.einsum("ij,ij->i", offs, offs)))
    s = lengths(shape)
    along = (s[row] + shares[row] * (s[row + 1] - s[row])) / max(float(s[-1]), 1e-9)
    size = max(float(np.hypot(*steps[row])), 1e-9)
    left = float(steps[row, 0] * rest[row, 1] - steps[row, 1] * rest[row, 0]) / size
    return float(along), left, float(np.hypot(*offs[row])), float(np.arctan2(steps[row, 1], steps[row, 0]))
