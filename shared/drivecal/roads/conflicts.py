"""Junctions on a route: refuses traffic lights, stop signs, and ways of others that cross the route's."""

from collections.abc import Iterator, Sequence

from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.roads.network import Connection, Edge, Junction, Network

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
        raise _refused(network, index, f"the junction {name} is missing", "build the network again")
    where = f"line {junction.line}, the junction {shown(junction.id, 80)}"
    for link in links:
        if link.light:
            raise _refused(network, index, f"{where} has traffic lights", "give a route without crossings")
        if link.direction == TURN:
            raise _refused(network, index, f"{where}: the route turns back", "give a route that continues")
        if link.state in STOPS:
            raise _refused(network, index, f"{where} has {STOPS[link.state]}", "give a route without crossings")
    crossing = next(_crossings(network, junction, links), None)
    if crossing is not None:
        message = (
            f"{where} is a crossing: {crossing} crosses the way from {shown(links[0].begin, 80)} to {shown(links[0].end, 80)}"
        )
        raise _refused(network, index, message, "give a route along a motorway or a road without crossings")


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


def _refused(network: Network, index: int, message: str, remedy: str) -> InvalidInputError:
    return InvalidInputError(Problem(f"route[{index}]", f"{network.name}: {message}", remedy))
