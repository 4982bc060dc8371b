"""Places of OpenSCENARIO files on SUMO's lanes: by road and lane of the OpenDRIVE file, by coordinates, or from another place."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import cos, isfinite, pi, sin
from typing import NamedTuple

import numpy as np

from drivecal.bundles.traffic.elements import Element
from drivecal.contracts.strict_json import shown
from drivecal.domain.roads import Floats
from drivecal.roads.lines import lengths
from drivecal.roads.network import Connection, Lane, Network
from drivecal.roads.opendrive import DRIVEN, FileRoad, RoadFile

LONGEST = 2_000
"""Edges of a way."""


def along(network: Network, begin: str, length: float) -> list[str]:
    """Returns the edges from `begin` on that go on as the road does, for at least `length` metres or to its end.

    At a fork the road goes on where most lanes do, then straight, and then in the order of the network.
    """
    way, seen, metres = [begin], {begin}, 0.0
    while metres < length and len(way) < LONGEST:
        metres += network.edges[way[-1]].lanes[0].length
        ahead: dict[str, list[Connection]] = {}
        for link in links(network, way[-1]):
            ahead.setdefault(link.end, []).append(link)
        if not ahead:
            break
        following = max(ahead, key=lambda edge: (len(ahead[edge]), any(link.direction == "s" for link in ahead[edge])))
        if following in seen:
            break
        way.append(following)
        seen.add(following)
    return way


def links(network: Network, edge: str) -> Iterator[Connection]:
    """Yields the connections for cars from an edge to roads."""
    for link in network.connections.get(edge, ()):
        if link.for_cars and link.end in network.edges and network.edges[link.end].function == "":
            yield link


FARTHEST = 2.0
"""Largest distance (m) of a place of the file from a lane of the network. A place that is farther away lies in a junction."""
BESIDE = 50.0
"""Largest distance (m) between the carriageways of a motorway."""
ALIGNED, PARALLEL = cos(pi / 4.0), sin(pi / 6.0)
"""Cosine of the largest angle to a heading, and sine of the largest angle to another road."""
DECIMALS, ROUNDING = 6, 1e-6


@dataclass(frozen=True, slots=True)
class FilePlace:
    """A place on a lane of the network: `position` along it (m, as SUMO counts), `offset` to the left of its centre (m).

    `road`, `lane`, `s` and `t` are its coordinates in the OpenDRIVE file, if the scenario gives them.
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
        """True if the coordinates are on the lane."""
        return self.beyond <= ROUNDING and abs(self.left) <= 0.5 * self.lane.width

    @property
    def beyond(self) -> float:
        """Distance (m) of the coordinates before the lane's begin or behind its end; 0 between them."""
        return max(self.off - abs(self.left), 0.0)


def nearest(lanes: Iterable[Lane], x: float, y: float, element: Element) -> FilePlace:
    """Returns the place on these lanes that is closest to coordinates. Raises InvalidInputError if no lane is near them."""
    return _closest(list(_candidates(lanes, x, y, None, element)), x, y, None, element)


