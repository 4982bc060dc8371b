"""Corridors: the lanes of a route along one smooth reference line, in the coordinates of the network, and roads on other levels.

The line follows the guide's lanes. Every lane of the route has its place as an offset from the line, measured from the points of the
file, so that tracks lie where the network has them even if the line does not follow a corner of a polyline.

Networks hold no reliable heights. Roads of one level meet at junctions, so an edge that enters the area of the route's lanes far from
the junctions of the route, measured along the roads, is on another level. The other direction of a road of the route is not.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from heapq import heappop, heappush
from itertools import pairwise

import numpy as np
from scipy.spatial import KDTree

from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.roads import Floats
from drivecal.roads.lines import SPACING, along, lengths, nodes_of, project
from drivecal.roads.network import Lane, Network, check_limits, limited, limits_at
from drivecal.roads.route import Chain, Guide, Lanes, guide_of, lanes_of, refusal

SAMPLES = 1.0
"""Metres between the points at which lanes are measured, in addition to the file's."""
LARGEST_BACKWARDS = 1.0
"""Metres that a lane may seem to run backwards along the line, at a corner."""
NARROWEST = 0.9
"""Largest product of a line's curvature and a lane's offset: beyond 1, s and d are ambiguous."""
WHOLE_DEGREE = 1.0
"""Shortest route (m) on small coordinates that are no degrees."""
LARGEST_DIFFERENCE = 0.04
"""Largest difference, as a share, of the mean length of an edge's lanes from their shapes'; speed and way of SUMO's vehicles differ alike.
The networks of eclipse-sumo's A10KW, ramp and highway keep 0.035 in each lane, and 0.021 in lanes of more than 100 m."""
LARGEST_IN_CURVES = 0.1
"""The same of a single lane: netconvert gives all lanes of an edge the mean of their lengths, which differ in curves."""
OUTER_GAP = 30.0
"""Metres of a junction that may be part of the first or last edge's length. Without lanes inside of junctions, the gaps between edges are
part of their lengths."""
SHORT = 100.0
"""Metres of a lane; shorter ones may differ by as much as lanes of this length."""
MOST_TRACKS = 128
"""Tracks of a corridor: a motorway with some dozens of interchanges."""
MOST_CELLS = 2_000_000
"""Stations times tracks of a corridor, which has three numbers for each: 100 km of ten tracks."""


@dataclass(frozen=True, slots=True)
class LanePiece:
    """A lane of the network, inside of a junction or not, from s = `begin` to `end` of the corridor (m)."""

    edge: str
    index: int
    begin: float
    end: float


@dataclass(frozen=True, slots=True)
class Track:
    """A chain of connected lanes along the route. `ends`: it ends before the route does, as acceleration lanes and exits do."""

    lanes: tuple[LanePiece, ...]
    begin: float
    end: float
    ends: bool


