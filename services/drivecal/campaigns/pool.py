"""The work pool: what the dispatcher gives cells to and gets results from. A thin driver between `Scheduler` and `Backend`."""

from __future__ import annotations

from collections.abc import Sequence

from drivecal.campaigns.backend import Backend, Finished, WorkerInfo
from drivecal.campaigns.batching import BatchPolicy
from drivecal.campaigns.scheduler import Completed, Scheduler
from drivecal.contracts.work import Cell, SetupRequest


class WorkPool:
    """Simulates cells on a backend's workers, in batches, retrying what gets lost. One thread calls it all.

    Results come in the order in which they arrive; whoever needs another order sorts by the cell's id.
    """

    def __init__(self, backend: Backend, policy: BatchPolicy | None = None) -> None:
        self._backend = backend
        self._scheduler = Scheduler(policy or BatchPolicy())

    @property
    def outstanding(self) -> int:
        """Cells without an answer, sent or not."""
        return self._scheduler.outstanding

    @property
    def idle(self) -> bool:
        """True where every cell has its answer."""
        return self._scheduler.outstanding == 0

    def workers(self) -> list[WorkerInfo]:
        """The backend's workers."""
        return self._backend.workers()

    def trouble(self) -> str | None:
        """Why fewer workers than wanted run, in words; None where all is well."""
        return self._backend.trouble()

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
                completed += self._scheduler.finished(event.batch_id, event.result)
            else:
                completed += self._scheduler.lost(event.batch_id, event.worker, event.breakdown, event.detail)
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

    def _fill(self) -> None:
        while (slots := self._backend.slots()).idle + slots.behind > 0:
            dispatch = self._scheduler.next_batch(slots.workers, idle=slots.idle > 0)
            if dispatch is None:
                return
            self._backend.submit(dispatch.batch_id, dispatch.batch, dispatch.expected_seconds, alone=dispatch.alone)
