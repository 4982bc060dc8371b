"""Durations and failures of the dispatcher's work, counted in memory for `/metrics`.

The dispatcher puts `snapshot` into its heartbeat, and the API exports it. Counters start at zero with the process, as Prometheus
expects. Like a logger, `MEASURES` exists once per process and decides nothing.
"""

from collections.abc import Iterable
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Histogram

from drivecal.domain.evaluations import Breakdown

DEPARTED = "departed"
"""Kind of a breakdown that is no fault of a cell: its worker was killed from outside, or left with its node."""
BOUNDS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0)
"""Inclusive upper ends of the buckets, s; a last bucket holds longer durations."""


class Measures:
    """Histograms of durations and counters of happenings."""

    def __init__(self) -> None:
        self._registry = CollectorRegistry()
        self.lookup = self._durations("lookup", "Looking up what is stored for the cells of one population or sample")
        self.evaluation = self._durations("evaluation", "CPU time of one simulated cell")
        self.batch = self._durations("batch", "Duration of one batch of cells at its worker")
        self.lease = self._durations("lease_transaction", "Duration of transactions that lease cells")
        self.record = self._durations("record_transaction", "Duration of transactions that write results down")
        told = "Cells that broke down, alone or with their worker, once per attempt"
        self.breakdowns = self._happenings("breakdowns", told, (*Breakdown, DEPARTED))
        self.retries = self._happenings("retries", "Cells that were sent again after a breakdown", Breakdown)
        told = "Batches that ended early because their simulator was busy; the cells wait"
        self.busy_answers = self._happenings("busy_answers", told)
        told = "Results that came after their lease was over, and were rejected"
        self.late_results = self._happenings("late_results", told)

    def snapshot(self) -> list[list[Any]]:
        """Returns a JSON document: name, help, type and samples of each metric; a sample: the end of its name, its labels, its value."""
        return [
            [
                *(family.name, family.documentation, family.type),
                [
                    [sample.name.removeprefix(family.name), dict(sample.labels), sample.value]
                    for sample in family.samples
                    if not sample.name.endswith("_created")
                ],
            ]
            for family in self._registry.collect()
        ]

    def _durations(self, name: str, documentation: str) -> Histogram:
        return Histogram(f"drivecal_{name}_seconds", documentation, buckets=BOUNDS, registry=self._registry)

    def _happenings(self, name: str, documentation: str, kinds: Iterable[str] = ()) -> Counter:
        """Returns a counter by kind, whose series begin at 0."""
        shown = list(kinds)
        counter = Counter(f"drivecal_{name}", documentation, ["kind"] if shown else [], registry=self._registry)
        for kind in shown:
            counter.labels(kind)
        return counter


MEASURES = Measures()
"""The measures of this process."""
