"""Runs one command and takes care that nothing of it stays behind: `python -m drivecal.server.guardian GRACE COMMAND...`.

The supervisor starts a guardian for each of its children, in a session of its own, and holds the other end of its standard input.

- The command ends: whatever it left in the session is killed, and the guardian ends with the command's exit code.
- SIGTERM or SIGINT: passed on as SIGTERM; after GRACE seconds everything is killed.
- The supervisor is gone, even by SIGKILL: standard input ends, and everything is killed at once. Results are in the database, and the
  next server must not meet a dispatcher of the last one.
- The guardian itself is killed: on Linux the kernel kills the command with it.

Ray's agents, for one, live on for a minute after their driver was killed. On systems without /proc only the command itself is killed.
Standard library only, so that a guardian is small.
"""

import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from drivecal.cluster.lineage import end_with_parent

_STOPPING = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)


def members(session: int) -> list[int]:
    """The processes of a session, its leader excepted; none on systems without /proc."""
    processes = []
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            # pid (name) state ppid pgrp session ...; the name may hold anything
            fields = entry.read_text(errors="replace").rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[3]) == session and fields[0] != "Z" and int(entry.parent.name) != session:
            processes.append(int(entry.parent.name))
    return processes


def end_session(session: int) -> None:
    """Kills all processes of a session but its leader, those included that are being started meanwhile."""
    for _ in range(100):
        left = members(session)
        for process in left:
            try:
                os.kill(process, signal.SIGKILL)
            except ProcessLookupError:
                continue
        if not left:
            return
        time.sleep(0.01)


def guard(command: Sequence[str], grace: float, keep: Sequence[int] = ()) -> int:
    """Runs `command`, which inherits the file descriptors `keep`, and returns its exit code, 128 + n where signal n ended it."""
    woken, wake = os.pipe()
    os.set_blocking(wake, False)
    signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
    for number in (*_STOPPING, signal.SIGCHLD):
        signal.signal(number, lambda *_: None)
    child = subprocess.Popen(  # noqa: S603  # the supervisor's own commands
        command,
        stdin=subprocess.DEVNULL,
        pass_fds=keep,
        preexec_fn=_die_with_parent,  # noqa: PLW1509  # there are no threads here
    )
    deadline = float("inf")
    while child.poll() is None:
        ready, _, _ = select.select([0, woken], [], [], max(0.0, min(deadline - time.monotonic(), 3600.0)))
        if woken in ready and any(number in _STOPPING for number in os.read(woken, 4096)):
            child.terminate()
            deadline = min(deadline, time.monotonic() + grace)
        if (0 in ready and not os.read(0, 4096)) or time.monotonic() >= deadline:
            child.kill()
            break
    end_session(os.getpid())
    code = child.wait()
    return 128 - code if code < 0 else code


def _die_with_parent() -> None:
    """In the child, before the command: signals as usual, and an end with the guardian."""
    for number in (*_STOPPING, signal.SIGCHLD):
        signal.signal(number, signal.SIG_DFL)
    end_with_parent(signal.SIGKILL)


if __name__ == "__main__":
    _, seconds, descriptors, *words = sys.argv
    sys.exit(guard(words, float(seconds), [int(descriptor) for descriptor in descriptors.split(",") if descriptor]))
