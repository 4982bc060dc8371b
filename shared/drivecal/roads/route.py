"""Routes over a network: checks that the edges follow each other, chains their lanes, and joins the guide's to the reference line.

The guide is the lane that the reference line follows: the rightmost lane that reaches the end with the fewest lane changes. Traffic
lights, stop signs, and ways of others that cross the route's at junctions are refused.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from graphlib import TopologicalSorter
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.roads import Floats
from drivecal.roads.lines import along, lengths, nodes_of, project, smoothed, table
from drivecal.roads.network import Connection, Edge, Junction, Lane, Network

STOPS = {"s": "a stop sign", "w": "an all-way stop"}
TURN = "t"
"""Direction of a connection that turns back."""


def check_junction(network: Network, links: Sequence[Connection], index: int) -> None:
    """Raises InvalidInputError with the field `route[index]` if the junction before this edge holds up or crosses `links`.

    A merge is not a conflict: ways from elsewhere to the same edge give way or zip in.
    """
    junction = network.junctions.get(network.edges[links[0].begin].end)
    if junction is None:
        name = shown(network.edges[links[0].begin].end, 80)
        raise refusal(index, network, f"the junction {name} is missing", "build the network again")
    where = f"line {junction.line}, the junction {shown(junction.id, 80)}"
    for link in links:
        if link.light:
            raise refusal(index, network, f"{where} has traffic lights", "give a route without crossings")
        if link.direction == TURN:
            raise refusal(index, network, f"{where}: the route turns back", "give a route that continues")
        if link.state in STOPS:
            raise refusal(index, network, f"{where} has {STOPS[link.state]}", "give a route without crossings")
    crossing = None if network.crossed else next(_crossings(network, junction, links), None)
    if crossing is not None:
        why = f"{where} is a crossing: {crossing} crosses the way from {shown(links[0].begin, 80)} to {shown(links[0].end, 80)}"
        raise refusal(index, network, why, "give a route along a road without crossings")


def _crossings(network: Network, junction: Junction, links: Sequence[Connection]) -> Iterator[str]:
    """Yields what crosses the links: ways from another edge to another edge, and pedestrian crossings."""
    requests: list[Connection] = []
    for name in junction.lanes:
        lane = network.lane(name)
        edge: Edge | None = None if lane is None else network.edges[lane.edge]
        if lane is None or edge is None:
            continue
        requests += [link for link in network.connections.get(edge.id, ()) if link.from_lane == lane.index]
    numbers = {link: number for number, link in enumerate(requests)}
    for link in links:
        number = numbers.get(link)
        bits = junction.foes[number] if number is not None and number < len(junction.foes) else ""
        for other, bit in enumerate(reversed(bits)):
            if bit == "0":
                continue
            if other >= len(requests):
                yield "a pedestrian crossing"
            elif requests[other].begin != link.begin and requests[other].end != link.end and requests[other].direction != TURN:
                yield f"the way from {shown(requests[other].begin, 80)} to {shown(requests[other].end, 80)}"


MOST_EDGES = 2_000
SHORTEST_CHANGE = 30.0
"""Metres that the guide needs for each lane that it changes."""
MOST_INSIDE = 10
"""Lanes in a row inside of a junction."""


@dataclass(frozen=True, eq=False, slots=True)
class Way:
    """A way from a lane of an edge to one of the next, through lanes inside of the junction if the network has them."""

    begin: Lane
    inside: tuple[Lane, ...]
    end: Lane

    @property
    def jump(self) -> float:
        """Lateral distance (m) between the ends of the two lanes, and how far their directions differ, as metres of 10 m."""
        last, first = self.begin.shape[-2:], self.end.shape[:2]
        before, after = (float(np.arctan2(*(pair[1] - pair[0])[::-1])) for pair in (last, first))
        direction = np.array([np.cos(before), np.sin(before)])
        gap = first[0] - last[1]
        return abs(float(direction[0] * gap[1] - direction[1] * gap[0])) + 10.0 * abs(float(np.sin((after - before) / 2)))


@dataclass(frozen=True, eq=False, slots=True)
class Chain:
    """Connected lanes of a route. `first` and `last`: the indices of their edges on the route; `inside[i]` leads from lane i to i + 1."""

    first: int
    lanes: tuple[Lane, ...]
    inside: tuple[tuple[Lane, ...], ...]

    @property
    def last(self) -> int:
        """Index of the last edge."""
        return self.first + len(self.lanes) - 1


@dataclass(frozen=True, eq=False)
class Lanes:
    """The lanes of a route. `chains` come from the right; `guide` has the guide's lanes at the begin and the end of each edge."""

    edges: tuple[Edge, ...]
    chains: tuple[Chain, ...]
    guide: tuple[tuple[Lane, Lane], ...]
    passages: tuple[tuple[Lane, ...], ...]
    """Lanes inside of the junctions that the guide takes."""


