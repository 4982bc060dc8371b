"""Durations and failures of the dispatcher's work, counted in memory for `/metrics`.

The dispatcher puts `snapshot` into its heartbeat, and the API exports it. Counters start at zero with the process, as Prometheus
expects. Like a logger, `MEASURES` exists once per process and decides nothing.

    with MEASURES.timed("lease"):
        ...
    MEASURES.observe("batch", result.seconds)
    MEASURES.count("breakdowns", "crash")
"""

import time
from bisect import bisect_left
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal

from drivecal.domain.evaluations import Breakdown

Duration = Literal["lookup", "evaluation", "batch", "lease", "record"]
"""`lookup`: look-up of a round's cells. `evaluation`: CPU time of a cell. `batch`: time of a batch at its worker. `lease`, `record`:
transactions that lease cells and write results."""
Happening = Literal["breakdowns", "retries", "late_results", "busy_answers"]
"""`breakdowns` of cells or workers, by kind. `retries`: cells sent again, by kind. `late_results`: rejected results without a lease.
`busy_answers`: batches that ended because their simulator was busy."""
DEPARTED = "departed"
"""Kind of a breakdown that is no fault of a cell: its worker was killed from outside, or left with its node."""

DURATIONS: tuple[Duration, ...] = ("lookup", "evaluation", "batch", "lease", "record")
KINDS: dict[Happening, tuple[str, ...]] = {
    "breakdowns": (*Breakdown, DEPARTED),
    "retries": tuple(Breakdown),
    "late_results": ("",),
    "busy_answers": ("",),
}
"""Series shown as 0 from the start."""
BOUNDS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0)
"""Inclusive upper ends of the buckets, s; a last bucket holds longer durations."""


class Measures:
    """Durations by bucket and happenings by kind. Any thread may take a snapshot."""

    def __init__(self) -> None:
        self._buckets: dict[str, list[int]] = {name: [0] * (len(BOUNDS) + 1) for name in DURATIONS}
        self._sums: dict[str, float] = dict.fromkeys(DURATIONS, 0.0)
        self._counts: dict[str, dict[str, int]] = {name: dict.fromkeys(kinds, 0) for name, kinds in KINDS.items()}

    def observe(self, name: Duration, seconds: float) -> None:
        """Counts a duration."""
        self._buckets[name][bisect_left(BOUNDS, seconds)] += 1
        self._sums[name] += seconds

    @contextmanager
    def timed(self, name: Duration) -> Iterator[None]:
        """Counts the duration of a block, also if it raises; as a decorator, of each call."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.observe(name, time.perf_counter() - begin)

    def count(self, name: Happening, kind: str = "", times: int = 1) -> None:
        """Counts happenings."""
        counts = self._counts[name]
        counts[kind] = counts.get(kind, 0) + times

    def snapshot(self) -> dict[str, Any]:
        """Returns a JSON document: `seconds` by name, with counts per bucket and the sum in s; `counts` by name and kind."""
        return {
            "seconds": {name: {"buckets": list(self._buckets[name]), "sum": self._sums[name]} for name in DURATIONS},
            "counts": {name: dict(self._counts[name]) for name in KINDS},
        }


MEASURES = Measures()
"""The measures of this process."""
