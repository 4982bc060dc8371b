"""Who is in a cluster, as its head says."""

from __future__ import annotations

import os
import socket
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from drivecal.cluster.checks import TOKEN_REMEDY
from drivecal.cluster.settings import PORT, VERSION_LABEL
from drivecal.domain.errors import NotAuthorisedError, UnavailableError

ANSWER_SECONDS = 5.0
KNOCK_SECONDS = 3.0


@dataclass(frozen=True, slots=True, order=True)
class Node:
    """A node that lives. `version`: of the drivecal that is installed there, None where it was started by other means."""

    name: str
    id: str
    cpus: int
    version: str | None
    is_head: bool


def members(client: Any, timeout: float = ANSWER_SECONDS) -> tuple[Node, ...]:
    """The nodes that a head (a GcsClient) counts as alive, in a stable order. Raises what Ray raises."""
    found = client.get_all_node_info(timeout=timeout).items()
    return tuple(sorted(_node(id_.hex(), node) for id_, node in found if node.state == node.ALIVE))


def ask(address: str) -> tuple[Node, ...]:
    """The nodes of the cluster whose head is at `address`, the head's own among them. Raises UnavailableError where nobody answers, or
    not yet, and NotAuthorisedError where our token is not accepted."""
    _knock(address)
    import ray  # reads its environment at import, so not before there is a head to ask

    core: Any = import_module("ray._raylet")
    core.AuthenticationTokenLoader.instance().reset_cache()  # the file may have been mended since the last attempt
    try:
        nodes = members(core.GcsClient(address=address))
    except ray.exceptions.AuthenticationError as error:
        where = os.environ.get("RAY_AUTH_TOKEN_PATH") or "RAY_AUTH_TOKEN"
        raise NotAuthorisedError(f"the head at {address} does not accept the token in {where}; {TOKEN_REMEDY}") from error
    except Exception as error:
        reason = (str(error).strip().splitlines() or [type(error).__name__])[-1]
        raise UnavailableError(f"the head at {address} does not answer: {reason[:300]}") from error
    if not any(node.is_head for node in nodes):
        raise UnavailableError(f"the head at {address} is only starting")
    return nodes


def _knock(address: str) -> None:
    """Raises UnavailableError where nobody listens: Ray would take most of a minute to say so."""
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), KNOCK_SECONDS).close()
    except ValueError:
        raise UnavailableError(f"{address!r} is no address of a head; give HOST:PORT, e.g. ray-head:{PORT}") from None
    except OSError as error:
        raise UnavailableError(f"the head at {address} does not answer: {error.strerror or error}") from error


def _node(identifier: str, node: Any) -> Node:
    return Node(
        name=node.node_manager_hostname,
        id=identifier,
        cpus=int(node.resources_total.get("CPU", 0)),
        version=node.labels.get(VERSION_LABEL, "") or None,
        is_head=node.is_head_node,
    )