def lanes_of(network: Network, route: Sequence[str]) -> Lanes:
    """Returns the lanes of a route. Raises InvalidInputError with the fields `route[i]` if it cannot be driven."""
    edges = tuple(_edge(network, name, index) for index, name in enumerate(_checked(route)))
    ways = [_ways(network, before, after, index + 1) for index, (before, after) in enumerate(pairwise(edges))]
    guide = _guide(network, edges, ways)
    taken = [
        next(way for way in between if way.begin is before[1] and way.end is after[0])
        for between, (before, after) in zip(ways, pairwise(guide), strict=True)
    ]
    chosen = [_matched(between, way) for between, way in zip(ways, taken, strict=True)]
    return Lanes(edges, _chains(edges, chosen), guide, tuple(way.inside for way in taken))


def refusal(index: int, network: Network, message: str, remedy: str) -> InvalidInputError:
    """Returns the refusal of an edge of the route."""
    return InvalidInputError(Problem(f"route[{index}]", f"{network.name}: {message}", remedy))


def _checked(route: Sequence[str]) -> Sequence[str]:
    if not 1 <= len(route) <= MOST_EDGES:
        raise InvalidInputError(Problem("route", f"it has {len(route)} edges", f"give 1 to {MOST_EDGES:,}"))
    for index, name in enumerate(route):
        if name in route[:index]:
            message = f"the edge {shown(name, 80)} appears twice"
            raise InvalidInputError(Problem(f"route[{index}]", message, "give a route without loops"))
    return route


def _edge(network: Network, name: str, index: int) -> Edge:
    edge = network.edges.get(name)
    if edge is None:
        _, message, remedy = next(network.faults([name]))
        raise refusal(index, network, message, remedy)
    where = f"line {edge.line}, the edge {shown(name, 80)}"
    if edge.function != "":
        raise refusal(index, network, f"{where} lies inside of a junction ({edge.function})", "give those before and after it")
    if not any(lane.for_cars for lane in edge.lanes):
        raise refusal(index, network, f"{where} has no lane for passenger cars", "give an edge with one")
    if name in network.roundabouts:
        raise refusal(index, network, f"{where} is part of a roundabout", "give a route along a road without crossings")
    return edge


def _ways(network: Network, before: Edge, after: Edge, index: int) -> tuple[Way, ...]:
    """Returns the ways for cars between two edges. Raises InvalidInputError if there is none, or a crossing."""
    links = [link for link in network.connections.get(before.id, ()) if link.end == after.id]
    names = f"{shown(before.id, 80)} and {shown(after.id, 80)}"
    for link in links:
        if link.from_lane >= len(before.lanes) or link.to_lane >= len(after.lanes):
            raise refusal(index, network, f"line {link.line}: a connection of {names} names a missing lane", "correct it")
    ways = tuple(
        Way(before.lanes[link.from_lane], _inside(network, link, index), after.lanes[link.to_lane])
        for link in links
        if link.for_cars and before.lanes[link.from_lane].for_cars and after.lanes[link.to_lane].for_cars
    )
    if not ways:
        message = f"no lane for passenger cars leads from {names.replace(' and ', ' to ')}"
        reached = dict.fromkeys(link.end for link in network.connections.get(before.id, ()))
        remedy = f"{shown(before.id, 80)} leads to {', '.join(shown(name, 80) for name in list(reached)[:5]) or 'no edge'}"
        raise refusal(index, network, message, remedy)
    if before.end != after.begin:
        message = f"{names} are connected, but the first ends at {shown(before.end, 80)} and the second begins at {shown(after.begin, 80)}"
        raise refusal(index, network, message, "build the network again")
    check_junction(network, [link for link in links if link.for_cars], index)
    return ways


