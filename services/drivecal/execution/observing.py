"""Reports of the pool's work: in the log, in the measures and for each worker."""

import logging
import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime

from drivecal.contracts.work import BatchResult
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.backend import Finished, Lost, WorkerInfo
from drivecal.execution.measures import DEPARTED, MEASURES
from drivecal.execution.scheduling.in_flight import Completed, Dispatch

RECENT_BATCHES = 20
"""Batches that the speed is taken from: some seconds of work."""


@dataclass(slots=True)
class _Desk:
    """Work at a worker: the first of `batches` (scenario by id) runs since `since`, the others wait."""

    batches: dict[int, str] = field(default_factory=dict)
    since: float = 0.0
    recent: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=RECENT_BATCHES))
    """Cells and seconds of the last batches."""


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

    def came_back(self, worker: str, batch_id: int, cells: int, seconds: float) -> None:
        """Notes a returned or lost batch, with the number of its results and its duration."""
        desk = self._desks.get(worker)
        if desk is None or batch_id not in desk.batches:
            return
        if batch_id == next(iter(desk.batches)):  # the one behind it begins
            desk.since = self._clock()
        del desk.batches[batch_id]
        if cells and seconds > 0:
            desk.recent.append((cells, seconds))

    def describe(self, workers: Collection[WorkerInfo]) -> list[WorkerInfo]:
        """Returns the workers with their activity, and forgets workers that have left."""
        self._desks = {worker.id: self._desks[worker.id] for worker in workers if worker.id in self._desks}
        return [self._describe(worker) for worker in workers]

    def _describe(self, worker: WorkerInfo) -> WorkerInfo:
        desk = self._desks.get(worker.id)
        if desk is None:
            return worker
        cells, seconds = sum(count for count, _ in desk.recent), sum(spent for _, spent in desk.recent)
        speed = cells / seconds if seconds else None
        if not desk.batches:
            return worker.model_copy(update={"cells_per_second": speed})
        scenario, since = next(iter(desk.batches.values())), datetime.fromtimestamp(desk.since, UTC)
        return worker.model_copy(update={"scenario": scenario, "since": since, "cells_per_second": speed})


FAILURES_TOLD = 20
"""Failures of a campaign logged in full; then only the 32nd, 64th, 128th and so on."""

log = logging.getLogger(__name__)


class Observer:
    """Reports every sent and returned batch."""

    def __init__(self) -> None:
        self._activity = Activity()
        self._failures: Counter[str] = Counter()

    def describe(self, workers: Collection[WorkerInfo]) -> list[WorkerInfo]:
        """Returns the workers with their activity."""
        return self._activity.describe(workers)

    def sent(self, dispatch: Dispatch) -> None:
        """Notes a sent batch."""
        self._activity.sent(dispatch.worker, dispatch.batch_id, dispatch.batch.setup.scenario)

    def came_back(self, dispatch: Dispatch, event: Finished | Lost, completed: Collection[Completed]) -> None:
        """Notes a returned batch; its cells that are not `completed` are sent again."""
        broken = breakdowns(dispatch, event)
        if isinstance(event, Finished):
            result = event.result
            self._activity.came_back(dispatch.worker, dispatch.batch_id, len(result.results), result.seconds)
            if result.refusal is None and dispatch.batch.cells:
                MEASURES.batch.observe(result.seconds)
            if result.busy is not None:
                MEASURES.busy_answers.inc()
            for answer in result.results:
                if answer.breakdown is None:
                    MEASURES.evaluation.observe(answer.milliseconds / 1000)
        else:
            self._activity.came_back(dispatch.worker, dispatch.batch_id, 0, 0.0)
            if event.departed and event.begun:
                MEASURES.breakdowns.labels(DEPARTED).inc()
        for kind in broken.values():
            MEASURES.breakdowns.labels(kind).inc()
        final = {completion.result.id for completion in completed}
        for cell, kind in broken.items():
            if cell not in final:
                MEASURES.retries.labels(kind).inc()
        for failed in completed:
            if failed.result.breakdown is not None:
                self._tell_failure(failed)

    def _tell_failure(self, completed: Completed) -> None:
        """Logs the first failures of a campaign, then fewer and fewer: thousands may be alike."""
        self._failures[completed.tag] += 1
        count = self._failures[completed.tag]
        if count <= FAILURES_TOLD or count.bit_count() == 1:
            result = completed.result
            log.warning(
                "cell %d has no result after %d attempts (%s, at last on %s; failure %d of this campaign): %s",
                *(result.id, completed.attempts, result.breakdown, completed.worker, count, result.detail),
                extra={"campaign": completed.tag},
            )


def breakdowns(dispatch: Dispatch, event: Finished | Lost) -> Mapping[int, str]:
    """Returns the kind of breakdown by cell id. Cells have none that a refusal or a busy simulator leaves, whose worker left,
    or that it had not begun."""
    if isinstance(event, Lost):
        return {} if event.departed else dict.fromkeys(event.blamed(dispatch.breakdowns), event.breakdown.value)
    result: BatchResult = event.result
    answered = {answer.id: answer.breakdown for answer in result.results}
    missing = None if result.refusal is not None or result.busy is not None else Breakdown.ERROR.value
    kinds = ((cell, answered.get(cell, missing)) for cell in dispatch.breakdowns)
    return {cell: kind for cell, kind in kinds if kind is not None}
