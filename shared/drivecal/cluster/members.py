"""Nodes of a cluster, as reported by its head, and the checks of a node before it joins."""

import os
import shutil
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from drivecal.cluster.settings import OBJECT_STORE_BYTES, VERSION_LABEL, host_and_port
from drivecal.domain.errors import ConflictError, InvalidInputError, NotAuthorisedError, Problem, UnavailableError

SHORTEST_TOKEN = 16
"""Fewest characters of a token."""
SHARED_MEMORY = Path("/dev/shm")  # noqa: S108  # of Linux
TOKEN_REMEDY = "deploy/secrets.sh makes it; it is the same on all machines of the cluster"  # noqa: S105  # not a token


def check_token(environment: Mapping[str, str]) -> None:
    """Raises InvalidInputError if the token is missing, unreadable or too short.

    Without tokens, every host that reaches a node can run code on it. Set `RAY_AUTH_MODE=disabled` to accept that.
    """
    path, token = environment.get("RAY_AUTH_TOKEN_PATH"), environment.get("RAY_AUTH_TOKEN")
    if environment.get("RAY_AUTH_MODE") == "disabled":
        return
    if not path and not token:
        raise InvalidInputError(Problem("RAY_AUTH_TOKEN_PATH", "its token is missing", f"name its file; {TOKEN_REMEDY}"))
    try:
        token = Path(path).read_text(encoding="ascii").strip() if path else token or ""
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not text"
        message = f"the cluster's token cannot be read from {path}: {reason}"
        raise InvalidInputError(Problem("RAY_AUTH_TOKEN_PATH", message, TOKEN_REMEDY)) from None
    if len(token) < SHORTEST_TOKEN:
        message = f"the cluster's token{f' in {path}' if path else ''} has {len(token)} characters; it needs at least {SHORTEST_TOKEN}"
        raise InvalidInputError(Problem("RAY_AUTH_TOKEN_PATH" if path else "RAY_AUTH_TOKEN", message, TOKEN_REMEDY))


def check_shared_memory(folder: Path = SHARED_MEMORY) -> None:
    """Raises ConflictError if less shared memory is free than Ray needs; Ray would silently use files instead."""
    try:
        free = shutil.disk_usage(folder).free
    except OSError:
        return  # not Linux
    if free < OBJECT_STORE_BYTES:
        raise ConflictError(
            f"there are {free // 2**20} MB of shared memory in {folder}, and Ray needs {OBJECT_STORE_BYTES // 2**20};"
            " give the container more (shm_size: 128m, or docker run --shm-size=128m)"
        )


ANSWER_SECONDS = 5.0
CONNECT_SECONDS = 3.0


@dataclass(frozen=True, slots=True, order=True)
class Node:
    """A living node. `version`: `release()` of its installed drivecal, None if the node was not started by drivecal. A coordinator of
    another one gives it no work, and says why."""

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

    Raises UnavailableError if the head does not respond or is still starting, NotAuthorisedError if it rejects our token, and
    InvalidInputError for text that is no address.
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
    try:
        place = host_and_port(address)
    except ValueError as error:
        raise InvalidInputError(Problem("HOST:PORT", str(error))) from None
    try:
        socket.create_connection(place, CONNECT_SECONDS).close()
    except (OSError, UnicodeError) as error:
        raise UnavailableError(f"the head at {address} does not answer: {getattr(error, 'strerror', None) or error}") from error


def _node(identifier: str, info: Any) -> Node:
    return Node(
        name=info.node_manager_hostname,
        id=identifier,
        cpus=int(info.resources_total.get("CPU", 0)),
        version=info.labels.get(VERSION_LABEL, "") or None,
        is_head=info.is_head_node,
    )
