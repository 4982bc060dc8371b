"""What must hold before a process can be part of a cluster, said in a sentence where Ray would say it in a page or not at all."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

from drivecal.cluster.settings import OBJECT_STORE_BYTES
from drivecal.domain.errors import ConflictError, InvalidInputError, Problem

SHORTEST_TOKEN = 16
"""Characters."""
SHARED_MEMORY = Path("/dev/shm")  # noqa: S108  # where Linux keeps it
TOKEN_REMEDY = "deploy/secrets.sh makes it; it is the same on all machines of the cluster"  # noqa: S105  # how to get one


def check_token(environment: Mapping[str, str]) -> None:
    """Raises InvalidInputError where there is no token to show; without tokens anybody who reaches a node could run code on it, so that
    has to be asked for (`RAY_AUTH_MODE=disabled`)."""
    path = environment.get("RAY_AUTH_TOKEN_PATH")
    if environment.get("RAY_AUTH_MODE") == "disabled" or (not path and environment.get("RAY_AUTH_TOKEN")):
        return
    if not path:
        raise InvalidInputError(
            Problem("RAY_AUTH_TOKEN_PATH", "the cluster's token is missing", f"name its file; {TOKEN_REMEDY}")
        )
    try:
        token = Path(path).read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is no text"
        message = f"the cluster's token cannot be read from {path}: {reason}"
        raise InvalidInputError(Problem("RAY_AUTH_TOKEN_PATH", message, TOKEN_REMEDY)) from None
    if len(token) < SHORTEST_TOKEN:
        message = f"the cluster's token in {path} has {len(token)} characters, {SHORTEST_TOKEN} are the least"
        raise InvalidInputError(Problem("RAY_AUTH_TOKEN_PATH", message, TOKEN_REMEDY))


def check_shared_memory(folder: Path = SHARED_MEMORY) -> None:
    """Raises ConflictError where there is less than Ray needs; it would use files instead, and say so in a log that nobody reads."""
    try:
        free = shutil.disk_usage(folder).free
    except OSError:
        return  # no Linux
    if free < OBJECT_STORE_BYTES:
        raise ConflictError(
            f"there are {free // 2**20} MB of shared memory in {folder}, and Ray needs {OBJECT_STORE_BYTES // 2**20};"
            " give the container more (shm_size: 128m, or docker run --shm-size=128m)"
        )


def version_gap(theirs: str | None, address: str) -> str | None:
    """What to say, naming both, where a head has another drivecal than this process; None where it has the same, or does not say. Such a
    node joins all the same: it gets no work, and the coordinator can tell who asks why."""
    ours = version("drivecal")
    if theirs in {None, ours}:
        return None
    return (
        f"this node has drivecal {ours} and the head at {address} has {theirs}: a coordinator of another release gives it no work;"
        " install the same release on both"
    )
