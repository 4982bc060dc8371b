"""The work pool: what the dispatcher gives cells to and gets results from. A thin driver between `Scheduler` and `Backend`."""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Callable, Sequence

from drivecal.contracts.work import BatchResult, Cell, SetupRequest
from drivecal.execution.backend import Backend, Finished, WorkerInfo
from drivecal.execution.batching import BatchPolicy
from drivecal.execution.scheduler import Completed, Scheduler

PATIENCE_WITH_REFUSALS = 30.0
"""Seconds after which a worker that refuses what is to be done is replaced: its installation may have been mended meanwhile."""

FAILURES_TOLD = 20
"""Of a campaign, before only the 32nd, 64th, 128th ... are."""

log = logging.getLogger(__name__)


class WorkPool:
    """Simulates cells on a backend's workers, in batches, retrying what gets lost. One thread calls it all.

    Results come in the order in which they arrive; whoever needs another order sorts by the cell's id.
    """

    def __init__(
        self, backend: Backend, policy: BatchPolicy | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._backend = backend
        self._scheduler = Scheduler(policy or BatchPolicy())
        self._clock = clock
        self._refusing_since: dict[str, float] = {}
        self._failures: Counter[str] = Counter()

    def workers(self) -> list[WorkerInfo]:
        """The backend's workers."""
        return self._backend.workers()

    def trouble(self) -> str | None:
        """Why fewer workers than wanted run, or refuse to, in words; None where all is well."""
        return "; ".join(filter(None, (self._backend.trouble(), self._scheduler.trouble()))) or None

    def submit(self, setup: SetupRequest, cells: Sequence[Cell], *, tag: str, priority: int = 0) -> None:
        """Queues cells of one setup and sends what there is room for. Higher priorities go first. `tag` names the cells for
        `withdraw`. Raises ValueError where a cell's id is outstanding already."""
        self._scheduler.add(setup, cells, tag, priority)
        self._fill()

    def poll(self, timeout: float) -> list[Completed]:
        """Waits up to `timeout` seconds for results and keeps the workers busy. Every submitted cell comes back exactly once:
        with a result, or with a `breakdown` after its last attempt. Returns earlier, perhaps with nothing, when a batch was lost."""
        self._fill()
        completed: list[Completed] = []
        for event in self._backend.wait(timeout):
            if isinstance(event, Finished):
                self._note_refusal(event.result)
                completed += self._scheduler.finished(event.batch_id, event.result)
            else:
                completed += self._scheduler.lost(event.batch_id, event.worker, event.breakdown, event.detail)
        for one in completed:
            if one.result.breakdown is not None:
                self._tell_failure(one)
        self._fill()
        return completed

    def withdraw(self, tag: str) -> int:
        """Drops the cells of `tag` that are not at a worker. Returns how many are: `poll` still returns those, unless their worker
        dies, in which case they are dropped as well. The tag is done with when `held(tag)` is 0."""
        return self._scheduler.withdraw(tag)

    def held(self, tag: str) -> int:
        """Cells of `tag` without an answer."""
        return self._scheduler.held(tag)

    def close(self) -> None:
        """Ends the workers; what has no answer is dropped."""
        self._backend.close()

    def _tell_failure(self, one: Completed) -> None:
        """All of a campaign's first failures, then fewer and fewer: thousands may be alike."""
        self._failures[one.tag] += 1
        count = self._failures[one.tag]
        if count <= FAILURES_TOLD or count.bit_count() == 1:
            log.warning(
                "cell %d of %s has no result after %d attempts (%s, at last on %s; failure %d of this campaign): %s",
                *(one.result.id, one.tag, one.attempts, one.result.breakdown, one.worker, count, one.result.detail),
            )

    def _note_refusal(self, result: BatchResult) -> None:
        if result.refusal is not None and result.worker not in self._refusing_since:
            log.warning("%s refuses: %s", result.worker, result.refusal)
            self._refusing_since[result.worker] = self._clock()

    def _fill(self) -> None:
        """Sends what there is room for, and replaces idle workers that cannot be given anything."""
        ready = [worker.id for worker in self._backend.workers() if worker.state != "starting"]
        self._scheduler.meet(ready)
        self._refusing_since = {worker: since for worker, since in self._refusing_since.items() if worker in ready}
        sent = True
        while sent:
            sent = False
            for slot in self._backend.slots():
                dispatch = self._scheduler.next_batch(slot.worker, idle=slot.idle)
                if dispatch is not None:
                    self._backend.submit(
                        dispatch.worker, dispatch.batch_id, dispatch.batch, dispatch.expected_seconds, alone=dispatch.alone
                    )
                    sent = True
        for worker in {slot.worker for slot in self._backend.slots() if slot.idle}:
            self._replace_if_needed(worker)

    def _replace_if_needed(self, worker: str) -> None:
        replacement = self._scheduler.replacement(worker)
        if replacement is not None:
            self._backend.replace(worker, replacement.fault)
            return
        patience_ends = self._refusing_since.get(worker, float("inf")) + PATIENCE_WITH_REFUSALS
        if self._clock() >= patience_ends and self._scheduler.is_kept_from(worker):
            self._backend.replace(worker, None)