@dataclass(frozen=True, eq=False)
class Corridor:
    """The lanes of a route in Frenet coordinates.

    `line` is the reference line (n, 5) as in `domain.roads`. `tracks` go from right to left. The arrays (n, m) have a row for each of the
    line. `centres` are the tracks' offsets from the line (m), positive to the left, NaN if the track is not there. Lane `widths` (m) and
    speed `limits` (m/s) apply up to the next row.
    """

    line: Floats
    tracks: tuple[Track, ...]
    centres: Floats
    widths: Floats
    limits: Floats
    name: str = ""
    places: Mapping[tuple[str, int], Floats] = field(default_factory=dict, repr=False)
    """Positions along each lane (m, as SUMO counts) with their s and d: (n, 3)."""
    parallel: bool = False
    """All tracks go from the begin to the end, and no lane leads to two others: a vehicle that changes no lane stays on its track."""

    @property
    def length(self) -> float:
        """Length (m) of the line."""
        return float(self.line[-1, 0])

    def position(self, edge: str, lane: int, s: float) -> tuple[float, float]:
        """Returns s and d of a position along a lane's centre. Raises InvalidInputError if lane or position are not on the route."""
        place = self.places.get((edge, lane))
        if place is None:
            lanes = [index for name, index in self.places if name == edge]
            message = f"the edge {shown(edge, 80)} has no lane {lane} for passenger cars on the route"
            remedy = f"give one of {', '.join(map(str, sorted(lanes)))}" if lanes else "give an edge of the route"
            raise InvalidInputError(Problem("lane" if lanes else "edge", f"{self.name}: {message}", remedy))
        length = float(place[-1, 0])
        if not 0.0 <= s <= length:
            message = f"the lane {shown(f'{edge}_{lane}', 90)} is {length:.2f} m long, and has no position {s:g} m"
            raise InvalidInputError(Problem("s", f"{self.name}: {message}", f"give 0 to {length:.2f}"))
        return float(np.interp(s, place[:, 0], place[:, 1])), float(np.interp(s, place[:, 0], place[:, 2]))

    def piece(self, s: float, lane: int) -> LanePiece:
        """Returns the lane of this index on the edge at s. Raises InvalidInputError if there is none, or a junction is there."""
        if not 0.0 <= s <= self.length:
            message = f"the route is {self.length:.1f} m long, and has no s = {s:g} m"
            raise InvalidInputError(Problem("s", f"{self.name}: {message}", f"give 0 to {self.length:.1f}"))
        here = [piece for track in self.tracks for piece in track.lanes if piece.begin <= s <= piece.end]
        roads = {piece.index: piece for piece in here if not piece.edge.startswith(":")}
        if lane in roads:
            return roads[lane]
        message = f"there is no lane {lane} for passenger cars on the route at s = {s:g} m"
        remedy = f"give one of {', '.join(map(str, sorted(roads)))}" if roads else "there is a junction: give another s"
        raise InvalidInputError(Problem("lane" if roads else "s", f"{self.name}: {message}", remedy))

    def lane_at(self, s: float, d: float) -> int | None:
        """Returns the track whose lane holds a point, None if there is none. Of two that overlap, the closer centre counts."""
        if not 0.0 <= s <= self.length:
            return None
        row = s / self.line[1, 0]
        low = min(int(row), len(self.line) - 2)
        share = row - low
        centres = (1.0 - share) * self.centres[low] + share * self.centres[low + 1]
        off = np.abs(d - centres)
        off[~(off <= 0.5 * self.widths[low])] = np.inf  # NaN is not a lane
        best = int(np.argmin(off))
        return best if off[best] < np.inf else None


def corridor(
    network: Network, route: Sequence[str], name: str, default_limit: float | None = None, *, crossings: bool = False
) -> Corridor:
    """Returns the corridor of a route.

    Args:
        network: the network.
        route: ids of its edges, in the order of the drive.
        name: the network's file in messages.
        default_limit: speed limit (m/s) of lanes without one.
        crossings: whether the route may lead over crossings without traffic lights.

    Raises InvalidInputError with fields `route` or `route[i]` if the route cannot be driven, and with `default_limit` if lanes of it have
    no limit.
    """
    network = replace(limited(network, default_limit), crossed=crossings)
    lanes = lanes_of(network, route)
    check_limits(network, (lane for _, lane in _on_route(lanes)))
    _check_placed(network, lanes)
    _check_size(lanes, 0, name)
    _check_units(network, lanes)
    _check_lengths(network, lanes)
    guide = guide_of(network, lanes)
    _check_size(lanes, len(guide.line), name)
    places = _Places(network, guide)
    centres, widths, limits = np.empty((3, len(guide.line), len(lanes.chains)))
    tracks = []
    for number, chain in enumerate(lanes.chains):
        track, (centres[:, number], widths[:, number], limits[:, number]) = _track(chain, lanes, places, guide.line)
        tracks.append(track)
    parallel = not any(track.begin > 0.0 or track.ends for track in tracks) and _is_parallel(network, route)
    result = Corridor(guide.line, tuple(tracks), centres, widths, limits, name, places.table, parallel)
    _check(result, network, lanes, places)
    return result


