"""The port through which cells get simulated: batches go in, every batch comes back once, finished or lost."""

from dataclasses import dataclass
from typing import Protocol

from drivecal.contracts.work import Batch, BatchResult
from drivecal.domain.errors import DrivecalError
from drivecal.domain.evaluations import Breakdown

DEADLINE_SECONDS = 60.0
"""A batch that takes longer than this, and longer than ..."""
DEADLINE_FACTOR = 20.0
"""... times what was expected, is given up as hung."""


class BackendLostError(DrivecalError):
    """The backend as a whole is gone and does not come back: the process that uses it has to start again."""


@dataclass(frozen=True, slots=True)
class Finished:
    """A batch with the results of its cells."""

    batch_id: int
    result: BatchResult


@dataclass(frozen=True, slots=True)
class Lost:
    """A batch without results, because its worker is gone: it crashed, was ended as hung, or ran out of memory.

    A worker takes everything that was sent to it along, so cells may be in a lost batch that had no part in it, and may even have
    been finished without the answer getting through.
    """

    batch_id: int
    worker: str
    breakdown: Breakdown
    detail: str
    seconds: float | None = None
    """How long the worker was busy with it; None where that is not known."""


@dataclass(frozen=True, slots=True)
class Slot:
    """Room for one more batch at a worker: an `idle` one begins at once, a busy one after the batch that runs."""

    worker: str
    idle: bool


@dataclass(frozen=True, slots=True)
class WorkerInfo:
    """One worker: `state` is `starting`, `idle` or `busy`; `cells` counts what it has finished. No other process ever has its `id`.

    The pool adds what it is doing: the `scenario` that it simulates, `since` when (UTC, ISO 8601), and how fast it was lately; and how many
    planning states it remembers to certify runs, in how much memory (MB) of how much."""

    id: str
    node: str
    pid: int | None
    state: str
    cells: int
    scenario: str | None = None
    since: str | None = None
    cells_per_second: float | None = None
    states: int | None = None
    state_mb: float | None = None
    state_mb_at_most: float | None = None


class Backend(Protocol):
    """Runs batches on workers. Not thread-safe: one thread calls it all."""

    def submit(self, worker: str, batch_id: int, batch: Batch, expected_seconds: float | None, *, alone: bool = False) -> None:
        """Sends a batch to a worker that has a slot, an idle one where it is to be `alone` (nothing is queued behind it, so that what
        happens to the worker is known to be its doing). `expected_seconds` sets the deadline; None is unknown."""

    def wait(self, timeout: float) -> list[Finished | Lost]:
        """Returns what came back, after at most `timeout` seconds. Dead workers are replaced on the way. Raises BackendLostError."""

    def slots(self) -> list[Slot]:
        """Returns the workers with room for a batch, idle workers first. Workers that are still starting cannot."""

    def workers(self) -> list[WorkerInfo]:
        """All workers, in a stable order."""

    def replace(self, worker: str, fault: str | None) -> None:
        """Ends an idle worker and starts another process in its place. `fault` says what was wrong with it; it is told as `trouble` until
        there is a result from that place, and a place that goes on failing gets longer and longer pauses. None: nothing was."""

    def trouble(self) -> str | None:
        """Why fewer workers than wanted run, in words; None where all is well."""

    def close(self) -> None:
        """Ends all workers; what was sent and not returned is dropped."""
