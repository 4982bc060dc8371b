"""The setup that each worker has loaded, the setups that it knows, and the setup to take next. Pure.

The more runs of a setup a worker has seen, the more cells it can certify. So a worker returns to the setups that it has run most of; it
takes other setups only if it has none of its own to do. Setups in which nothing but failures came back take turns, so that a campaign
without any result shows that soon in all its scenarios.
"""

from collections import Counter
from collections.abc import Collection, Mapping

from drivecal.contracts.work import SetupKey

MOST_KNOWN = 10_000
"""Setups with remembered workers; a study of vehicle parameters uses hundreds, for some seconds each."""
OWN_SHARE = 0.5
"""A setup is a worker's own if the worker got at least this share of the cells of the worker that got most."""


class SetupAffinity:
    """Tracks the last setup of each worker, which is the loaded one, and the number of cells of each setup that each worker got."""

    def __init__(self) -> None:
        self._last: dict[str, SetupKey] = {}
        self._workers: Counter[SetupKey] = Counter()
        """Number of workers that have loaded a setup."""
        self._cells: dict[SetupKey, Counter[str]] = {}
        """Cells by worker."""
        self._most: dict[SetupKey, int] = {}
        """Cells of the worker that got most."""
        self._failed: dict[SetupKey, int] = {}
        """Failed cells of setups without a result."""
        self._fruitful: set[SetupKey] = set()
        """Setups with a result."""

    def meet(self, ready: Collection[str]) -> None:
        """Forgets workers that are gone."""
        gone = self._last.keys() - set(ready)
        for worker in gone:
            self._unload(worker)
            for setup, cells in self._cells.items():
                if cells.pop(worker, None) is not None:
                    self._most[setup] = max(cells.values(), default=0)

    def load(self, worker: str, setup: SetupKey, cells: int = 1) -> None:
        """Notes that a worker gets cells of a setup."""
        self._unload(worker)
        self._last[worker] = setup
        self._workers[setup] += 1
        counted = self._cells.setdefault(setup, Counter())
        counted[worker] += cells
        self._most[setup] = max(self._most.get(setup, 0), counted[worker])
        if len(self._cells) > MOST_KNOWN:
            oldest = next(iter(self._cells))
            del self._cells[oldest], self._most[oldest]
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
        """Whether all cells of a setup that came back have failed."""
        return setup in self._failed

    def choose(self, worker: str, to_do: Mapping[SetupKey, float]) -> SetupKey | None:
        """Returns the setup to take next of those with seconds `to_do`; None without any.

        Setups without a result come after those with fewer failures. Otherwise a worker stays with the loaded setup if it is its own, or
        takes the setup with the most seconds per worker at it, among its own setups, or among all if it has no own setup to do. A setup
        that no worker knows is everybody's own. If no worker is at a setup, one of several workers at another setup moves there, so that
        no setup is left to the end and to a single worker.
        """
        least = min((self._failed.get(setup, 0) for setup in to_do), default=0)
        to_do = {setup: seconds for setup, seconds in to_do.items() if self._failed.get(setup, 0) == least}
        own = [setup for setup in to_do if self._owns(worker, setup)]
        able = own or to_do
        last = self._last.get(worker)
        if last is not None and last in able and (self._workers[last] == 1 or all(self._workers[setup] for setup in to_do)):
            return last
        return max(able, key=lambda setup: to_do[setup] / (self._workers[setup] or 1e-9), default=None)

    def owners(self, setup: SetupKey) -> list[str]:
        """Returns the workers whose own setup this is; none if no worker knows it."""
        return [worker for worker in self._cells.get(setup, ()) if self._owns(worker, setup)]

    def _owns(self, worker: str, setup: SetupKey) -> bool:
        return self._cells.get(setup, Counter())[worker] >= OWN_SHARE * self._most.get(setup, 0)

    def _unload(self, worker: str) -> None:
        last = self._last.pop(worker, None)
        if last is not None:
            self._workers[last] -= 1
            if not self._workers[last]:
                del self._workers[last]