class Ground:
    """The roads of a network by coordinates."""

    def __init__(self, network: Network) -> None:
        self._network = network
        self._lanes = [lane for edge in network.edges.values() if edge.function == "" for lane in edge.lanes]
        self._within: dict[tuple[str, ...], frozenset[str]] = {}

    def place(self, x: float, y: float, heading: float | None, route: Sequence[str], element: Element) -> FilePlace:
        """Returns the place at coordinates, on a lane that belongs to a drive along `route`; without a route, on any lane.

        Lanes of the route belong to the drive, lanes on the way to it or from it, and parallel lanes nearby. If several roads without a
        common junction hold the coordinates, the vehicle's `heading` (rad, None if unknown) decides between them, then the route. Raises
        InvalidInputError if no lane is near, or several roads remain."""
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

    def is_beside(self, x: float, y: float) -> bool:
        """Returns whether coordinates are on no lane, and one is within `BESIDE`."""
        near = [candidate for candidate in _projections(self._around(x, y, BESIDE), x, y) if candidate.off <= BESIDE]
        return bool(near) and not any(candidate.holds for candidate in near)

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
        """Returns the junctions of each road of the candidates. Edges with a common junction belong to the same road and level."""
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
        """Returns whether a lane is within reach of a route, or runs parallel to such a lane nearby."""
        within = self._reach(route)
        return candidate.place.edge in within or any(
            abs(sin(other.direction - candidate.direction)) <= PARALLEL
            for other in _projections(self._around(x, y, BESIDE), x, y)
            if other.off <= BESIDE and other.place.edge in within
        )

    def _reach(self, route: Sequence[str]) -> frozenset[str]:
        """Returns all edges that lead to a route or that it leads to, with their opposite directions."""
        key = tuple(route)
        if key not in self._within:
            there = _reached(route, lambda edge: (link.end for link in links(self._network, edge)))
            back = _reached(route, lambda edge: self._before.get(edge, ()))
            self._within[key] = self._directions(there | back)
        return self._within[key]

    def _directions(self, edges: Collection[str]) -> frozenset[str]:
        """Returns edges and their opposite directions."""
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
    """Yields the lanes within `FARTHEST` metres of coordinates, unless the heading points against the lane."""
    if not (isfinite(x) and isfinite(y)):
        raise element.fault("the place is not finite", "correct it")
    for candidate in _projections(lanes, x, y):
        turned = heading is not None and cos(heading - candidate.direction) < 0.0
        if not turned and candidate.beyond <= FARTHEST and abs(candidate.left) <= 0.5 * candidate.lane.width + FARTHEST:
            yield candidate


def _projections(lanes: Iterable[Lane], x: float, y: float) -> Iterator[_Candidate]:
    for lane in lanes:
        along, left, off, direction = projected(lane.shape, x, y)
        position = min(along * lane.length, lane.length)
        place = FilePlace(lane.edge, lane.index, round(position, DECIMALS), round(left, DECIMALS))
        yield _Candidate(off, left, lane, place, direction)


def projected(shape: Floats, x: float, y: float) -> tuple[float, float, float, float]:
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


MOST_LANES = 1_000
"""Lanes in a row over which a relative place may lie."""
LARGEST = 1e6
MOST_ASIDE = 50.0
"""Largest distance (m) to a lane's centre."""


