"""The port through which cells get simulated: batches go in, every batch comes back once, finished or lost."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from drivecal.contracts.work import Batch, BatchResult
from drivecal.domain.errors import DrivecalError
from drivecal.domain.evaluations import Breakdown


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


@dataclass(frozen=True, slots=True)
class Slots:
    """How many batches can be sent now: to `idle` workers, which begin at once, or `behind` a running batch of a busy one.
    `workers` counts all that work or could."""

    idle: int
    behind: int
    workers: int


@dataclass(frozen=True, slots=True)
class WorkerInfo:
    """One worker: `state` is `starting`, `idle` or `busy`; `cells` counts what it has finished."""

    id: str
    node: str
    pid: int | None
    state: str
    cells: int


class Backend(Protocol):
    """Runs batches on workers. Not thread-safe: one thread calls it all."""

    def submit(self, batch_id: int, batch: Batch, expected_seconds: float | None, *, alone: bool = False) -> None:
        """Sends a batch; there must be a free slot, an idle worker where it is to be `alone` (nothing is queued behind it, so that
        what happens to the worker is known to be its doing). `expected_seconds` sets the deadline; None is unknown."""

    def wait(self, timeout: float) -> list[Finished | Lost]:
        """What came back, after at most `timeout` seconds. Dead workers are replaced on the way. Raises BackendLostError."""

    def slots(self) -> Slots:
        """How much can be sent now. Workers that are still starting do not count."""

    def workers(self) -> list[WorkerInfo]:
        """All workers, in a stable order."""

    def trouble(self) -> str | None:
        """Why fewer workers than wanted run, in words; None where all is well."""

    def close(self) -> None:
        """Ends all workers; what was sent and not returned is dropped."""
