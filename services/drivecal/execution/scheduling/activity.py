"""Activity and speed of each worker, from batches sent and returned."""

import time
from collections import deque
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

from drivecal.contracts.work import CertificateMemory
from drivecal.execution.backend import WorkerInfo

RECENT_BATCHES = 20
"""Batches that the speed is taken from: some seconds of work."""


@dataclass(slots=True)
class _Desk:
    """Work at a worker: the first of `batches` (scenario by id) runs since `since`, the others wait."""

    batches: dict[int, str] = field(default_factory=dict)
    since: float = 0.0
    recent: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=RECENT_BATCHES))
    """Cells and seconds of the last batches."""
    remembered: CertificateMemory | None = None


class Activity:
    """Activity by worker. `clock` returns seconds since 1970."""

    def __init__(self, clock: Callable[[], float] = time.time) -> None:
        self._clock = clock
        self._desks: dict[str, _Desk] = {}

    def sent(self, worker: str, batch_id: int, scenario: str) -> None:
        """Notes a batch sent to a worker."""
        desk = self._desks.setdefault(worker, _Desk())
        if not desk.batches:
            desk.since = self._clock()
        desk.batches[batch_id] = scenario

    def finished(
        self, worker: str, batch_id: int, cells: int, seconds: float, remembered: CertificateMemory | None = None
    ) -> None:
        """Notes a returned batch, its duration, and the worker's memory for certificates since then."""
        if self._take(worker, batch_id) and cells and seconds > 0:
            self._desks[worker].recent.append((cells, seconds))
        if worker in self._desks and remembered is not None:
            self._desks[worker].remembered = remembered

    def lost(self, worker: str, batch_id: int) -> None:
        """Notes a lost batch."""
        self._take(worker, batch_id)

    def describe(self, workers: Collection[WorkerInfo]) -> list[WorkerInfo]:
        """Returns the workers with their activity, and forgets workers that have left."""
        self._desks = {worker.id: self._desks[worker.id] for worker in workers if worker.id in self._desks}
        return [self._describe(worker) for worker in workers]

    def _take(self, worker: str, batch_id: int) -> bool:
        desk = self._desks.get(worker)
        if desk is None or desk.batches.pop(batch_id, None) is None:
            return False
        desk.since = self._clock()
        return True

    def _describe(self, worker: WorkerInfo) -> WorkerInfo:
        desk = self._desks.get(worker.id)
        if desk is None:
            return worker
        kept = desk.remembered
        if kept is not None:
            worker = replace(worker, states=kept.states, state_mb=kept.bytes / 2**20, state_mb_at_most=kept.limit / 2**20)
        cells, seconds = sum(count for count, _ in desk.recent), sum(spent for _, spent in desk.recent)
        speed = cells / seconds if seconds else None
        if not desk.batches:
            return replace(worker, cells_per_second=speed)
        since = datetime.fromtimestamp(desk.since, UTC).isoformat(timespec="milliseconds")
        return replace(worker, scenario=next(iter(desk.batches.values())), since=since, cells_per_second=speed)
