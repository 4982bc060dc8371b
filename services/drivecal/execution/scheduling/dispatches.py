"""Decisions of the scheduler: batches to send, answers of cells, workers to replace."""

from collections.abc import Mapping
from dataclasses import dataclass

from drivecal.contracts.work import Batch, CellResult


@dataclass(frozen=True, slots=True)
class Completed:
    """The final answer of a cell; `attempts` counts its breakdowns and the attempt with the result."""

    tag: str
    worker: str
    result: CellResult
    attempts: int
    leader: int | None = None
    """The id of the identical cell that was sent instead; None if the cell was sent itself."""
    lease: int | None = None
    """The number of the lease of the result (the leader's, if any); the pool fills it in."""

    @property
    def shared(self) -> bool:
        """Whether an identical cell was simulated instead."""
        return self.leader is not None


@dataclass(frozen=True, slots=True)
class Dispatch:
    """A batch to send now; see `Backend.submit`."""

    worker: str
    batch_id: int
    batch: Batch
    expected_seconds: float | None
    alone: bool
    breakdowns: Mapping[int, int]
    """Breakdowns so far of the batch's cells, by id."""


@dataclass(frozen=True, slots=True)
class Replacement:
    """A worker to replace; see `Backend.replace`."""

    fault: str | None
