"""Placement of workers on the nodes of a cluster: one per CPU up to the limit, never on another version. Pure."""

from collections import Counter
from collections.abc import Collection, Sequence

from drivecal.cluster.members import Node


def missing(nodes: Sequence[Node], placed: Collection[str], most: int | None, version: str) -> list[Node]:
    """Returns the nodes of the workers to add, in order, one entry per worker.

    `placed`: node ids of the existing workers. `most`: number of all workers; None is one per CPU. The next worker goes to the node with
    the fewest, so that few workers are spread over many nodes.
    """
    room = {node.id: node.cpus for node in nodes if fits(node, version)}
    by_id = {node.id: node for node in nodes}
    taken = Counter(identifier for identifier in placed if identifier in room)
    added: list[Node] = []
    while most is None or taken.total() < most:
        free = [identifier for identifier, cpus in room.items() if taken[identifier] < cpus]
        if not free:
            break
        chosen = min(free, key=lambda identifier: taken[identifier])
        taken[chosen] += 1
        added.append(by_id[chosen])
    return added


def fits(node: Node, version: str) -> bool:
    """Returns whether a node has the coordinator's version of drivecal (`release()`), or an unknown version."""
    return node.version in {None, version}


def complaint(nodes: Sequence[Node], version: str, cluster: str) -> str | None:
    """Returns a message about unusable nodes, or None."""
    working = [node for node in nodes if node.cpus > 0]
    others = [node for node in working if not fits(node, version)]
    if others:
        listed = ", ".join(f"{node.name} has drivecal {node.version}" for node in others[:3])
        return (
            f"{len(others)} of {len(working)} nodes get no work, for they are of another version than the coordinator"
            f" ({version}): {listed}; install the same release on both"
        )
    return None if working else f"{cluster} has no node with workers; start some, and they get work at once"