def _is_parallel(network: Network, route: Sequence[str]) -> bool:
    """Returns whether each lane of a route leads to one lane of the next edge at most, and no two to the same."""
    for begin, end in pairwise(route):
        ways = [(way.from_lane, way.to_lane) for way in network.connections.get(begin, ()) if way.end == end]
        if any(len(set(lanes)) < len(ways) for lanes in zip(*ways, strict=True)):
            return False
    return True


class _Places:
    """Lanes measured from the line. `table` collects them by edge and index."""

    def __init__(self, network: Network, guide: Guide) -> None:
        self._network, self.guide = network, guide
        self.table: dict[tuple[str, int], Floats] = {}

    def of(self, lane: Lane, begin: float, end: float, index: int) -> Floats:
        """Returns positions, s and d (n, 3) of a lane that lies about between two places of the line; `index`: its edge on the route."""
        key = (lane.edge, lane.index)
        if key not in self.table:
            self.table[key] = self._measured(lane, begin, end, index)
        return self.table[key]

    def _measured(self, lane: Lane, begin: float, end: float, index: int) -> Floats:
        points = _dense(lane.shape)
        positions = lengths(points)
        share = positions / max(positions[-1], 1e-9)
        s, d = project(self.guide.line, points, begin + share * (end - begin))
        where = f"line {lane.line}, the lane {shown(f'{lane.edge}_{lane.index}', 90)}"
        if np.isnan(s).any() or np.max(np.maximum.accumulate(s) - s) > LARGEST_BACKWARDS:
            raise refusal(index, self._network, f"{where} does not run along the route: it is too tight", "give another route")
        return np.column_stack([share * lane.length, np.maximum.accumulate(s), d])


def _dense(shape: Floats) -> Floats:
    """Returns the points of a lane, and more between them."""
    s = lengths(shape)
    return nodes_of(shape, SAMPLES) if s[-1] < SAMPLES else np.vstack(list(_parts(shape, s)))


def _parts(shape: Floats, s: Floats) -> Iterator[Floats]:
    for (first, second), step in zip(pairwise(shape), np.diff(s), strict=True):
        share = np.arange(0.0, 1.0, 1.0 / max(1, int(np.ceil(step / SAMPLES))))[:, None]
        yield first + share * (second - first)
    yield shape[-1:]


def _track(chain: Chain, lanes: Lanes, places: _Places, line: Floats) -> tuple[Track, tuple[Floats, Floats, Floats]]:
    """Returns a track, and the columns of its centres, widths and limits."""
    measured = list(_measured_pieces(chain, places))
    pieces = [(lane, float(place[0, 1]), float(place[-1, 1])) for lane, place in measured]
    s = np.maximum.accumulate(np.concatenate([place[:, 1] for _, place in measured]))
    d = np.concatenate([place[:, 2] for _, place in measured])
    stations = line[:, 0]
    begin = 0.0 if chain.first == 0 else max(0.0, pieces[0][1])
    end = stations[-1] if chain.last == len(lanes.edges) - 1 else min(stations[-1], pieces[-1][2])
    there = (stations >= begin) & (stations <= end)
    at = np.clip(np.searchsorted([piece[1] for piece in pieces], stations, side="right") - 1, 0, None)
    widths, limits = np.empty((2, len(stations)))
    for number, (lane, place) in enumerate(measured):
        here = at == number
        share = np.interp(stations[here], place[:, 1], place[:, 0] / max(lane.length, 1e-9))
        widths[here] = lane.width if lane.widths is None else np.interp(share, *lane.widths.T)
        limits[here] = limits_at(lane, share)
    centre, width, limit = (np.where(there, column, np.nan) for column in (np.interp(stations, s, d), widths, limits))
    stops = [max(stop, following[1]) for (_, _, stop), following in pairwise(pieces)] + [pieces[-1][2]]
    named = tuple(LanePiece(lane.edge, lane.index, start, stop) for (lane, start, _), stop in zip(pieces, stops, strict=True))
    return Track(named, float(begin), float(end), chain.last < len(lanes.edges) - 1), (centre, width, limit)