def _inside(network: Network, link: Connection, index: int) -> tuple[Lane, ...]:
    """Returns the lanes inside of the junction that a connection takes."""
    lanes: list[Lane] = []
    via = link.via
    while via is not None:
        lane = network.lane(via)
        if lane is None or network.edges[lane.edge].function != "internal" or len(lanes) >= MOST_INSIDE:
            message = f"line {link.line}: a connection leads over {shown(via, 80)}, which is not a lane inside of a junction"
            raise refusal(index, network, message, "build the network again")
        lanes.append(lane)
        connections = network.connections.get(lane.edge, ())
        onward = (each.via for each in connections if each.from_lane == lane.index and each.end == link.end)
        via = next(onward, None)
    return tuple(lanes)


def _guide(network: Network, edges: Sequence[Edge], ways: Sequence[Sequence[Way]]) -> tuple[tuple[Lane, Lane], ...]:
    """Returns the guide's lanes at begin and end of each edge: fewest lane changes, then least jumps in whole metres, then rightmost."""
    costs = {lane.index: 1e-6 * lane.index for lane in edges[0].lanes if lane.for_cars}
    steps: list[dict[int, tuple[int, int]]] = []
    """Steps for each edge but the first: the lane at its begin -> the lanes at begin and end of the edge before."""
    for edge, between in zip(edges, ways, strict=False):
        best: dict[int, tuple[float, int, int]] = {}
        for way in between:
            for begin, cost in costs.items():
                changes = _change_cost(edge, begin, way.begin.index)
                if changes is None:
                    continue
                total = cost + changes + 1e-3 * int(min(way.jump, 50.0)) + 1e-6 * way.end.index
                best[way.end.index] = min(best.get(way.end.index, (np.inf, 0, 0)), (total, begin, way.begin.index))
        if not best:
            message = f"the lanes that reach {shown(edge.id, 80)} do not lead on: a lane change needs {SHORTEST_CHANGE:g} m"
            raise refusal(len(steps), network, message, "give another route")
        steps.append({end: (begin, leave) for end, (_, begin, leave) in best.items()})
        costs = {end: total for end, (total, _, _) in best.items()}
    begin = leave = min(costs, key=lambda lane: costs[lane])
    guide = [(begin, leave)]
    for step in reversed(steps):
        begin, leave = step[begin]
        guide.append((begin, leave))
    return tuple((edge.lanes[begin], edge.lanes[leave]) for edge, (begin, leave) in zip(edges, reversed(guide), strict=True))


def _change_cost(edge: Edge, begin: int, leave: int) -> float | None:
    """Returns the cost of changing lanes on an edge, None if that is impossible."""
    if begin == leave:
        return 0.0
    crossed = edge.lanes[min(begin, leave) : max(begin, leave) + 1]
    changes, length = abs(begin - leave), edge.lanes[leave].length
    if length < changes * SHORTEST_CHANGE or not all(lane.for_cars for lane in crossed):
        return None
    return changes * (1.0 + SHORTEST_CHANGE / length)


def _matched(ways: Sequence[Way], first: Way) -> list[Way]:
    """Returns ways that neither share a lane nor cross each other: the guide's, then the straightest."""
    chosen = [first]
    for way in sorted(ways, key=lambda way: (way.jump, way.begin.index, way.end.index)):
        if all((way.begin.index - other.begin.index) * (way.end.index - other.end.index) > 0 for other in chosen):
            chosen.append(way)
    return chosen


