"""How many cells go into one batch: enough to make the overhead of a call negligible, few enough that workers finish together."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Hashable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class BatchPolicy:
    """The sizes aimed at. A Ray call costs about 1 ms all told, so batches of 250 ms lose less than 1 % to it."""

    target_seconds: float = 0.25
    shortest_seconds: float = 0.02
    """Batches shrink to this towards the end of the queue."""
    largest: int = 64
    """Cells."""


class CellCosts:
    """Seconds per cell of each setup, measured. The lower median of the last few batches counts: compiling, loading a scenario and
    a busy machine make single batches too slow, nothing makes one too fast."""

    def __init__(self, remembered: int = 7) -> None:
        self._remembered = remembered
        self._measured: dict[Hashable, deque[float]] = {}

    def observe(self, setup: Hashable, cells: int, seconds: float) -> None:
        """Takes in one finished batch."""
        self._measured.setdefault(setup, deque(maxlen=self._remembered)).append(max(seconds, 1e-6) / cells)

    def seconds_per_cell(self, setup: Hashable) -> float | None:
        """What a cell of this setup costs; None before the first measurement."""
        measured = self._measured.get(setup)
        return sorted(measured)[(len(measured) - 1) // 2] if measured else None


def batch_size(policy: BatchPolicy, seconds_per_cell: float | None, waiting_seconds: float, workers: int) -> int:
    """Cells for the next batch: `target_seconds` worth, but no more than half a worker's share of what still waits (guided
    self-scheduling), and one as a probe where nothing is known yet."""
    if seconds_per_cell is None:
        return 1
    share = max(waiting_seconds / (2 * max(workers, 1)), policy.shortest_seconds)
    return max(1, min(math.floor(min(policy.target_seconds, share) / seconds_per_cell), policy.largest))
