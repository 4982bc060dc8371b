"""The port for simulation: every submitted batch comes back once, finished or lost."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Protocol

from drivecal.contracts.inventory import WorkerAnswer
from drivecal.contracts.work import Batch, BatchResult
from drivecal.domain.errors import DrivecalError
from drivecal.domain.evaluations import Breakdown

DEADLINE_SECONDS = 60.0
DEADLINE_FACTOR = 20.0
"""A batch hangs if it takes longer than both the deadline and this multiple of its expected time."""


SETTLE_SECONDS = 12.0
"""How long runs on a living machine may outlive their worker: its keeper asks them to end, kills them, and needs some time itself."""
LONGEST_QUEUED = 20.0
"""Longest time of a batch, s, with another one behind it, which other workers would begin sooner; processes give that one back then."""


class BackendLostError(DrivecalError):
    """The whole backend is gone for good; its process has to start again."""


@dataclass(frozen=True, slots=True)
class Finished:
    """A batch with the results of its cells."""

    batch_id: int
    result: BatchResult


@dataclass(frozen=True, slots=True)
class Lost:
    """A batch whose worker crashed, hung, or ran out of memory. Its cells may be innocent, or even finished without an answer."""

    batch_id: int
    worker: str
    breakdown: Breakdown
    detail: str
    seconds: float | None = None
    """Time of the worker; None if unknown."""
    begun: bool = True
    """False if the batch waited behind another one, so that none of its cells was simulated."""
    departed: bool = False
    """True if the worker left, killed from outside or with its node: its cells are not to blame."""
    starts: Mapping[int, int] | None = None
    """Starts of the simulator by cell, those without any left out; None if nothing is known."""

    @property
    def is_back(self) -> bool:
        """True if the batch was taken back: its worker lives."""
        return self.breakdown is Breakdown.ERROR and not self.begun

    def blamed(self, cells: Collection[int]) -> Collection[int]:
        """Returns the cells that may have ended the worker: the started ones, or all of the running batch if no start is known."""
        if not self.begun:
            return ()
        return [cell for cell in cells if self.starts and cell in self.starts] or cells


@dataclass(frozen=True, slots=True)
class Slot:
    """Room for a batch at a worker: an `idle` worker begins at once, a busy worker after its running batch."""

    worker: str
    idle: bool


class WorkerInfo(WorkerAnswer):
    """A worker: `state` is `starting`, `idle` or `busy`. No other process ever has its `id`."""

    node: str
    pid: int | None = None


class Backend(Protocol):
    """Runs batches on workers. Not thread-safe: one thread calls it all."""

    def submit(self, worker: str, batch_id: int, batch: Batch, expected_seconds: float | None, *, alone: bool = False) -> None:
        """Sends a batch to a worker with a slot. `alone` needs an idle worker and queues nothing behind the batch, so that a loss is its
        doing. `expected_seconds` sets the deadline; None is unknown."""

    def wait(self, timeout: float) -> list[Finished | Lost]:
        """Returns finished and lost batches, after at most `timeout` seconds, and replaces dead workers. Raises BackendLostError."""

    def slots(self) -> list[Slot]:
        """Returns the workers with room for a batch, idle workers first, without starting workers."""

    def workers(self) -> list[WorkerInfo]:
        """Returns all workers, in a stable order."""

    def replace(self, worker: str, fault: str | None) -> None:
        """Replaces an idle worker's process. `fault` is the reason, None if the worker is healthy. `trouble` reports it until the new
        process returns a result. Each repeated fault causes a longer pause."""

    def trouble(self) -> str | None:
        """Returns the reason for missing workers, or None."""

    def close(self) -> None:
        """Ends all workers and drops running batches."""