def _chains(edges: Sequence[Edge], chosen: Sequence[Sequence[Way]]) -> tuple[Chain, ...]:
    """Returns the chains from right to left: of two that are adjacent on any edge, the right one comes first."""
    open_: dict[int, int] = {}
    chains: list[tuple[int, list[Lane], list[tuple[Lane, ...]]]] = []
    order: TopologicalSorter[int] = TopologicalSorter()
    for index, edge in enumerate(edges):
        arriving = {way.end.index: way for way in chosen[index - 1]} if index else {}
        here: dict[int, int] = {}
        for lane in (lane for lane in edge.lanes if lane.for_cars):
            way = arriving.get(lane.index)
            if way is None:
                here[lane.index] = len(chains)
                chains.append((index, [lane], []))
            else:
                here[lane.index] = open_[way.begin.index]
                chains[here[lane.index]][1].append(lane)
                chains[here[lane.index]][2].append(way.inside)
        for right, left in pairwise(here[lane] for lane in sorted(here)):
            order.add(left, right)
        order.add(next(iter(here.values())))
        open_ = here
    ordered = (chains[index] for index in order.static_order())  # without circles, as ways do not cross
    return tuple(Chain(first, tuple(lanes), tuple(inside)) for first, lanes, inside in ordered)


TOLERANCE = 0.09
"""Metres between the line and the file's points, before rounding."""
FASTEST_TURN = 8.0
"""Lateral acceleration (m/s²) at the speed limit that no car reaches: the line leaves short corners that ask for more."""
SLOWEST, FASTEST = 5.0, 36.0
"""Speeds (m/s) between which limits count there."""
SMALLEST_RADIUS = 30.0
"""Metres."""
SHORTEST_TURN = 20.0
"""Metres. Longer turns are the road's own."""
AROUND = 25.0
"""Metres before and after such a corner where the line leaves the lane."""
WIDENINGS = 10
"""Times that the tolerance grows by half there, at most."""
LARGEST_GAP = 100.0
"""Metres between lanes that follow each other."""
SHORTEST, LONGEST = 10.0, 100_000.0
"""Metres of a route."""


@dataclass(frozen=True, eq=False)
class Guide:
    """A reference line and, for each edge of the route, about where it begins and ends (s, m)."""

    line: Floats
    ranges: tuple[tuple[float, float], ...]


def guide_of(network: Network, lanes: Lanes) -> Guide:
    """Returns the reference line of a route's lanes. Raises InvalidInputError if lanes have gaps, or the route is too short."""
    joined = _Joined(network)
    borders: list[tuple[int, int]] = []
    for index, (begin, end) in enumerate(lanes.guide):
        first = joined.append(begin, begin.shape if begin is end else _blended(begin, end), index)
        borders.append((first, joined.count - 1))
        if index < len(lanes.passages):
            for lane in lanes.passages[index]:
                joined.append(lane, lane.shape, index)
    points, limits = joined.result()
    length = lengths(points)
    if not SHORTEST <= length[-1] <= LONGEST:
        message = f"{network.name}: the route is {length[-1]:.1f} m long"
        raise InvalidInputError(Problem("route", message, f"give one of {SHORTEST:g} to {LONGEST:,.0f} m"))
    nodes = nodes_of(points)
    at = np.clip(np.searchsorted(length, lengths(nodes), side="left"), 0, len(limits) - 1)
    line = _drivable(nodes, limits[at])
    ends = points[[place for border in borders for place in border]]
    guess = length[[place for border in borders for place in border]]
    s, _ = project(line, ends, guess)
    s = np.where(np.isnan(s), guess, s).reshape(-1, 2)
    return Guide(line, tuple((float(begin), float(end)) for begin, end in s))


