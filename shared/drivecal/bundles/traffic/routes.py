"""Ways over a network: from an edge to another, and along the road."""

from collections.abc import Iterator, Sequence
from heapq import heappop, heappush

from drivecal.roads.network import Connection, Network

LONGEST = 2_000
"""Edges of a way."""
MOST_STEPS = 30_000_000
"""Connections that the searches of a file may look at, and edges at which they compare ways: half a minute."""


class LongSearchError(Exception):
    """Searches for ways take more than MOST_STEPS."""


class WaySearch:
    """Shortest ways for cars over a network, which share MOST_STEPS. Of equally long ones the first by the names of their edges."""

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

    def count(self, steps: int) -> None:
        """Counts steps. Raises LongSearchError."""
        self._steps += steps
        if self._steps > MOST_STEPS:
            raise LongSearchError

    def _shortest(self, begin: str, end: str) -> list[str] | None:
        """Returns the edges from `begin` to `end`, with both."""
        waiting = [(0.0, begin, _Way(self, begin, None))]
        done: set[str] = set()
        while waiting:
            length, edge, way = heappop(waiting)
            if edge == end:
                return way.traced()
            if edge in done or way.size >= LONGEST:
                continue
            done.add(edge)
            length += self._network.edges[edge].lanes[0].length
            self.count(1 + len(self._network.connections.get(edge, ())))
            for following in dict.fromkeys(link.end for link in links(self._network, edge)):
                if following not in done:
                    heappush(waiting, (length, following, _Way(self, following, way)))
        return None


class _Way:
    """A way from the begin of a search. It holds its last edge and the way before it, which others share: a million whole ways would take
    gigabytes."""

    __slots__ = ("before", "edge", "search", "size")

    def __init__(self, search: WaySearch, edge: str, before: "_Way | None") -> None:
        self.search, self.edge, self.before = search, edge, before
        self.size: int = 1 if before is None else before.size + 1

    def traced(self) -> list[str]:
        """Returns its edges."""
        edges: list[str] = []
        way: _Way | None = self
        while way is not None:
            edges.append(way.edge)
            way = way.before
        return edges[::-1]

    def __lt__(self, other: "_Way") -> bool:
        """Whether its edges come first by their names. Both lead to one edge; each edge before it has one way, so that what two ways share
        is one object."""
        one, two, steps = self, other, 0
        while one is not two:
            last = one.edge, two.edge
            steps += 1
            forward = one.size >= two.size, two.size >= one.size
            if forward[0] and one.before is not None:
                one = one.before
            if forward[1] and two.before is not None:
                two = two.before
        self.search.count(steps)
        return last[0] < last[1] if steps else False


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
