"""Ways over a network: from an edge to another, and along the road."""

from collections.abc import Iterator, Mapping, Sequence
from heapq import heappop, heappush

from drivecal.roads.network import Connection, Network

LONGEST = 2_000
"""Edges of a way."""
MOST_STEPS = 3_000_000
"""Connections that the searches of a file may look at: some seconds."""


class LongSearchError(Exception):
    """Searches for ways look at more than MOST_STEPS connections."""


class WaySearch:
    """Shortest ways for cars over a network, which share MOST_STEPS."""

    def __init__(self, network: Network) -> None:
        self._network = network
        self._steps = 0

    def over(self, stops: Sequence[str]) -> list[str] | None:
        """Returns the shortest way over all these edges in their order, None if there is none. Raises LongSearchError."""
        way = [stops[0]]
        for stop in stops[1:]:
            piece = self._shortest(way[-1], stop)
            if piece is None or len(way) + len(piece) > LONGEST:
                return None
            way += piece[1:]
        return way

    def _shortest(self, begin: str, end: str) -> list[str] | None:
        """Returns the edges from one to another, with both."""
        waiting: list[tuple[float, str, str | None, int]] = [(0.0, begin, None, 1)]
        before: dict[str, str | None] = {}
        while waiting:
            length, edge, last, edges = heappop(waiting)
            if edge in before:
                continue
            if edge == end:
                return _traced(before | {end: last}, end)
            if edges == LONGEST:
                continue
            before[edge] = last
            length += self._network.edges[edge].lanes[0].length
            self._steps += 1 + len(self._network.connections.get(edge, ()))
            if self._steps > MOST_STEPS:
                raise LongSearchError
            for following in dict.fromkeys(link.end for link in links(self._network, edge)):
                if following not in before:
                    heappush(waiting, (length, following, edge, edges + 1))
        return None


def _traced(before: Mapping[str, str | None], end: str) -> list[str]:
    way: list[str] = []
    edge: str | None = end
    while edge is not None:
        way.append(edge)
        edge = before[edge]
    return way[::-1]


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