class Map:
    """A network with the OpenDRIVE file that it was made of, if there is one."""

    def __init__(
        self, network: Network, source: Callable[[], RoadFile] | None, check_time: Callable[[], None] = lambda: None
    ) -> None:
        """`source`: reads the OpenDRIVE file. `check_time`: raises InvalidInputError if all places take too long."""
        self.network, self._source, self.check_time = network, source, check_time
        roads = [lane for edge in network.edges.values() if edge.function == "" for lane in edge.lanes]
        self.ground = Ground(network)
        self._by_origin: dict[str, list[Lane]] = {}
        for lane in roads:
            for origin in (lane.origin or "").split():
                self._by_origin.setdefault(origin, []).append(lane)

    @cached_property
    def file(self) -> RoadFile | None:
        """The OpenDRIVE file, None if the network was not made of one. Raises InvalidInputError."""
        return None if self._source is None else self._source()

    def place(self, position: Element, places: Mapping[str, FilePlace], route: Sequence[str]) -> FilePlace:
        """Returns the place of a <Position>. Raises InvalidInputError.

        `places` holds the known places of entities. `route` holds the edges of the drive, and is empty while they are unknown."""
        self.check_time()
        kind = position.only("LanePosition", "WorldPosition", "RoadPosition", "RelativeLanePosition", "RelativeRoadPosition")
        if kind.element == "WorldPosition":
            return self.ground.place(*self.coordinates(kind), route, kind)
        if kind.element == "LanePosition":
            road = self._road(kind)
            lane, s = kind.integer("laneId", -64, 64), kind.number("s", 0.0, LARGEST)
            return self._on_lane(road, lane, s, kind.number("offset", -MOST_ASIDE, MOST_ASIDE, 0.0), kind)
        if kind.element == "RoadPosition":
            return self._on_road(self._road(kind), kind.number("s", 0.0, LARGEST), kind.number("t", -100.0, 100.0), kind)
        other = kind.text("entityRef")
        if other not in places:
            raise kind.fault(f"the place of {shown(other)} is not known", "give it one by a road, a lane or coordinates")
        key = "dsLane" if kind.element == "RelativeLanePosition" and "dsLane" in kind.values else "ds"
        there, ds = places[other], kind.number(key, -LARGEST, LARGEST)
        if key == "dsLane":
            own = self.network.edges[there.edge].lanes[there.index]
            there, ds = replace(there, road=None), ds * own.length / float(lengths(own.shape)[-1])
        if kind.element == "RelativeRoadPosition":
            if there.road is None:
                raise kind.fault(f"{shown(other)} is not placed by a road of the file", "give a LanePosition")
            return self._on_road(self._road(kind, there.road), there.s + ds, there.t + kind.number("dt", -100.0, 100.0), kind)
        offset = kind.number("offset", -MOST_ASIDE, MOST_ASIDE, 0.0)
        return self._beside(there, kind.integer("dLane", -30, 30), ds, offset, kind)

    def coordinates(self, kind: Element) -> tuple[float, float, float | None]:
        """Returns x, y (m, of the network) and the heading (rad), if it has one, of a <WorldPosition>. Raises InvalidInputError."""
        x, y = (kind.number(key, -1e8, 1e8) for key in ("x", "y"))
        heading = kind.number("h", -10.0, 10.0) if "h" in kind.values else None
        moved = (0.0, 0.0) if self._source is not None else self.network.offset
        return x + moved[0], y + moved[1], heading

    def lane_index(self, edge: str, road_lane: int) -> int | None:
        """Returns the index of the lane of an edge that was made of a lane of its road, None if there is none."""
        for lane in self.network.edges[edge].lanes:
            if any(origin.rpartition("_")[2] == str(road_lane) for origin in (lane.origin or "").split()):
                return lane.index
        return None

    def lane_numbers(self, edges: Sequence[str]) -> list[str]:
        """Returns the numbers of the lanes in the file that became these edges."""
        lanes = (lane for edge in edges if self._source is not None for lane in self.network.edges[edge].lanes)
        return sorted({origin.rpartition("_")[2] for lane in lanes for origin in (lane.origin or "").split()}, key=int)

    def moved(self, place: FilePlace, metres: float, element: Element) -> FilePlace:
        """Returns the place that is `metres` farther along the lanes. Raises InvalidInputError if the lanes end before."""
        lane, position = self.network.edges[place.edge].lanes[place.index], place.position + metres
        for _ in range(MOST_LANES):
            if 0.0 <= position <= lane.length:
                return replace(place, edge=lane.edge, index=lane.index, position=round(position, DECIMALS), road=None)
            following = self._following(lane, ahead=position > 0.0)
            if following is None:
                break
            other, inside = following
            position = (
                max(position - lane.length - inside, 0.0) if position > 0.0 else other.length + min(position + inside, 0.0)
            )
            lane = other
        raise element.fault("the lane ends before that place", "give a place on the lane")

    def _following(self, lane: Lane, *, ahead: bool) -> tuple[Lane, float] | None:
        """Returns the lane after a lane or before it, and the metres inside of the junction between them."""
        network = self.network
        for source in (lane.edge,) if ahead else network.connections:
            for link in links(network, source) if source in network.edges else ():
                ends = ((source, link.from_lane), (link.end, link.to_lane))
                mine, (edge, index) = ends if ahead else ends[::-1]
                if mine == (lane.edge, lane.index) and not edge.startswith(":") and index < len(network.edges[edge].lanes):
                    between = network.lane(link.via) if link.via is not None else None
                    return network.edges[edge].lanes[index], between.length if between is not None else 0.0
        return None

    def _road(self, element: Element, name: str | None = None) -> FileRoad:
        if self.file is None:
            raise element.fault("the network is not an OpenDRIVE file, so that roads are not known", "give a WorldPosition")
        name = element.text("roadId") if name is None else name
        if name not in self.file.roads:
            roads = ", ".join(shown(road, 30) for road in list(self.file.roads)[:10])
            raise element.fault(f"{self.file.name} has no road {shown(name)}", f"give one of {roads}")
        return self.file.roads[name]

    def _on_lane(self, road: FileRoad, lane: int, s: float, offset: float, element: Element) -> FilePlace:
        """Returns the place at an offset from a lane's centre."""
        s = _within(road, s, element)
        section = road.section_at(s)
        lanes = road.sections[section].lanes
        if lane == 0 or lane not in lanes:
            known = ", ".join(str(index) for index in sorted(lanes) if index != 0)
            raise element.fault(f"road {shown(road.id)} has no lane {lane} at s = {s:g} m", f"give one of {known}")
        (centre_x, centre_y), *_ = road.centre(section, lane, np.array([s]))[0].tolist()
        x, y, heading = (float(column[0]) for column in road.reference(np.array([s])))
        t = (centre_y - y) * cos(heading) - (centre_x - x) * sin(heading)
        near = list(_candidates(self._by_origin.get(f"{road.id}_{lane}", ()), centre_x, centre_y, None, element))
        if not near and (kind := lanes[lane].kind) not in DRIVEN:
            message = f"lane {lane} of road {shown(road.id)} is of type {shown(kind)} at s = {s:g} m, and not driven on"
            raise element.fault(message, "give another lane")
        there = _closest(near, centre_x, centre_y, None, element)
        left = 1.0 if lane < 0 else -1.0
        return replace(there, offset=round(offset * left, DECIMALS), road=road.id, lane=lane, s=s, t=t + offset)

    def _on_road(self, road: FileRoad, s: float, t: float, element: Element) -> FilePlace:
        """Returns the place at a distance to the left of a road's reference line."""
        s = _within(road, s, element)
        x, y, heading = (float(column[0]) for column in road.reference(np.array([s])))
        lanes = [lane for name, lanes in self._by_origin.items() if name.rpartition("_")[0] == road.id for lane in lanes]
        there = nearest(lanes, x - t * sin(heading), y + t * cos(heading), element)
        origin = (self.network.edges[there.edge].lanes[there.index].origin or "").split()
        lane = next((int(name.rpartition("_")[2]) for name in origin if name.rpartition("_")[0] == road.id), 0)
        return replace(there, road=road.id, lane=lane, s=s, t=t)

    def _beside(self, there: FilePlace, lanes: int, ds: float, offset: float, element: Element) -> FilePlace:
        """Returns the place `ds` metres ahead of another, on the lane whose number is larger by `lanes`."""
        road = None if there.road is None or self.file is None else self.file.roads[there.road]
        ahead = -1.0 if (there.lane or self.road_lane(there)) > 0 else 1.0
        if road is not None and 0.0 <= there.s + ahead * ds <= road.length:
            lane = there.lane + lanes
            if lanes and (lane == 0 or (lane > 0) != (there.lane > 0)):
                lane += 1 if lanes > 0 else -1  # lane 0 is the middle of the road
            if lane in road.sections[road.section_at(there.s + ahead * ds)].lanes:
                return self._on_lane(road, lane, there.s + ahead * ds, offset, element)
        reached = self.moved(there, ds, element)
        index = reached.index + (lanes if ahead > 0.0 else -lanes)
        if not 0 <= index < len(self.network.edges[reached.edge].lanes):
            raise element.fault(f"there is no lane {lanes:+d} beside that of the other vehicle", "give another dLane")
        return replace(reached, index=index, offset=round(ahead * offset, DECIMALS))

    def road_lane(self, place: FilePlace) -> int:
        """Returns the number of the lane of the file on which a place is, 0 if the network was not made of one."""
        origins = (self.network.edges[place.edge].lanes[place.index].origin or "").split() if self._source is not None else []
        return int(origins[0].rpartition("_")[2]) if origins else 0


def _within(road: FileRoad, s: float, element: Element) -> float:
    """Returns an s of a road, which rounding may have moved beyond its end. Raises InvalidInputError."""
    if not 0.0 <= s <= road.length + ROUNDING:
        message = f"road {shown(road.id)} is {road.length:.2f} m long, and has no s = {s:g} m"
        raise element.fault(message, f"give 0 to {road.length:.2f}")
    return min(s, road.length)