def _measured_pieces(chain: Chain, places: _Places) -> Iterator[tuple[Lane, Floats]]:
    ranges = places.guide.ranges
    for number, lane in enumerate(chain.lanes):
        index = chain.first + number
        begin, end = ranges[index]
        yield lane, places.of(lane, begin, end, index)
        if number < len(chain.inside):
            for inner in chain.inside[number]:
                yield inner, places.of(inner, end, ranges[index + 1][0], index + 1)


def _check_placed(network: Network, lanes: Lanes) -> None:
    """Raises InvalidInputError if a lane of the route is not where the OpenDRIVE file has it."""
    for index, lane in _on_route(lanes):
        if lane.unplaced is not None:
            where = f"line {lane.line}, the lane {shown(f'{lane.edge}_{lane.index}', 90)}"
            message = f"{where} is not at its place in the OpenDRIVE file: {shown(lane.unplaced, 200)}"
            raise refusal(index, network, message, "give another route, or export the file again")


def _check_size(lanes: Lanes, stations: int, name: str) -> None:
    """Raises InvalidInputError if a route has too many tracks, or too many of them for its stations."""
    tracks = len(lanes.chains)
    if tracks > MOST_TRACKS:
        message = f"{name}: the route has {tracks:,} chains of connected lanes, more than {MOST_TRACKS}"
        raise InvalidInputError(Problem("route", message, "connect the lanes of its edges, or give a shorter route"))
    if stations * tracks > MOST_CELLS:
        longest = MOST_CELLS // tracks * SPACING / 1000.0
        message = f"{name}: the route has {tracks:,} chains of connected lanes, and is longer than {longest:.0f} km"
        raise InvalidInputError(Problem("route", message, "give a shorter route, or one with fewer ramps"))


def _check_units(network: Network, lanes: Lanes) -> None:
    """Raises InvalidInputError if coordinates are degrees."""
    sizes = [float(lengths(lane.shape)[-1]) for lane, _ in lanes.guide]
    points = np.vstack([lane.shape for lane, _ in lanes.guide])
    if sum(sizes) < WHOLE_DEGREE and np.all(np.abs(points) <= (180.0, 90.0)):
        raise refusal(
            0,
            network,
            "the coordinates look like degrees of longitude and latitude",
            "build the network in metres: netconvert --proj.utm",
        )


def _check_lengths(network: Network, lanes: Lanes) -> None:
    """Raises InvalidInputError if the length of a lane is not that of its shape: SUMO moves by the length, places are from the shape."""
    gaps = np.zeros(len(lanes.edges) + 1)
    if not any(name.startswith(":") for name in network.edges):
        gaps[0] = gaps[-1] = OUTER_GAP
    for chain in lanes.chains:
        for number, (before, after) in enumerate(pairwise(chain.lanes)):
            if not chain.inside[number]:
                index = chain.first + number + 1
                gaps[index] = max(gaps[index], float(np.hypot(*(after.shape[0] - before.shape[-1]))))
    jumped = gaps[:-1] + gaps[1:]
    for index, lane in sorted(_on_route(lanes), key=lambda entry: entry[0]):
        size = float(lengths(lane.shape)[-1])
        if not _fits(lane.length, size, LARGEST_IN_CURVES, 0.0 if lane.edge.startswith(":") else jumped[index]):
            where = f"line {lane.line}, the lane {lane.index} of the edge {shown(lane.edge, 80)}"
            message = f"{where}: its length is {lane.length:.2f} m, but its shape is {size:.2f} m long"
            raise refusal(index, network, message, "leave the edge out of the route, or build the network again")
    for index, edge in enumerate(lanes.edges):
        size = float(np.mean([lengths(lane.shape)[-1] for lane in edge.lanes]))
        length = float(np.mean([lane.length for lane in edge.lanes]))
        if not _fits(length, size, LARGEST_DIFFERENCE, jumped[index]):
            where = f"line {edge.line}, the edge {shown(edge.id, 80)}"
            message = f"{where}: its lanes are {length:.2f} m long, but their shapes {size:.2f} m"
            raise refusal(index, network, message, "build the network again")


