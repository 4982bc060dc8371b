"""Roads above and below a route: edges that cross its lanes without a junction.

Networks hold no reliable heights. Roads of one level meet at junctions, so an edge that enters the area of the route's lanes far from
the junctions of the route, measured along the roads, is on another level. The other direction of a road of the route is not.
"""

from collections.abc import Collection, Mapping
from heapq import heappop, heappush

import numpy as np
from scipy.spatial import KDTree

from drivecal.domain.roads import Floats
from drivecal.roads.corridor import Corridor
from drivecal.roads.lines import SPACING, along, lengths
from drivecal.roads.network import Network

NEAR = 100.0
"""Metres of driving from a route within which a road is on its level: a ramp to a bridge is longer."""
BESIDE = 1.25
"""Metres beyond the outermost lanes that belong to their area: half a truck."""
SAMPLES = 2.0
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
            stretches[name] = (float(far.min()) - 2.0 * SAMPLES, float(far.max()) + 2.0 * SAMPLES)
    return stretches


def _crossing(network: Network, corridor: Corridor) -> dict[str, Floats]:
    """Returns positions in the area of the corridor's lanes, along edges beside the corridor's own."""
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
    shares = [np.linspace(0.0, 1.0, max(2, int(lengths(lane.shape)[-1] / SAMPLES) + 1)) for lane in lanes]
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
