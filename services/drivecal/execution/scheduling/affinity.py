"""The setup that each worker has loaded, and the setup to take next. Pure.

The more runs of a setup a worker has seen, the more cells it can certify. So each setup has a home, the first worker that took it; other
workers take it only if they have nothing of their own to do.
"""

from collections import Counter
from collections.abc import Collection, Mapping

from drivecal.execution.scheduling.in_flight import SetupKey

MOST_HOMES = 10_000
"""Setups with a remembered home; a study of vehicle parameters uses hundreds, for some seconds each."""


class SetupAffinity:
    """Tracks the last setup of each worker, which is the loaded one."""

    def __init__(self) -> None:
        self._last: dict[str, SetupKey] = {}
        self._workers: Counter[SetupKey] = Counter()
        """Number of workers that have loaded a setup."""
        self._home: dict[SetupKey, str] = {}

    def meet(self, ready: Collection[str]) -> None:
        """Forgets workers that are gone."""
        gone = self._last.keys() - set(ready)
        for worker in gone:
            self._unload(worker)
        if gone:
            self._home = {setup: worker for setup, worker in self._home.items() if worker not in gone}

    def load(self, worker: str, setup: SetupKey) -> None:
        """Notes that a worker gets cells of a setup."""
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
