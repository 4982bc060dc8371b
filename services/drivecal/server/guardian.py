"""Runs one command and ends all processes that it leaves behind: `python -m drivecal.server.guardian GRACE COMMAND...`.

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
from contextlib import suppress

from drivecal.cluster.guard import end_with_parent, processes

_STOPPING = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)


def members(session: int) -> list[int]:
    """Returns the processes of a session without its leader; empty on systems without /proc."""
    return [number for number, _, fields in processes() if int(fields[3]) == session != number and fields[0] != "Z"]


def end_session(session: int) -> None:
    """Kills all processes of a session except its leader, including processes that are being started."""
    for _ in range(100):
        left = members(session)
        for process in left:
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        if not left:
            return
        time.sleep(0.01)


def guard(command: Sequence[str], grace: float, keep: Sequence[int] = ()) -> int:
    """Runs `command`, which inherits the file descriptors `keep`. Returns its exit code, or 128 + n after signal n."""
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
    """Restores the default signals in the child and ends it with the guardian."""
    for number in (*_STOPPING, signal.SIGCHLD):
        signal.signal(number, signal.SIG_DFL)
    end_with_parent(signal.SIGKILL)


if __name__ == "__main__":
    _, seconds, descriptors, *words = sys.argv
    sys.exit(guard(words, float(seconds), [int(descriptor) for descriptor in descriptors.split(",") if descriptor]))
