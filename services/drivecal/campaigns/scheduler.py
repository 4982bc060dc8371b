"""Which cells are sent next and what becomes of those whose worker died: a pure state machine without clock or I/O.

Cells wait in groups of one setup, so that workers seldom have to load another scenario. A batch whose worker was lost is a
suspicion against each of its cells: from then on each is sent alone, to an idle worker with nothing behind it, so that a poison cell
takes no other cell along. After `ATTEMPTS` it has failed; innocent cells succeed at once.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from drivecal.campaigns.batching import BatchPolicy, CellCosts, batch_size
from drivecal.contracts.work import Batch, BatchResult, Cell, CellResult, SetupRequest
from drivecal.domain.evaluations import Breakdown

ATTEMPTS = 3
ATTEMPTS_AT_ERRORS = 2
"""An exception is deterministic unless an earlier cell of the batch spoilt the simulator, so once alone settles it."""


@dataclass(frozen=True, slots=True)
class Completed:
    """The final answer of one cell: `attempts` counts how often it was sent."""

    tag: str
    worker: str
    result: CellResult
    attempts: int


@dataclass(frozen=True, slots=True)
class Dispatch:
    """A batch to send now; see `Backend.submit`."""

    batch_id: int
    batch: Batch
    expected_seconds: float | None
    alone: bool


_SetupKey = tuple[str, str, str, str]


@dataclass(slots=True)
class _Entry:
    cell: Cell
    setup: SetupRequest
    tag: str
    priority: int
    attempts: int = 0
    withdrawn: bool = False


def _key(setup: SetupRequest) -> _SetupKey:
    return (setup.run_fingerprint, setup.catalogue, setup.scenario, setup.evaluator)


class Scheduler:
    """Every cell that is added is completed exactly once, unless it is withdrawn before it was sent or while it was lost."""

    def __init__(self, policy: BatchPolicy) -> None:
        self._policy = policy
        self._costs = CellCosts()
        self._waiting: dict[int, dict[_SetupKey, deque[_Entry]]] = {}
        self._suspects: deque[_Entry] = deque()
        self._sent: dict[int, list[_Entry]] = {}
        self._by_id: dict[int, _Entry] = {}
        self._batch_ids = itertools.count(1)

    @property
    def outstanding(self) -> int:
        """Cells that have no answer yet, sent or not."""
        return len(self._by_id)

    def add(self, setup: SetupRequest, cells: Sequence[Cell], tag: str, priority: int) -> None:
        """Queues cells. Raises ValueError where a cell's id is outstanding already."""
        identifiers = [cell.id for cell in cells]
        twice = [identifier for identifier in identifiers if identifier in self._by_id]
        if twice or len(set(identifiers)) < len(identifiers):
            raise ValueError(f"cells are outstanding already or listed twice, e.g. {twice[:3] or identifiers[:3]}")
        group = self._waiting.setdefault(priority, {}).setdefault(_key(setup), deque())
        for cell in cells:
            entry = _Entry(cell, setup, tag, priority)
            self._by_id[cell.id] = entry
            group.append(entry)

    def next_batch(self, workers: int, *, idle: bool) -> Dispatch | None:
        """What to send to a free slot of `workers` workers, None for nothing. While suspects wait, only idle workers get anything:
        the others run dry, so that they can take the suspects."""
        if self._suspects:
            return self._dispatch([self._suspects.popleft()], alone=True) if idle else None
        if not self._waiting:
            return None
        priority = max(self._waiting)
        groups = self._waiting[priority]
        key, group = next(iter(groups.items()))
        size = batch_size(self._policy, self._costs.seconds_per_cell(key), self._waiting_seconds(), workers)
        taken = [group.popleft() for _ in range(min(size, len(group)))]
        self._forget_if_empty(priority, key)
        return self._dispatch(taken, alone=False)

    def finished(self, batch_id: int, result: BatchResult) -> list[Completed]:
        """Takes in the results of a batch; a batch that is not (or no longer) expected changes nothing."""
        entries = self._sent.pop(batch_id, None)
        if entries is None:
            return []
        if result.results:
            self._costs.observe(_key(entries[0].setup), len(entries), result.seconds)
        found = {answer.id: answer for answer in result.results}
        completed = []
        for entry in entries:
            answer = found.get(entry.cell.id) or _broken(entry, Breakdown.ERROR, "the worker returned no result for this cell")
            if answer.breakdown is None:
                del self._by_id[entry.cell.id]
                completed.append(Completed(entry.tag, result.worker, answer, entry.attempts))
            else:
                most = ATTEMPTS_AT_ERRORS if answer.breakdown == Breakdown.ERROR else ATTEMPTS
                completed += self._again_or_failed(entry, answer, result.worker, most)
        return completed

    def lost(self, batch_id: int, worker: str, breakdown: Breakdown, detail: str) -> list[Completed]:
        """Takes in the loss of a batch: its cells are tried again one by one; those with no attempts left have failed."""
        return [
            completed
            for entry in self._sent.pop(batch_id, [])
            for completed in self._again_or_failed(entry, _broken(entry, breakdown, detail), worker, ATTEMPTS)
        ]

    def withdraw(self, tag: str) -> int:
        """Drops the cells of `tag` that are not at a worker. Returns how many are: those still complete, unless they get lost."""
        for priority, groups in list(self._waiting.items()):
            for key, group in list(groups.items()):
                groups[key] = self._without(group, tag)
                self._forget_if_empty(priority, key)
        self._suspects = self._without(self._suspects, tag)
        running = [entry for entry in self._by_id.values() if entry.tag == tag]
        for entry in running:
            entry.withdrawn = True
        return len(running)

    def held(self, tag: str) -> int:
        """Cells of `tag` without an answer."""
        return sum(entry.tag == tag for entry in self._by_id.values())

    def _dispatch(self, entries: list[_Entry], *, alone: bool) -> Dispatch:
        for entry in entries:
            entry.attempts += 1
        batch_id = next(self._batch_ids)
        self._sent[batch_id] = entries
        setup = entries[0].setup
        cost = self._costs.seconds_per_cell(_key(setup))
        expected = None if cost is None else cost * len(entries)
        return Dispatch(batch_id, Batch(setup, tuple(entry.cell for entry in entries)), expected, alone)

    def _again_or_failed(self, entry: _Entry, answer: CellResult, worker: str, most: int) -> list[Completed]:
        if entry.attempts < most and not entry.withdrawn:
            self._suspects.append(entry)
            return []
        del self._by_id[entry.cell.id]
        # a withdrawn cell had fewer attempts than it was due: it has not failed, it was not simulated
        return [] if entry.attempts < most else [Completed(entry.tag, worker, answer, entry.attempts)]

    def _waiting_seconds(self) -> float:
        costs = self._costs
        return sum(
            len(group) * (costs.seconds_per_cell(key) or 0.0)
            for groups in self._waiting.values()
            for key, group in groups.items()
        )

    def _without(self, entries: deque[_Entry], tag: str) -> deque[_Entry]:
        for entry in entries:
            if entry.tag == tag:
                del self._by_id[entry.cell.id]
        return deque(entry for entry in entries if entry.tag != tag)

    def _forget_if_empty(self, priority: int, key: _SetupKey) -> None:
        groups = self._waiting[priority]
        if not groups[key]:
            del groups[key]
        if not groups:
            del self._waiting[priority]


def _broken(entry: _Entry, breakdown: Breakdown, detail: str) -> CellResult:
    return CellResult(entry.cell.id, None, None, {}, None, 0.0, breakdown.value, detail)
