"""Processes and their descent. Imports almost nothing, because the guardian of every process needs it."""

import ctypes
import sys
from collections.abc import Iterator
from pathlib import Path

PR_SET_PDEATHSIG = 1


def processes() -> Iterator[tuple[int, str, list[str]]]:
    """Yields id, name, and the fields from the state on (proc(5)) of every process; nothing on systems without /proc."""
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            # pid (name) state ppid pgrp session ...; the name may contain any character
            head, _, rest = entry.read_text(errors="replace").rpartition(")")
        except OSError:
            continue
        yield int(entry.parent.name), head.partition("(")[2], rest.split()


def end_with_parent(number: int) -> None:
    """Sends signal `number` to this process when its parent is gone, for any reason (Linux only). Call it in the child, before exec."""
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, number)
