"""Health of the workers: trust in their errors, and replacement. Pure.

A worker that answers every cell with an error at once is always idle. It would take most of the work, and most second attempts at cells
that it spoilt. So the report of a single worker never suffices, a worker with results is asked before a worker without, and a worker
that never has results is replaced.
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum

from drivecal.contracts.work import BatchResult, SetupKey
from drivecal.execution.scheduling.refusals import Refusals

BATCHES_WITHOUT_RESULT = 3
"""Batches without a result, in a row, after which a worker is replaced."""


class Trust(IntEnum):
    """Trust in a worker's errors, by its record since its start."""

    DOUBTED = 0
    """Its last batch had no result, and no other worker confirmed that the cells are to blame."""
    UNKNOWN = 1
    PROVEN = 2
    """It has returned results."""


@dataclass(frozen=True, slots=True)
class _Shown:
    """Record of a worker since its start."""

    proven: bool = False
    without_result: int = 0
    """Last batches without a result, in a row."""
    detail: str = ""

    @property
    def trust(self) -> Trust:
        if self.without_result:
            return Trust.DOUBTED
        return Trust.PROVEN if self.proven else Trust.UNKNOWN


_NOTHING = _Shown()


class WorkerHealth:
    """Records of workers by name; no two processes share a name."""

    def __init__(self, refusals: Refusals) -> None:
        """Begins without records. The same workers' refusals are in `refusals`."""
        self._refusals = refusals
        self._ready: frozenset[str] = frozenset()
        self._shown: dict[str, _Shown] = {}

    @property
    def ready(self) -> int:
        """Workers that have started."""
        return len(self._ready)

    def meet(self, ready: Sequence[str]) -> None:
        """Notes which workers have started. Records of the others are forgotten."""
        if self._ready != (now := frozenset(ready)):
            self._ready = now
            self._shown = {worker: shown for worker, shown in self._shown.items() if worker in now}

    def answered(self, worker: str, result: BatchResult) -> None:
        """Notes the result of a batch."""
        if any(answer.breakdown is None or answer.contained for answer in result.results):
            self._shown[worker] = _Shown(proven=True)
        elif result.refusal is None and result.busy is None:
            self.failed(worker, (result.results[-1].detail if result.results else None) or "it says nothing")

    def failed(self, worker: str, detail: str) -> None:
        """Notes a whole batch without a result."""
        shown = self._shown.get(worker, _NOTHING)
        self._shown[worker] = _Shown(shown.proven, shown.without_result + 1, detail)

    def confirmed(self, workers: Iterable[str]) -> None:
        """Notes workers that broke down at the same cell: the cell is to blame."""
        for worker in workers:
            self._shown[worker] = _Shown(self._shown.get(worker, _NOTHING).proven)

    def may_try(self, worker: str, setup: SetupKey, avoid: Collection[str]) -> bool:
        """Returns whether this worker may try a cell that broke down at the workers in `avoid`: only the most trusted other workers may."""
        if worker not in self._ready or worker in avoid or worker in self._refusals.refusing(setup):
            return False
        own = self._trust(worker)
        return not avoid or all(self._trust(other) <= own for other in self.able(setup, avoid))

    def on_probation(self, worker: str) -> bool:
        """Returns whether a worker has no results while others have some: it gets single cells."""
        return self._trust(worker) is not Trust.PROVEN and any(self._trust(other) is Trust.PROVEN for other in self._ready)

    def fault(self, worker: str) -> str | None:
        """Returns the reason to replace a worker, or None."""
        shown = self._shown.get(worker, _NOTHING)
        if shown.without_result < BATCHES_WITHOUT_RESULT:
            return None
        return f"{shown.without_result} batches in a row gave no result, the last one because: {shown.detail}"

    def able(self, setup: SetupKey, avoid: Collection[str]) -> frozenset[str]:
        """Returns the workers that are not in `avoid` and do not refuse a setup."""
        return self._ready.difference(avoid, self._refusals.refusing(setup))

    def _trust(self, worker: str) -> Trust:
        return self._shown.get(worker, _NOTHING).trust
