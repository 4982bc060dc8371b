"""Workers for quick cells: no worker is taken from a long batch, so long batches must not hold all workers. Pure.

A cell is long if it takes longer than `LONG_SECONDS`, or was never measured. A campaign whose last cells were not long is quick. While
quick campaigns of the same or a higher priority need workers, the long cells of all campaigns together hold at most their share of them. No
worker is kept for a later campaign: it waits for a long cell at most. A quick campaign with little work at a time is small: while it runs,
the batches of other campaigns are short.
"""

import math
from collections.abc import Collection
from dataclasses import dataclass

from drivecal.execution.scheduling.queue import Line

LONG_SECONDS = 5.0
"""Longest time of a cell that is not long: other cells do not wait long for it."""
REMEMBERED_SECONDS = 5.0
"""Time for which a quick campaign without waiting cells keeps its workers: between two generations, for instance."""
SMALL_SECONDS = 2.0
"""Most work at a time of a small campaign, for each worker: four batches."""


@dataclass(slots=True)
class _Campaign:
    """A campaign's recent cells."""

    is_quick: bool = False
    cells: int = 0
    """Largest number of its cells at a time since it last had none."""
    seconds: float = math.inf
    """Expected work of its new cells since it last had none; infinite if some were never measured."""
    seen: float = 0.0


class Reservation:
    """Decides how many workers long batches may hold, and which campaigns get short batches."""

    def __init__(self) -> None:
        self._campaigns: dict[tuple[int, str], _Campaign] = {}
        self._now = 0.0

    def meet(self, now: float) -> None:
        """Notes the time (s)."""
        self._now = now

    @staticmethod
    def is_long(seconds_per_cell: float | None) -> bool:
        """Returns whether cells of this cost are long; None: never measured."""
        return seconds_per_cell is None or seconds_per_cell > LONG_SECONDS

    def given(self, tag: str, priority: int, seconds: float | None, *, had_none: bool) -> None:
        """Notes new cells of a campaign. `seconds` is their expected work, None if never measured. `had_none`: it had no cells before."""
        known = self._campaigns.setdefault((priority, tag), _Campaign())
        known.seconds = (0.0 if had_none else known.seconds) + (math.inf if seconds is None else seconds)

    def sent(self, line: Line, seconds_per_cell: float | None, cells: int) -> None:
        """Notes a batch of a line; `cells` is the number of its campaign's cells without an answer."""
        known = self._campaigns.setdefault((line.priority, line.tag), _Campaign())
        if self._now - known.seen > REMEMBERED_SECONDS:
            known.cells = 0
        known.cells = max(known.cells, cells)
        self.answered(line, seconds_per_cell)

    def answered(self, line: Line, seconds_per_cell: float | None) -> None:
        """Notes the answer of a batch, unless the campaign is forgotten."""
        known = self._campaigns.get((line.priority, line.tag))
        if known is not None:
            known.is_quick, known.seen = not self.is_long(seconds_per_cell), self._now

    def forget(self, tag: str) -> None:
        """Forgets a campaign."""
        self._campaigns = {place: known for place, known in self._campaigns.items() if place[1] != tag}

    def is_beside_small(self, line: Line, workers: int) -> bool:
        """Returns whether the campaign of `line` is not small, and another one of at least its priority is small and had a batch lately."""
        most = SMALL_SECONDS * workers
        own = self._campaigns.get((line.priority, line.tag))
        return (own is None or own.seconds > most) and any(
            place[0] >= line.priority
            and known.is_quick
            and known.seconds <= most
            and self._now - known.seen <= REMEMBERED_SECONDS
            for place, known in self._campaigns.items()
        )

    def most(self, line: Line, waiting: Collection[Line], workers: int) -> int:
        """Returns how many of `workers` may run long batches, at least one. `line` wants another; `waiting`: lines with waiting cells."""
        waits = {(other.priority, other.tag) for other in waiting}
        quick = {
            place: known
            for place, known in self._campaigns.items()
            if known.is_quick and place[0] >= line.priority and (place in waits or self._now - known.seen <= REMEMBERED_SECONDS)
        }
        if not quick:
            return workers
        long = sum(place[0] >= line.priority and place not in quick for place in waits)
        share = max(1, -(-workers * len(quick) // (len(quick) + max(long, 1))))
        needed = sum(known.cells for known in quick.values())
        return max(1, workers - min(share, needed))
