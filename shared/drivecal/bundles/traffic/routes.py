"""Ways over a network: from an edge to another, and along the road."""

from collections.abc import Iterator, Sequence
from heapq import heappop, heappush

from drivecal.roads.network import Connection, Network

LONGEST = 2_000
"""Edges of a way."""


def shortest(network: Network, begin: str, end: str) -> list[str] | None:
    """Returns the edges of the shortest way for cars from an edge to another, with both; None if there is none."""
    waiting: list[tuple[float, str, tuple[str, ...]]] = [(0.0, begin, (begin,))]
    done: set[str] = set()
    while waiting:
        length, edge, way = heappop(waiting)
        if edge == end:
            return list(way)
        if edge in done or len(way) >= LONGEST:
            continue
        done.add(edge)
        for following in dict.fromkeys(link.end for link in links(network, edge)):
            if following not in done:
                heappush(waiting, (length + network.edges[edge].lanes[0].length, following, (*way, following)))
    return None


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


def joined(network: Network, stops: Sequence[str]) -> list[str] | None:
    """Returns the shortest way over all these edges in their order, None if there is none."""
    way = [stops[0]]
    for stop in stops[1:]:
        piece = shortest(network, way[-1], stop)
        if piece is None or len(way) + len(piece) > LONGEST:
            return None
        way += piece[1:]
    return way