class _Joined:
    """Polylines joined to one, without points that step back."""

    def __init__(self, network: Network) -> None:
        self._network = network
        self._points: list[Floats] = []
        self._limits: list[Floats] = []
        self._last: Floats | None = None
        self.count = 0

    def append(self, lane: Lane, shape: Floats, index: int) -> int:
        """Adds the points of a lane, or of a change from it; returns the index of the first."""
        kept = shape
        if self._last is not None:
            gap = float(np.hypot(*(shape[0] - self._last)))
            if gap > LARGEST_GAP:
                where = f"line {lane.line}, the lane {shown(f'{lane.edge}_{lane.index}', 90)}"
                message = f"{where} begins {gap:.1f} m away from the end of the one before it"
                raise refusal(index, self._network, message, "build the network again")
            direction = _direction(shape)
            ahead = (shape - self._last) @ direction > 0.05
            kept = shape[int(np.argmax(ahead)) :] if ahead.any() else shape[:0]
        steps = np.hypot(*np.diff(kept, axis=0).T) if len(kept) > 1 else np.zeros(0)
        kept = kept[np.concatenate([[True], steps > 1e-3])] if len(kept) else kept
        # a lane whose first point is the last of the lane before begins there
        first = self.count if len(kept) == len(shape) else max(0, self.count - 1)
        if len(kept):
            self._points.append(kept)
            self._limits.append(np.full(len(kept), lane.limit))
            self._last = kept[-1]
            self.count += len(kept)
        return first

    def result(self) -> tuple[Floats, Floats]:
        """Returns the points (n, 2) and the speed limit at each (n,)."""
        return np.vstack(self._points), np.concatenate(self._limits)


def _direction(shape: Floats) -> Floats:
    """Returns the direction of a lane at its start, a unit vector, zero if it is a point."""
    steps = shape[1:] - shape[0]
    far = np.hypot(*steps.T)
    index = int(np.argmax(far > min(1.0, far.max())))
    return np.asarray(steps[index] / far[index] if far[index] > 0 else np.zeros(2))


def _blended(begin: Lane, end: Lane) -> Floats:
    """Returns points of a smooth lane change along the whole of an edge."""
    count = max(16, int(lengths(begin.shape)[-1]))
    share = np.linspace(0.0, 1.0, count)
    first, second = (along(lane.shape, share * lengths(lane.shape)[-1]) for lane in (begin, end))
    weight = (share**3 * (10.0 - 15.0 * share + 6.0 * share**2))[:, None]
    return np.asarray((1.0 - weight) * first + weight * second)


def _drivable(nodes: Floats, limits: Floats) -> Floats:
    """Returns the line through nodes (n, 2), which it leaves for want of a curve that can be driven.

    It leaves them only if that helps: around corners that nothing makes fit for the limit, it stays as long as their radius is not below
    `SMALLEST_RADIUS`.
    """
    drivable = FASTEST_TURN / np.clip(limits, SLOWEST, FASTEST) ** 2
    line, tolerance, hopeless = _widened(nodes, np.full(len(nodes), TOLERANCE), drivable)
    if hopeless.any():
        base = np.where(hopeless, TOLERANCE, tolerance)
        line, _, _ = _widened(nodes, base, np.maximum(drivable, 1.0 / SMALLEST_RADIUS))
    return line


def _widened(nodes: Floats, tolerance: Floats, most: Floats) -> tuple[Floats, Floats, npt.NDArray[np.bool_]]:
    """Returns a line whose short turns have at most the curvature `most` (n,), the tolerance (n,) that it takes, and where none does."""
    s, tolerance = lengths(nodes), tolerance.copy()
    for widening in range(WIDENINGS + 1):
        line = table(smoothed(nodes, tolerance))
        excess = np.abs(line[:, 4]) > np.interp(line[:, 0], s, most)
        around = np.zeros(len(nodes), np.bool_)
        for begin, end in _runs(line[:, 0], excess):
            if end - begin < SHORTEST_TURN:
                around |= (s >= begin - AROUND) & (s <= end + AROUND)
        if not around.any() or widening == WIDENINGS:
            break
        tolerance[around] *= 1.5
    return line, tolerance, around


def _runs(s: Floats, inside: npt.NDArray[np.bool_]) -> tuple[tuple[float, float], ...]:
    """Returns first and last s of each run of true values."""
    borders = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(np.int8), [0]])))
    return tuple((float(s[first]), float(s[last - 1])) for first, last in borders.reshape(-1, 2))
