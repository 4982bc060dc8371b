"""Deadlines on a busy machine: processor time of other processes does not count."""

import os
import time
from collections.abc import Callable, Sequence
from contextlib import suppress

import psutil

LOOK_SECONDS = 0.2

Family = Callable[[], Sequence[psutil.Process]]


class Patience:
    """Counts the seconds while the processors worked for `family` or idled: at most the time on a machine without other work. It
    counts the last work of a process that has ended as other work."""

    def __init__(self, seconds: float, family: Family) -> None:
        self._seconds = seconds
        self._family = family
        self._begin = self._looked = time.monotonic()
        self._spent = 0.0
        self._busy = _busy_seconds()
        self._known = self._work()

    @property
    def over(self) -> bool:
        """Returns whether `seconds` have been spent."""
        return self.spent() > self._seconds

    def spent(self) -> float:
        """Returns the seconds so far, without the work of other processes."""
        now = time.monotonic()
        if now - self._looked < LOOK_SECONDS:
            return self._spent
        busy, known = _busy_seconds(), self._work()
        own = sum(max(0.0, seconds - self._known.get(process, 0.0)) for process, seconds in known.items())
        others = max(0.0, busy - self._busy - own) / (os.cpu_count() or 1)
        self._spent += max(0.0, now - self._looked - others)
        self._looked, self._busy, self._known = now, busy, known
        return self._spent

    def told(self) -> str:
        """How long it has been, in words."""
        return f"{time.monotonic() - self._begin:.1f} s ({self.spent():.1f} without other processes)"

    def _work(self) -> dict[tuple[int, float], float]:
        """Seconds that each process of the family has worked."""
        result = {}
        for process in self._family():
            with suppress(psutil.NoSuchProcess):
                times = process.cpu_times()
                result[process.pid, process.create_time()] = times.user + times.system
        return result


def _busy_seconds() -> float:
    """Checks that all processors together have worked for anybody, or were taken away by the host."""
    times = psutil.cpu_times()
    return float(times.user + times.nice + times.system + times.irq + times.softirq + times.steal)
