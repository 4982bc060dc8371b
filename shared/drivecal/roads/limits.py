"""Speed limits of lanes: by place along a lane, and those that a file leaves out.

A lane whose limit changes, or is not known, has them as `Lane.limits`; SUMO's cars keep one limit per lane, the first.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.roads import Floats
from drivecal.roads.network import Lane, Network

FIELD = "default_limit"
"""Field of a scenario: the limit (m/s) of lanes without one."""
MOST_NAMED = 5
"""Roads that a refusal names."""


def unlimited(network: Network) -> tuple[str, ...]:
    """Returns the ids of lanes that begin without a limit: SUMO's cars would keep netconvert's default there."""
    return tuple(
        f"{lane.edge}_{lane.index}"
        for edge in network.edges.values()
        for lane in edge.lanes
        if lane.limits is not None and np.isnan(lane.limits[0, 1])
    )


def limited(network: Network, default_limit: float | None) -> Network:
    """Returns the network with a limit (m/s) where lanes have none; the same if there is no such limit."""
    if default_limit is None:
        return network
    edges = {
        name: replace(edge, lanes=tuple(_limited(lane, default_limit) for lane in edge.lanes))
        if any(_is_open(lane) for lane in edge.lanes)
        else edge
        for name, edge in network.edges.items()
    }
    return replace(network, edges=edges)


def check_limits(network: Network, lanes: Iterable[Lane]) -> None:
    """Raises InvalidInputError with the field `default_limit`, naming their roads, if lanes have no limit."""
    bare = [lane for lane in lanes if _is_open(lane)]
    if bare:
        roads = dict.fromkeys(_road(lane) for lane in bare if lane.origin) or {_road(lane): None for lane in bare}
        named = ", ".join(shown(road, 60) for road in list(roads)[:MOST_NAMED])
        more = f" and {len(roads) - MOST_NAMED} more" if len(roads) > MOST_NAMED else ""
        message = f"{network.name}: lanes of the route have no speed limit: road {named}{more}"
        raise InvalidInputError(Problem(FIELD, message, f"give {FIELD}, in m/s, or limits in the file"))


def limits_at(lane: Lane, shares: Floats) -> Floats:
    """Returns the limit (m/s) at each share of a lane's length."""
    if lane.limits is None:
        return np.full(len(shares), lane.limit)
    rows = np.searchsorted(lane.limits[:, 0], shares + 1e-9, side="right") - 1
    return np.asarray(lane.limits[np.maximum(rows, 0), 1])


def _is_open(lane: Lane) -> bool:
    return lane.limits is not None and bool(np.isnan(lane.limits[:, 1]).any())


def _limited(lane: Lane, default_limit: float) -> Lane:
    if lane.limits is None or not _is_open(lane):
        return lane
    limits = np.column_stack([lane.limits[:, 0], np.nan_to_num(lane.limits[:, 1], nan=default_limit)])
    return replace(lane, limit=float(limits[0, 1]), limits=limits)


def _road(lane: Lane) -> str:
    """Returns the id of the road of the OpenDRIVE file, the edge if it is not known."""
    return (lane.origin or "").split(" ")[0].rpartition("_")[0] or lane.edge