def _fits(length: float, size: float, share: float, jumped: float) -> bool:
    """Returns whether a length belongs to a shape of this size, all m. `jumped` is the part that may lie in junctions."""
    allowed = share * max(size, SHORT)
    return -allowed <= length - size <= allowed + jumped


def _on_route(lanes: Lanes) -> Iterator[tuple[int, Lane]]:
    """Yields each lane of the chains, inside of junctions or not, with the index of its edge or of the next."""
    known = set[tuple[str, int]]()
    for chain in lanes.chains:
        inner = [(chain.first + number + 1, lane) for number, inside in enumerate(chain.inside) for lane in inside]
        for index, lane in [*enumerate(chain.lanes, chain.first), *inner]:
            if (lane.edge, lane.index) not in known:
                known.add((lane.edge, lane.index))
                yield index, lane


def _check(result: Corridor, network: Network, lanes: Lanes, places: _Places) -> None:
    """Raises InvalidInputError if lanes are not ordered from the right, or the line turns too tightly for them."""
    for index, edge in enumerate(lanes.edges):
        offsets = [float(np.median(places.table[edge.id, lane.index][:, 2])) for lane in edge.lanes if lane.for_cars]
        if any(left <= right for right, left in pairwise(offsets)):
            message = f"line {edge.line}, the edge {shown(edge.id, 80)}: its lanes are not ordered from right to left"
            raise refusal(index, network, message, "give a network for right-hand traffic")
    reach = np.nanmax(np.abs(result.centres) + 0.5 * result.widths, axis=1)
    tight = np.abs(result.line[:, 4]) * reach
    worst = int(np.argmax(tight))
    if tight[worst] > NARROWEST:
        s = result.line[worst, 0]
        index = max(number for number, (begin, _) in enumerate(places.guide.ranges) if begin <= s or number == 0)
        radius = 1.0 / abs(result.line[worst, 4])
        message = f"the route turns with a radius of {radius:.1f} m at the edge {shown(lanes.edges[index].id, 80)}"
        raise refusal(index, network, message, "give a route along a motorway or a road without crossings")


NEAR = 100.0
"""Metres of driving from a route within which a road is on its level: a ramp to a bridge is longer."""
BESIDE = 1.25
"""Metres beyond the outermost lanes that belong to their area: half a truck."""
LEVEL_SAMPLES = 2.0
"""Metres between the points of a lane that are looked at."""


def other_levels(network: Network, corridor: Corridor) -> dict[str, tuple[float, float]]:
    """Returns the stretches (m along their lanes) of edges on which vehicles are above or below the corridor's lanes, by edge."""
    crossing = _crossing(network, corridor)
    if not crossing:
        return {}
    route = {edge for edge, _ in corridor.places if not edge.startswith(":")}
    outgoing, incoming = _links(network)
    behind, before = _distances(network, route, outgoing), _distances(network, route, incoming)
    junctions = {network.edges[edge].begin for edge in behind} | {network.edges[edge].end for edge in before}
    opposite = {(network.edges[edge].end, network.edges[edge].begin) for edge in route}
    stretches = {}
    for name, positions in crossing.items():
        edge = network.edges[name]
        if (edge.begin, edge.end) in opposite:
            continue
        length = max(lane.length for lane in edge.lanes)
        first = max(0.0, NEAR - behind.get(name, NEAR))
        last = length - max(0.0, NEAR - before.get(name, NEAR))
        far = positions[(positions >= first) & (positions <= last)]
        if len(far) and not (edge.function != "" and name[1:].rpartition("_")[0] in junctions):
            stretches[name] = (float(far.min()) - 2.0 * LEVEL_SAMPLES, float(far.max()) + 2.0 * LEVEL_SAMPLES)
    return stretches


