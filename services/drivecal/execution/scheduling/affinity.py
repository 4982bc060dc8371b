"""The setups that each worker has loaded, and the setup to take next. Pure.

Loading a setup takes time: a simulator starts, kernels are compiled, roads are read. So a worker stays with its setup, and returns to
setups that it has loaded before. Setups with failures alone take turns, so that a campaign without any result shows that soon in all its
scenarios.
"""

from collections import Counter
from collections.abc import Collection, Mapping

from drivecal.contracts.work import SetupKey

MOST_KNOWN = 10_000
"""Setups with remembered workers or failures; a study of vehicle parameters uses hundreds, for some seconds each."""


class SetupAffinity:
    """Tracks the setups that each worker has loaded; the last is its current setup."""

    def __init__(self) -> None:
        self._last: dict[str, SetupKey] = {}
        self._workers: Counter[SetupKey] = Counter()
        """Number of workers at a setup."""
        self._loaded: dict[SetupKey, set[str]] = {}
        """Workers that have loaded a setup."""
        self._failed: dict[SetupKey, int] = {}
        """Failed cells of setups without a result."""
        self._fruitful: set[SetupKey] = set()
        """Setups with a result."""

    def meet(self, ready: Collection[str]) -> None:
        """Forgets workers that are gone."""
        gone = self._last.keys() - set(ready)
        for worker in gone:
            self._leave(worker)
        if gone:
            for workers in self._loaded.values():
                workers -= gone

    def load(self, worker: str, setup: SetupKey) -> None:
        """Notes that a worker gets cells of a setup."""
        self._leave(worker)
        self._last[worker] = setup
        self._workers[setup] += 1
        self._loaded.setdefault(setup, set()).add(worker)
        if len(self._loaded) > MOST_KNOWN:
            oldest = next(iter(self._loaded))
            del self._loaded[oldest]
            self._failed.pop(oldest, None)
            self._fruitful.discard(oldest)

    def came_back(self, setup: SetupKey, *, failed: bool) -> None:
        """Notes a cell that has failed, or has a result."""
        if not failed:
            self._fruitful.add(setup)
            self._failed.pop(setup, None)
        elif setup not in self._fruitful:
            self._failed[setup] = self._failed.get(setup, 0) + 1

    def is_fruitless(self, setup: SetupKey) -> bool:
        """Returns whether all cells of a setup that came back have failed."""
        return setup in self._failed

    def choose(self, worker: str, to_do: Mapping[SetupKey, float]) -> SetupKey | None:
        """Returns the setup to take next of those with seconds `to_do`; None without any.

        Setups without a result come after setups with fewer failures. Otherwise a worker stays at its setup, or takes the setup with the
        most seconds per worker at it. It prefers setups that it has loaded, or that no worker has loaded. If no worker is at a setup, one
        of several workers at another setup moves there: no setup is left to the end and to a single worker.
        """
        least = min((self._failed.get(setup, 0) for setup in to_do), default=0)
        to_do = {setup: seconds for setup, seconds in to_do.items() if self._failed.get(setup, 0) == least}
        last = self._last.get(worker)
        if last in to_do and (self._workers[last] == 1 or all(self._workers[setup] for setup in to_do)):
            return last
        near = [setup for setup in to_do if worker in (workers := self._loaded.get(setup, ())) or not workers]
        return max(near or to_do, key=lambda setup: to_do[setup] / (self._workers[setup] or 1e-9), default=None)

    def _leave(self, worker: str) -> None:
        last = self._last.pop(worker, None)
        if last is not None:
            self._workers[last] -= 1
            if not self._workers[last]:
                del self._workers[last]
