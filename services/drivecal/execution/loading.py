"""Which setup each worker has loaded, and which it is to take next. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping

from drivecal.execution.outstanding import SetupKey


class LoadedSetups:
    """A worker has loaded what it was sent last."""

    def __init__(self) -> None:
        self._last: dict[str, SetupKey] = {}
        self._workers: Counter[SetupKey] = Counter()
        """How many have loaded each."""

    def meet(self, ready: Collection[str]) -> None:
        """Tells which workers live."""
        for gone in self._last.keys() - set(ready):
            self._unload(gone)

    def load(self, worker: str, setup: SetupKey) -> None:
        """A worker is sent cells of a setup."""
        self._unload(worker)
        self._last[worker] = setup
        self._workers[setup] += 1

    def choose(self, worker: str, to_do: Mapping[SetupKey, float]) -> SetupKey | None:
        """Of setups, with the seconds that there are to do: the one that the worker has loaded, or the one with most to do for each
        worker that is at it. Where nobody is at a setup, one of several who are at the same moves there, so that none is left to the
        end and then to a single worker."""
        last = self._last.get(worker)
        if last is not None and last in to_do and (self._workers[last] == 1 or all(self._workers[setup] for setup in to_do)):
            return last
        return max(to_do, key=lambda setup: to_do[setup] / (self._workers[setup] or 1e-9), default=None)

    def _unload(self, worker: str) -> None:
        last = self._last.pop(worker, None)
        if last is not None:
            self._workers[last] -= 1
            if not self._workers[last]:
                del self._workers[last]