def _crossing(network: Network, corridor: Corridor) -> dict[str, Floats]:
    """Returns positions in the area of the corridor's lanes, along edges other than the corridor's own."""
    line = corridor.line
    half = 0.5 * corridor.widths
    right, left = np.nanmin(corridor.centres - half, axis=1) - BESIDE, np.nanmax(corridor.centres + half, axis=1) + BESIDE
    reach = float(max(np.abs(right).max(), np.abs(left).max())) + SPACING
    lower, upper = line[:, 1:3].min(axis=0) - reach, line[:, 1:3].max(axis=0) + reach
    own = {edge for edge, _ in corridor.places}
    lanes = [lane for name, edge in network.edges.items() if name not in own for lane in edge.lanes]
    lanes = [lane for lane in lanes if (lane.shape.max(axis=0) >= lower).all() and (lane.shape.min(axis=0) <= upper).all()]
    if not lanes:
        return {}
    shares = [np.linspace(0.0, 1.0, max(2, int(lengths(lane.shape)[-1] / LEVEL_SAMPLES) + 1)) for lane in lanes]
    points = np.vstack([along(lane.shape, share * lengths(lane.shape)[-1]) for lane, share in zip(lanes, shares, strict=True)])
    rows = np.asarray(KDTree(line[:, 1:3]).query(points, distance_upper_bound=reach)[1])
    near = np.flatnonzero(rows < len(line))  # a point without a row in reach has this number
    rows = rows[near]
    dx, dy = (points[near] - line[rows, 1:3]).T
    cosine, sine = np.cos(line[rows, 3]), np.sin(line[rows, 3])
    d, ahead = dy * cosine - dx * sine, dx * cosine + dy * sine
    inside = near[(right[rows] <= d) & (d <= left[rows]) & (np.abs(ahead) <= SPACING)]
    owner = np.repeat(np.arange(len(lanes)), [len(share) for share in shares])[inside]
    positions = np.concatenate([share * lane.length for lane, share in zip(lanes, shares, strict=True)])[inside]
    entered: dict[str, list[Floats]] = {}
    for number in np.unique(owner).tolist():
        entered.setdefault(lanes[number].edge, []).append(positions[owner == number])
    return {name: np.concatenate(parts) for name, parts in entered.items()}


def _links(network: Network) -> tuple[Mapping[str, list[str]], Mapping[str, list[str]]]:
    """Returns the roads that follow each road, and those before it."""
    outgoing: dict[str, list[str]] = {}
    incoming: dict[str, list[str]] = {}
    for begin, ways in network.connections.items():
        for end in dict.fromkeys(way.end for way in ways):
            if begin in network.edges and end in network.edges and not begin.startswith(":"):
                outgoing.setdefault(begin, []).append(end)
                incoming.setdefault(end, []).append(begin)
    return outgoing, incoming


def _distances(network: Network, route: Collection[str], links: Mapping[str, list[str]]) -> dict[str, float]:
    """Returns the least way (m) from a route to each road within `NEAR`, in the direction of `links`; 0 for its own edges."""
    distances: dict[str, float] = {}
    reached = [(0.0, edge) for edge in sorted(route)]
    while reached:
        distance, name = heappop(reached)
        if name in distances or distance >= NEAR:
            continue
        distances[name] = distance
        onward = 0.0 if name in route else max(lane.length for lane in network.edges[name].lanes)
        for following in links.get(name, ()):
            heappush(reached, (distance + onward, following))
    return distances
