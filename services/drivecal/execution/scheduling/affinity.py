"""Which setup each worker has loaded, and which it is to take next. Pure.

A worker remembers what it has simulated, and can answer more of a setup without a simulation the more of it it has seen (certificates). So
each setup has a home, the worker that was the first to take it, and others take it only where they have nothing of their own to do.
"""

from collections import Counter
from collections.abc import Collection, Mapping

from drivecal.execution.scheduling.in_flight import SetupKey

MOST_HOMES = 10_000
"""Setups; studies of vehicle parameters go through hundreds, each used for some seconds."""


class SetupAffinity:
    """A worker has loaded what it was sent last."""

    def __init__(self) -> None:
        self._last: dict[str, SetupKey] = {}
        self._workers: Counter[SetupKey] = Counter()
        """How many have loaded each."""
        self._home: dict[SetupKey, str] = {}

    def meet(self, ready: Collection[str]) -> None:
        """Tells which workers live."""
        gone = self._last.keys() - set(ready)
        for worker in gone:
            self._unload(worker)
        if gone:
            self._home = {setup: worker for setup, worker in self._home.items() if worker not in gone}

    def load(self, worker: str, setup: SetupKey) -> None:
        """A worker is sent cells of a setup."""
        self._unload(worker)
        self._last[worker] = setup
        self._workers[setup] += 1
        if setup not in self._home:
            self._home[setup] = worker
            if len(self._home) > MOST_HOMES:
                del self._home[next(iter(self._home))]

    def choose(self, worker: str, to_do: Mapping[SetupKey, float]) -> SetupKey | None:
        """Returns the setup that the worker has loaded, or the setup with the most seconds to do per worker at it.

        Prefers setups assigned to this worker or unassigned. If no worker is at a setup, one of several workers at another setup moves
        there, so that no setup is left to the end and to a single worker.
        """
        last = self._last.get(worker)
        if last is not None and last in to_do and (self._workers[last] == 1 or all(self._workers[setup] for setup in to_do)):
            return last
        own = [setup for setup in to_do if self._home.get(setup, worker) == worker]
        return max(own or to_do, key=lambda setup: to_do[setup] / (self._workers[setup] or 1e-9), default=None)

    def _unload(self, worker: str) -> None:
        last = self._last.pop(worker, None)
        if last is not None:
            self._workers[last] -= 1
            if not self._workers[last]:
                del self._workers[last]
