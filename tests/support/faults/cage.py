"""Runs one command so that none of its descendants can get lost: `python cage.py COMMAND...`.

The cage is a child subreaper (Linux): a process whose parent was killed becomes the cage's child, so the cage finds
all descendants of the command by parentage, orphans included. It ends with the command's exit code once no descendant is left. If its
own parent dies, its standard input ends, and it kills all descendants. Standard library only.
"""

import ctypes
import os
import select
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

PR_SET_CHILD_SUBREAPER = 36
LOOK_SECONDS = 0.05


def descendants(process: int) -> list[int]:
    """All processes below `process`, in no order."""
    parents: dict[int, list[int]] = {}
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            # pid (name) state ppid ...; the name may hold anything
            parent = int(entry.read_text(errors="replace").rpartition(")")[2].split()[1])
        except OSError:
            continue
        parents.setdefault(parent, []).append(int(entry.parent.name))
    result, left = [], [process]
    while left:
        children = parents.get(left.pop(), [])
        result += children
        left += children
    return result


def main(command: list[str]) -> int:
    """Runs `command` in the cage."""
    if ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0) != 0:
        raise OSError("this system has no child subreapers; the fault suite needs Linux")
    first = subprocess.Popen(command, stdin=subprocess.DEVNULL)
    code = 0
    watched = True
    while True:
        try:
            pid, status = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return code
        if pid == first.pid:
            code = os.waitstatus_to_exitcode(status)
        elif pid == 0:
            ready, _, _ = select.select([0] if watched else [], [], [], LOOK_SECONDS)
            if ready and not os.read(0, 4096):
                watched = False
        if not watched:
            for descendant in descendants(os.getpid()):
                with suppress(ProcessLookupError):
                    os.kill(descendant, signal.SIGKILL)
            time.sleep(0.01)


if __name__ == "__main__":
    result = main(sys.argv[1:])
    sys.exit(128 - result if result < 0 else result)
