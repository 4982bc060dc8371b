"""Nodes of a cluster, as reported by its head."""

import os
import socket
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from drivecal.cluster.checks import TOKEN_REMEDY
from drivecal.cluster.settings import PORT, VERSION_LABEL
from drivecal.domain.errors import NotAuthorisedError, UnavailableError

ANSWER_SECONDS = 5.0
CONNECT_SECONDS = 3.0


@dataclass(frozen=True, slots=True, order=True)
class Node:
    """A living node. `version`: `release()` of its installed drivecal, None if the node was not started by drivecal."""

    name: str
    id: str
    cpus: int
    version: str | None
    is_head: bool


def members(client: Any, timeout: float = ANSWER_SECONDS) -> tuple[Node, ...]:
    """Returns the nodes that a head (a GcsClient) counts as alive, in a stable order. Raises Ray's exceptions."""
    infos = client.get_all_node_info(timeout=timeout).items()
    return tuple(sorted(_node(id_.hex(), info) for id_, info in infos if info.state == info.ALIVE))


def ask(address: str) -> tuple[Node, ...]:
    """Returns the nodes of the cluster whose head is at `address`, including the head's own.

    Raises UnavailableError if the head does not respond or is still starting, and NotAuthorisedError if it rejects our token.
    """
    _check_port(address)
    import ray  # reads its environment on import, which must wait until a head listens

    core: Any = import_module("ray._raylet")
    core.AuthenticationTokenLoader.instance().reset_cache()  # the file may have changed since the last attempt
    try:
        alive = members(core.GcsClient(address=address))
    except ray.exceptions.AuthenticationError as error:
        source = os.environ.get("RAY_AUTH_TOKEN_PATH") or "RAY_AUTH_TOKEN"
        raise NotAuthorisedError(f"the head at {address} does not accept the token in {source}; {TOKEN_REMEDY}") from error
    except Exception as error:
        reason = (str(error).strip().splitlines() or [type(error).__name__])[-1]
        raise UnavailableError(f"the head at {address} does not answer: {reason[:300]}") from error
    if not any(node.is_head for node in alive):
        raise UnavailableError(f"the head at {address} is still starting")
    return alive


def _check_port(address: str) -> None:
    """Raises UnavailableError at once if the port is closed; Ray takes most of a minute to notice."""
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), CONNECT_SECONDS).close()
    except ValueError:
        raise UnavailableError(f"{address!r} is not the address of a head; give HOST:PORT, e.g. ray-head:{PORT}") from None
    except OSError as error:
        raise UnavailableError(f"the head at {address} does not answer: {error.strerror or error}") from error


def _node(identifier: str, info: Any) -> Node:
    return Node(
        name=info.node_manager_hostname,
        id=identifier,
        cpus=int(info.resources_total.get("CPU", 0)),
        version=info.labels.get(VERSION_LABEL, "") or None,
        is_head=info.is_head_node,
    )
