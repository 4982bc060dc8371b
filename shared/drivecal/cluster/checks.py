"""Checks that a process passes before it joins a cluster. Their messages are one sentence; Ray's are a page long or missing."""

import shutil
from collections.abc import Mapping
from pathlib import Path

from drivecal.cluster.settings import OBJECT_STORE_BYTES, release
from drivecal.domain.errors import ConflictError, InvalidInputError, Problem

SHORTEST_TOKEN = 16
"""Fewest characters of a token."""
SHARED_MEMORY = Path("/dev/shm")  # noqa: S108  # of Linux
TOKEN_REMEDY = "deploy/secrets.sh makes it; it is the same on all machines of the cluster"  # noqa: S105  # not a token


def check_token(environment: Mapping[str, str]) -> None:
    """Raises InvalidInputError if the token is missing, unreadable or too short.

    Without tokens, every host that reaches a node can run code on it. Set `RAY_AUTH_MODE=disabled` to accept that.
    """
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
        reason = getattr(error, "strerror", None) or "it is not text"
        message = f"the cluster's token cannot be read from {path}: {reason}"
        raise InvalidInputError(Problem("RAY_AUTH_TOKEN_PATH", message, TOKEN_REMEDY)) from None
    if len(token) < SHORTEST_TOKEN:
        message = f"the cluster's token in {path} has {len(token)} characters; it needs at least {SHORTEST_TOKEN}"
        raise InvalidInputError(Problem("RAY_AUTH_TOKEN_PATH", message, TOKEN_REMEDY))


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


def version_gap(theirs: str | None, address: str) -> str | None:
    """Returns a message naming both versions if the head's drivecal differs from ours; None if it is equal or unknown.

    A node of another version joins but gets no work, and the coordinator reports why.
    """
    ours = release()
    if theirs in {None, ours}:
        return None
    return (
        f"this node has drivecal {ours} and the head at {address} has {theirs}: a coordinator of another release gives it no work;"
        " install the same release on both"
    )
