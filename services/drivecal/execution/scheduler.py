"""Which cells are sent next, to whom, and what becomes of those that broke down: a pure state machine without clock or I/O.

Cells wait in groups of one setup, so that workers seldom have to load another scenario. A batch whose worker was lost is a
suspicion against each of its cells: from then on each is sent alone, to an idle worker with nothing behind it, so that a poison cell
takes no other cell along. After `ATTEMPTS` it has failed; innocent cells succeed at once.

A worker that lives and reports a breakdown may itself be to blame. Its cells are suspects as well, but go to another worker, or to
the process that replaces the only one. A worker that refuses a setup says nothing about the cells: they wait for somebody else.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from drivecal.contracts.work import Batch, BatchResult, Cell, CellResult, SetupRequest
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.batching import BatchPolicy, CellCosts, batch_size
from drivecal.execution.standing import Standings

ATTEMPTS = 3
"""How often a cell is sent before it has failed."""
WITNESSES = 2
"""Workers that must have seen an exception: it is deterministic, unless a worker or an earlier cell of the batch is to blame."""
MOST_PASSED_OVER = 200
"""Batches of a quarter of a second, after which a suspect no longer waits until its only worker has nothing else to do."""


@dataclass(frozen=True, slots=True)
class Completed:
    """The final answer of one cell: `attempts` counts the tries, its breakdowns and the one that gave the result."""

    tag: str
    worker: str
    result: CellResult
    attempts: int
    leader: int | None = None
    """The id of the identical cell that was sent in its place; None where it was sent itself."""
    lease: int | None = None
    """The number of the lease under which the result was obtained (the leader's, where there is one); whoever leases fills it in."""

    @property
    def shared(self) -> bool:
        """True where an identical cell was simulated in its place."""
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
    """Of each cell of the batch, by its id: how often it broke down so far."""


@dataclass(frozen=True, slots=True)
class Replacement:
    """A worker to replace; see `Backend.replace`."""

    worker: str
    fault: str | None


_SetupKey = tuple[str, str, str, str]


@dataclass(slots=True)
class _Entry:
    cell: Cell
    setup: SetupRequest
    tag: str
    priority: int
    attempts: int = 0
    withdrawn: bool = False
    witnesses: set[str] = field(default_factory=set)
    """Workers that live and reported that the cell broke down."""

    @property
    def avoid(self) -> frozenset[str]:
        """The worker whose word alone does not count."""
        return frozenset(self.witnesses) if len(self.witnesses) < WITNESSES else frozenset()


def _key(setup: SetupRequest) -> _SetupKey:
    return (setup.run_fingerprint, setup.catalogue, setup.scenario, setup.evaluator)


class Scheduler:
    """Every cell that is added is completed exactly once, unless it is withdrawn before it was sent or while it was lost."""

    def __init__(self, policy: BatchPolicy) -> None:
        self._policy = policy
        self._costs = CellCosts()
        self._waiting: dict[int, dict[_SetupKey, deque[_Entry]]] = {}
        self._suspects: dict[tuple[_SetupKey, frozenset[str]], deque[_Entry]] = {}
        """By setup and by the workers that must not have them."""
        self._standings = Standings()
        self._passed_over = 0
        """Batches that a worker got while a suspect waited that only its replacement can take."""
        self._sent: dict[int, list[_Entry]] = {}
        self._by_id: dict[int, _Entry] = {}
        self._batch_ids = itertools.count(1)

    def add(
        self,
        setup: SetupRequest,
        cells: Sequence[Cell],
        tag: str,
        priority: int,
        *,
        exclusive: bool = False,
        breakdowns: Mapping[int, int] | None = None,
    ) -> None:
        """Queues cells. One that is identical to an outstanding cell (setup, evaluator and every bit of the parameters) is not sent:
        it takes the other's answer, unless one of the two is `exclusive`. `breakdowns`, by id: how often a cell broke down before
        this scheduler knew it. Raises ValueError where a cell's id is outstanding already."""
        identifiers = [cell.id for cell in cells]
        twice = [identifier for identifier in identifiers if identifier in self._by_id]
        if twice or len(set(identifiers)) < len(identifiers):
            raise ValueError(f"cells are outstanding already or listed twice, e.g. {twice[:3] or identifiers[:3]}")
        group = self._waiting.setdefault(priority, {}).setdefault(_key(setup), deque())
        for cell in cells:
            entry = _Entry(cell, setup, tag, priority, attempts=(breakdowns or {}).get(cell.id, 0))
            self._by_id[cell.id] = entry
            group.append(entry)

    def take_back(self, batch_id: int) -> None:
        """A dispatch was not sent after all: its cells return to the front of their queues, as if they had not been taken out."""
        self._take_back(self._sent.pop(batch_id))

    def drop(self, batch_id: int, cells: Collection[int]) -> Dispatch | None:
        """Some cells of a dispatch, which was not sent yet, are not to be simulated: they are forgotten, neither completed nor held.
        Identical cells that waited for them wait for themselves. Returns the dispatch of what is left, to be sent in place of the
        first one; None where nothing is."""
        raise NotImplementedError

    def take_breakdowns(self) -> dict[int, int]:
        """The number of breakdowns, by id, of the outstanding cells for which it changed since the last call: to be written down, for
        the scheduler that comes after this one (`add`)."""
        raise NotImplementedError

    def meet(self, ready: Sequence[str]) -> None:
        """Tells which workers have started and live."""
        self._standings.meet(ready)

    def next_batch(self, worker: str, *, idle: bool) -> Dispatch | None:
        """What to send to a free slot of a worker, None for nothing. While suspects wait that it may have, it gets them one by one and
        nothing behind a running batch: it runs dry, so that it can take them. So does a worker that is to be replaced."""
        if self._standings.fault(worker) is not None:
            return None
        for (setup, avoid), suspects in self._suspects.items():
            if worker in self._standings.candidates(setup, avoid):
                return self._dispatch(worker, [self._take_suspect(setup, avoid, suspects)], alone=True) if idle else None
        passes_over = self._is_alone(worker)
        if passes_over and self._passed_over >= MOST_PASSED_OVER:
            return None
        for priority in sorted(self._waiting, reverse=True):
            for setup, group in self._waiting[priority].items():
                if not self._standings.refuses(worker, setup):
                    self._passed_over += passes_over
                    taken = [group.popleft() for _ in range(min(self._size(worker, setup), len(group)))]
                    self._forget_if_empty(priority, setup)
                    return self._dispatch(worker, taken, alone=False)
        return None

    def replacement(self, worker: str) -> Replacement | None:
        """Whether an idle worker for which there is no batch is to be replaced: because it never has results, or because a cell broke
        down at it and there is nobody else to try."""
        fault = self._standings.fault(worker)
        return Replacement(worker, fault) if fault is not None or self._is_alone(worker) else None

    def is_kept_from(self, worker: str) -> bool:
        """True where something waits that this worker refuses."""
        waiting = [*(setup for groups in self._waiting.values() for setup in groups), *(setup for setup, _ in self._suspects)]
        return any(self._standings.refuses(worker, setup) for setup in waiting)

    def trouble(self) -> str | None:
        """Which workers refuse what is to be done, in words, and why; None where none does."""
        setups = {_key(entry.setup): entry.setup for entry in self._by_id.values()}
        refusals = self._standings.refusals(setups)
        if not refusals:
            return None
        scenarios = sorted({one.scenario for setup, one in setups.items() if self._standings.refusals({setup})})
        worker, reason = next(iter(refusals.items()))
        number = f"{len(refusals)} workers refuse" if len(refusals) > 1 else f"{worker} refuses"
        return f"{number} {', '.join(scenarios)}: {reason}"

    def finished(self, batch_id: int, result: BatchResult) -> list[Completed]:
        """Takes in the results of a batch; a batch that is not (or no longer) expected changes nothing."""
        entries = self._sent.pop(batch_id, None)
        if entries is None:
            return []
        setup = _key(entries[0].setup)
        self._standings.answered(result.worker, setup, result)
        if result.refusal is not None:
            self._take_back(entries)
            return []
        if result.results:
            self._costs.observe(setup, len(entries), result.seconds)
        found = {answer.id: answer for answer in result.results}
        completed = []
        for entry in entries:
            answer = found.get(entry.cell.id) or _broken(entry, Breakdown.ERROR, "the worker returned no result for this cell")
            if answer.breakdown is None:
                del self._by_id[entry.cell.id]
                completed.append(Completed(entry.tag, result.worker, answer, entry.attempts))
            else:
                completed += self._broke_down(entry, answer, result.worker)
        return completed

    def lost(
        self, batch_id: int, worker: str, breakdown: Breakdown, detail: str, seconds: float | None = None
    ) -> list[Completed]:
        """Takes in the loss of a batch: its cells are tried again one by one; those with no attempts left have failed. `seconds`: how
        long the worker was busy with it, where that is known: it is charged to the campaign's share of the workers' time."""
        del seconds
        entries = self._sent.pop(batch_id, [])
        if breakdown is not Breakdown.ERROR:  # the worker is gone as well
            return [
                done for entry in entries for done in self._again_or_failed(entry, _broken(entry, breakdown, detail), worker)
            ]
        if entries:
            self._standings.failed(worker, detail)
        return [done for entry in entries for done in self._broke_down(entry, _broken(entry, breakdown, detail), worker)]

    def withdraw(self, tag: str) -> int:
        """Drops the cells of `tag` that are not at a worker. Returns how many are: those still complete, unless they get lost."""
        for priority, groups in list(self._waiting.items()):
            for key, group in list(groups.items()):
                groups[key] = self._without(group, tag)
                self._forget_if_empty(priority, key)
        kept = {place: self._without(suspects, tag) for place, suspects in self._suspects.items()}
        self._suspects = {place: suspects for place, suspects in kept.items() if suspects}
        running = [entry for entry in self._by_id.values() if entry.tag == tag]
        for entry in running:
            entry.withdrawn = True
        return len(running)

    def held(self, tag: str) -> int:
        """Cells of `tag` without an answer."""
        return sum(entry.tag == tag for entry in self._by_id.values())

    def _dispatch(self, worker: str, entries: list[_Entry], *, alone: bool) -> Dispatch:
        for entry in entries:
            entry.attempts += 1
        batch_id = next(self._batch_ids)
        self._sent[batch_id] = entries
        setup = entries[0].setup
        cost = self._costs.seconds_per_cell(_key(setup))
        expected = None if cost is None else cost * len(entries)
        breakdowns = {entry.cell.id: entry.attempts - 1 for entry in entries}
        return Dispatch(worker, batch_id, Batch(setup, tuple(entry.cell for entry in entries)), expected, alone, breakdowns)

    def _size(self, worker: str, setup: _SetupKey) -> int:
        if self._standings.on_probation(worker):
            return 1
        cost = self._costs.seconds_per_cell(setup)
        return batch_size(self._policy, cost, self._waiting_seconds(), self._standings.ready)

    def _broke_down(self, entry: _Entry, answer: CellResult, worker: str) -> list[Completed]:
        """A worker that lives reported that a cell gave no result."""
        entry.witnesses.add(worker)
        if len(entry.witnesses) >= WITNESSES:
            self._standings.confirmed(entry.witnesses)
        return self._again_or_failed(entry, answer, worker)

    def _again_or_failed(self, entry: _Entry, answer: CellResult, worker: str) -> list[Completed]:
        settled = answer.breakdown == Breakdown.ERROR and len(entry.witnesses) >= WITNESSES
        failed = settled or entry.attempts >= ATTEMPTS
        if not failed and not entry.withdrawn:
            self._suspects.setdefault((_key(entry.setup), entry.avoid), deque()).append(entry)
            return []
        del self._by_id[entry.cell.id]
        # a withdrawn cell had fewer attempts than it was due: it has not failed, it was not simulated
        return [Completed(entry.tag, worker, answer, entry.attempts)] if failed else []

    def _take_back(self, entries: list[_Entry]) -> None:
        """A worker refused these cells: they wait as before, as if they had not been sent."""
        for entry in reversed(entries):
            entry.attempts -= 1
            setup = _key(entry.setup)
            if entry.withdrawn:
                del self._by_id[entry.cell.id]
            elif entry.attempts:
                self._suspects.setdefault((setup, entry.avoid), deque()).appendleft(entry)
            else:
                self._waiting.setdefault(entry.priority, {}).setdefault(setup, deque()).appendleft(entry)

    def _is_alone(self, worker: str) -> bool:
        """True where a cell broke down at this worker and there is nobody else to try."""
        return any(worker in avoid and not self._standings.candidates(setup, avoid) for setup, avoid in self._suspects)

    def _take_suspect(self, setup: _SetupKey, avoid: frozenset[str], suspects: deque[_Entry]) -> _Entry:
        self._passed_over = 0
        entry = suspects.popleft()
        if not suspects:
            del self._suspects[setup, avoid]
        return entry

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
