"""Home folders, databases and secrets of all drivecal servers of this user, so that simulators of one see nothing of the others."""

import contextlib
import fcntl
import os
from collections.abc import Iterable
from pathlib import Path

MOST = 50
"""Number of paths that are remembered; the latest that still exist."""
DATABASE_ENDINGS = ("", "-wal", "-shm", ".lock", ".queue")
"""Endings of the files of an SQLite database."""


def remember(paths: Iterable[Path]) -> None:
    """Adds paths to the user's list. Does nothing if the user has no folder for it."""
    with contextlib.suppress(OSError, RuntimeError):
        file = _file()
        file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        with file.open("a+") as listed:
            fcntl.flock(listed, fcntl.LOCK_EX)
            listed.seek(0)
            added = [str(path.absolute()) for path in paths]
            kept = [line for line in listed.read().splitlines() if line not in added and Path(line).exists()]
            listed.truncate(0)
            listed.write("\n".join([*kept, *added][-MOST:]) + "\n")


def remembered() -> list[Path]:
    """Returns the paths of the list that exist."""
    try:
        with _file().open() as listed:
            fcntl.flock(listed, fcntl.LOCK_SH)  # `remember` empties the file for a moment
            lines = listed.read().splitlines()
    except (OSError, RuntimeError):
        return []
    return [Path(line) for line in lines if Path(line).exists()]


def _file() -> Path:
    return Path(os.environ.get("XDG_STATE_HOME") or "~/.local/state").expanduser() / "drivecal" / "homes"
