"""Signs of life: a process writes them to a pipe every second; the process that started it measures their absence.

A pipe works while the database is away, and tells a stopped process from a busy one: only `/proc` knows whether its threads run.
"""

import os
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

VARIABLE = "DRIVECAL_PULSE"
"""Environment variable: the descriptor of the pipe of a process that a supervisor started."""
EVERY_SECONDS = 1.0
SILENT_SECONDS, IDLE_SECONDS = 10.0, 6.0
"""Time without a sign after which a process counts as hung: 10 s for a process elsewhere; 6 s here, if all its threads are asleep."""
BUSY_SECONDS = 90.0
"""The same for a process that computes: a long call may hold Python's interpreter."""
START_SECONDS = 300.0
"""The same before the first sign."""
LOOKS = 3
"""Looks in succession at which no thread may run."""


def show(descriptor: int) -> None:
    """Writes a sign to `descriptor` every second from a thread, for as long as this process lives."""
    os.set_inheritable(descriptor, False)
    os.set_blocking(descriptor, False)
    threading.Thread(target=_show, args=(descriptor,), name="pulse", daemon=True).start()


def take_descriptor() -> int | None:
    """Returns the descriptor of this process's pipe, None without a supervisor. Takes it out of the environment."""
    given = os.environ.pop(VARIABLE, None)
    return None if given is None else int(given)


def sign(descriptor: int) -> bool:
    """Writes a sign; returns whether its reader still exists. A full pipe is no fault: its reader is busy."""
    try:
        os.write(descriptor, b"%d\n" % os.getpid())
    except BlockingIOError:
        return True
    except OSError:
        return False
    return True


def _show(descriptor: int) -> None:
    while sign(descriptor):
        time.sleep(EVERY_SECONDS)


class Silence:
    """Time without a sign, as far as this process looked: pauses of this process or of the machine do not count."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._looked_at = clock()
        self._seconds = 0.0
        self._idle_looks = 0
        self._has_begun = False

    def is_too_long(self, process: int | None, *, heard: bool) -> bool:
        """Looks again; returns whether the process is to be replaced. Call it a few times a second.

        Args:
            process: its number; None if it is on another machine, where nothing is known of its threads.
            heard: there was a sign since the last look.
        """
        before, self._looked_at = self._looked_at, self._clock()
        self._has_begun = self._has_begun or heard
        self._seconds = 0.0 if heard else self._seconds + min(self._looked_at - before, EVERY_SECONDS)
        if not self._has_begun:
            return self._seconds >= START_SECONDS
        if self._seconds < (SILENT_SECONDS if process is None else IDLE_SECONDS):
            self._idle_looks = 0
            return False
        self._idle_looks = self._idle_looks + 1 if process is None or is_idle(process) else 0
        return self._idle_looks >= LOOKS or self._seconds >= BUSY_SECONDS


class Pipe:
    """The reading end of a process's signs. `writer` is for the process."""

    def __init__(self) -> None:
        self._reader, self.writer = os.pipe2(os.O_CLOEXEC)
        os.set_blocking(self._reader, False)
        self._silence = Silence()
        self.process = -1
        """Number of the process, once there was a sign."""

    def is_silent(self) -> bool:
        """Returns whether the process is to be replaced, see `Silence`."""
        received = b""
        with suppress(BlockingIOError):
            received = os.read(self._reader, 65536)
        if received:
            self.process = int(received.split()[-1])
        return self._silence.is_too_long(self.process, heard=bool(received))

    def close(self) -> None:
        """Closes both ends."""
        for descriptor in (self._reader, self.writer):
            os.close(descriptor)


def is_idle(process: int) -> bool:
    """Returns whether a process has ended, or none of its threads runs or waits for a disk. False if the system does not say."""
    try:
        stats = [path.read_bytes() for path in Path(f"/proc/{process}/task").glob("*/stat")]
    except OSError:
        return False
    states = {stat.rpartition(b")")[2].split()[0] for stat in stats}
    return not states & {b"R", b"D"} if states else Path("/proc/self").exists()
