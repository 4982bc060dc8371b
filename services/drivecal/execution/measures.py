"""How long the dispatcher's work takes and what goes wrong in it, counted in memory: what `/metrics` shows of the dispatcher.

The dispatcher puts `snapshot` into its heartbeat, and the API exports it. Everything starts at zero with the process, as Prometheus
expects of counters. Like a logger, `MEASURES` is one per process and only ever written to: nothing decides anything by it.

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
"""`lookup`: what is stored for the cells of one population or sample. `evaluation`: CPU time of one cell. `batch`: one batch at its
worker. `lease` and `record`: the transactions that lease cells and that write their results."""
Happening = Literal["breakdowns", "retries", "late_results"]
"""`breakdowns`: a cell or its worker broke down, by kind. `retries`: cells sent again after that, by kind. `late_results`: results whose
lease was over, rejected."""

DURATIONS: tuple[Duration, ...] = ("lookup", "evaluation", "batch", "lease", "record")
KINDS: dict[Happening, tuple[str, ...]] = {
    "breakdowns": tuple(Breakdown),
    "retries": tuple(Breakdown),
    "late_results": ("",),
}
"""Series shown as 0 from the start."""
BOUNDS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0)
"""Upper ends of the buckets, s, each inclusive; one more bucket holds what is longer."""


class Measures:
    """Durations by bucket and happenings by kind. A snapshot may be taken by another thread than the one that counts."""

    def __init__(self) -> None:
        self._buckets: dict[str, list[int]] = {name: [0] * (len(BOUNDS) + 1) for name in DURATIONS}
        self._sums: dict[str, float] = dict.fromkeys(DURATIONS, 0.0)
        self._counts: dict[str, dict[str, int]] = {name: dict.fromkeys(kinds, 0) for name, kinds in KINDS.items()}

    def observe(self, name: Duration, seconds: float) -> None:
        """Something took `seconds`."""
        self._buckets[name][bisect_left(BOUNDS, seconds)] += 1
        self._sums[name] += seconds

    @contextmanager
    def timed(self, name: Duration) -> Iterator[None]:
        """Observes how long the block takes, also where it raises; as a decorator, how long each call takes."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.observe(name, time.perf_counter() - begin)

    def count(self, name: Happening, kind: str = "", times: int = 1) -> None:
        """Something happened, or `times` of it."""
        counts = self._counts[name]
        counts[kind] = counts.get(kind, 0) + times

    def snapshot(self) -> dict[str, Any]:
        """All of it as a JSON document: `seconds` by name, with the buckets' own counts (not added up) and the sum in s, and `counts` by
        name and kind."""
        return {
            "seconds": {name: {"buckets": list(self._buckets[name]), "sum": self._sums[name]} for name in DURATIONS},
            "counts": {name: dict(self._counts[name]) for name in KINDS},
        }


MEASURES = Measures()
"""The measures of this process."""
