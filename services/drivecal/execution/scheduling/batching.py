"""Batch sizes: large enough to make the overhead of a call negligible, small enough that workers finish together."""

import math
from collections import deque
from collections.abc import Mapping
from typing import TypeVar

from drivecal.contracts.work import Kind, SetupKey

TARGET_SECONDS = 0.5
"""Time of a batch. For two workers, such batches cost the dispatcher less than 2 % of two cores."""
BESIDE_SMALL_SECONDS = 0.1
"""The same while a small campaign runs, which waits for running batches in each generation. With many workers, it is longer."""
DISPATCH_SECONDS = 0.008
"""The dispatcher's time for a batch without its cells. While a small campaign runs, batches may take half a core of the dispatcher."""
SHORTEST_SECONDS = 0.04
"""Batches shrink to this towards the end of the queue."""
LARGEST = 128
"""Cells per batch."""
MOST_SETUPS = 1_000
"""Setups with remembered costs; a study of vehicle parameters uses hundreds."""
K = TypeVar("K")
V = TypeVar("V")

REMEMBERED = 7
"""Last batches of a setup whose costs count."""


class CellCosts:
    """Measured seconds per cell of each setup: the lower median of the last batches, because compiling, loading a scenario and a busy
    machine slow single batches down. A setup without a measurement costs as much as others of its kind."""

    def __init__(self) -> None:
        self._kinds: dict[SetupKey, Kind] = {}
        self._measured: dict[SetupKey | Kind, deque[float]] = {}
        self._medians: dict[SetupKey | Kind, float] = {}

    def relate(self, setup: SetupKey, kind: Kind) -> None:
        """Notes the kind of a setup."""
        _note(self._kinds, setup, kind)

    def observe(self, setup: SetupKey, cells: int, seconds: float) -> None:
        """Notes the cost of a finished batch."""
        for name in filter(None, (setup, self._kinds.get(setup))):
            measured = self._measured.get(name) or deque(maxlen=REMEMBERED)
            measured.append(max(seconds, 1e-6) / cells)
            _note(self._measured, name, measured)
            _note(self._medians, name, sorted(measured)[(len(measured) - 1) // 2])

    def seconds_per_cell(self, setup: SetupKey) -> float | None:
        """Returns the cost of a cell of this setup; None before the first measurement of its kind."""
        return self._medians.get(setup, self._medians.get(self._kinds.get(setup, ())))

    def seconds(self, cells: Mapping[SetupKey, int]) -> float:
        """Returns the expected cost of cells counted by setup. Setups without a measurement cost the average of the others, or 0."""
        costs = ((count, self.seconds_per_cell(setup)) for setup, count in cells.items())
        known = [(count, cost) for count, cost in costs if cost is not None]
        counted = sum(count for count, _ in known)
        measured = sum(count * cost for count, cost in known)
        return measured / counted * sum(cells.values()) if counted else 0.0


def _note(known: dict[K, V], key: K, value: V) -> None:
    known.pop(key, None)
    known[key] = value  # behind all others
    if len(known) > MOST_SETUPS:
        del known[next(iter(known))]


def batch_size(seconds_per_cell: float | None, waiting_seconds: float, workers: int, *, beside_small: bool) -> int:
    """Returns the size of the next batch: the target's seconds of work, at most half a worker's share of the waiting work (guided
    self-scheduling), and a single cell before the first measurement. `beside_small`: a small campaign needs workers as well."""
    if seconds_per_cell is None:
        return 1
    target = TARGET_SECONDS
    if beside_small:
        target = min(target, max(BESIDE_SMALL_SECONDS, 2 * workers * DISPATCH_SECONDS))
    share = max(waiting_seconds / (2 * max(workers, 1)), SHORTEST_SECONDS)
    return max(1, min(math.floor(min(target, share) / seconds_per_cell), LARGEST))
