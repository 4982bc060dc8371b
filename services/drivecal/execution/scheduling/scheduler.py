"""Chooses the next cells for a worker and handles breakdowns: a pure state machine without clock or I/O.

Campaigns of equal priority share the workers' time (`queue`), identical cells are simulated once (`in_flight`), and workers seldom load
another scenario. The loss of a worker makes each cell of its batch a suspect, which is then sent alone to an idle worker, so that a poison
cell harms no other cell. After `ATTEMPTS` breakdowns a cell has failed; innocent cells succeed at once.

A living worker that reports a breakdown may itself be to blame. Its cells are suspects too, but go to another worker, or to the
replacement of the only worker. A refusal of a setup says nothing about the cells: they wait for another worker.
"""

import itertools
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial

from drivecal.contracts.work import Batch, BatchResult, CellResult, SetupKey
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.scheduling.affinity import SetupAffinity
from drivecal.execution.scheduling.batching import BatchPolicy, CellCosts, batch_size
from drivecal.execution.scheduling.in_flight import (
    WITNESSES,
    Claim,
    Completed,
    Dispatch,
    InFlightCells,
    Replacement,
    RunBudget,
    Work,
)
from drivecal.execution.scheduling.queue import ClaimGroup, FairQueue, Line
from drivecal.execution.scheduling.reservation import Reservation
from drivecal.execution.scheduling.worker_health import WorkerHealth

ATTEMPTS = 3
"""Breakdowns after which a cell has failed."""
MOST_PASSED_OVER = 100
"""Batches after which a suspect no longer waits for its only worker to run idle."""


@dataclass(slots=True)
class _Sent:
    """Cells at a worker, and the time charged to their line."""

    worker: str
    line: Line
    leaders: list[Claim]
    alone: bool
    charged: float = 0.0


class Scheduler:
    """Completes every added cell exactly once, unless it is withdrawn before it is sent or while it is lost."""

    def __init__(self, policy: BatchPolicy) -> None:
        self._policy = policy
        self._costs = CellCosts()
        self._in_flight = InFlightCells()
        self._queue = FairQueue()
        self._reservation = Reservation()
        self._worker_health = WorkerHealth()
        self._affinity = SetupAffinity()
        self._passed_over = 0
        """Batches sent to a worker while a suspect waited for its replacement."""
        self._sent: dict[int, _Sent] = {}
        self._changed: dict[int, int] = {}
        """Breakdowns that are not reported yet."""
        self._budgets: dict[str, RunBudget] = {}
        self._batch_ids = itertools.count(1)

    def limit(self, tag: str, budget: RunBudget) -> None:
        """Sets the budget of a campaign: from now on its cells are tried again as long as that lasts."""
        self._budgets[tag] = budget

    def add(self, work: Work, tag: str, priority: int = 0) -> None:
        """Queues cells of the campaign `tag`; each gets at least one attempt, whatever its earlier breakdowns.

        A cell identical to one in flight (setup, evaluator, and every bit of the parameters) is not sent and takes the other's answer,
        unless either is `exclusive`. Raises ValueError if a cell is in flight already.
        """
        setup = work.setup.key
        self._costs.relate(setup, work.setup.kind)
        cost, had_none = self._costs.seconds_per_cell(setup), not self._in_flight.of(tag)
        claims = self._in_flight.add(work, tag, priority)
        if claims:
            self._reservation.given(tag, priority, None if cost is None else cost * len(claims), had_none=had_none)
        for claim in claims:
            simulation = claim.simulation
            count = min(work.breakdowns.get(claim.cell.id, 0), ATTEMPTS - 1)
            if count > simulation.breakdowns:  # a suspect from now on
                self._queue.withdraw(simulation)
                simulation.breakdowns = count
                if simulation.leader is None:
                    self._queue.put(simulation)
            elif simulation.leader is None:
                self._queue.join(claim)

    def meet(self, ready: Sequence[str], now: float = 0.0) -> None:
        """Notes which workers have started and live, and the time (s)."""
        self._reservation.meet(now)
        self._worker_health.meet(ready)
        self._affinity.meet(ready)

    def next_batch(self, worker: str, *, idle: bool) -> Dispatch | None:
        """Returns the batch for a free slot of a worker, or None. A suspect is sent alone and never behind a running batch; until then its
        worker gets nothing. A worker to be replaced gets nothing either."""
        if self._worker_health.fault(worker) is not None:
            return None
        only_short = False
        for line in self._queue.in_turn():
            only_short = only_short or not self._may_be_long(worker, line)
            group = self._suspects_for(worker, line, only_short=only_short)
            if group is not None:
                if not idle:
                    return None
                self._passed_over *= not group.avoid
                return self._dispatch(worker, group, 1)
            group = self._group_for(worker, line, only_short=only_short)
            if group is not None:
                if self._is_alone(worker):
                    if self._passed_over >= MOST_PASSED_OVER:
                        return None
                    self._passed_over += 1
                return self._dispatch(worker, group, self._size(worker, group))
        return None

    def take_back(self, batch_id: int) -> None:
        """A dispatch was not sent after all: its cells return to the front of their queues, as if they had not been taken out."""
        sent = self._sent.pop(batch_id)
        self._charge(sent, 0.0)
        self._to_queue(sent.leaders)

    def drop(self, batch_id: int, cells: Collection[int]) -> Dispatch | None:
        """Forgets some cells of a dispatch that was not sent yet: they are neither completed nor held. Identical cells that waited for them
        wait for themselves. Returns the dispatch of what is left, to be sent in place of the first one; None if nothing is."""
        sent = self._sent[batch_id]
        dropped = [claim for claim in sent.leaders if claim.cell.id in cells]
        sent.leaders = [claim for claim in sent.leaders if claim.cell.id not in cells]
        for claim in dropped:
            claim.simulation.leader = None
            self._forget(claim)
        self._queue.put_back(dropped)
        if sent.leaders:
            return self._as_dispatch(batch_id, sent)
        self._charge(self._sent.pop(batch_id), 0.0)
        return None

    def take_breakdowns(self) -> dict[int, int]:
        """Returns the breakdowns of outstanding cells, by id, that changed since the last call: to be stored for the next scheduler."""
        changed, self._changed = self._changed, {}
        return changed

    def replacement(self, worker: str) -> Replacement | None:
        """Returns how to replace an idle worker without a batch: it never has results, or no other can try a cell that broke down at it."""
        fault = self._worker_health.fault(worker)
        return Replacement(fault) if fault is not None or self._is_alone(worker) else None

    def kept_from(self, worker: str) -> list[SetupKey]:
        """Returns the waiting setups that this worker refuses."""
        return [setup for setup in self._queue.setups() if self._worker_health.refuses(worker, setup)]

    def ask_again(self, worker: str, setup: SetupKey) -> None:
        """Lets a worker try a setup again that it refused."""
        self._worker_health.ask_again(worker, setup)

    def trouble(self) -> str | None:
        """Returns a message about workers that refuse waiting setups, or None."""
        setups = self._in_flight.setups()
        refusals = self._worker_health.refusals(setups)
        if not refusals:
            return None
        scenarios = sorted({cell.scenario for setup, cell in setups.items() if self._worker_health.refusals({setup})})
        worker, reason = next(iter(refusals.items()))
        number = f"{len(refusals)} workers refuse" if len(refusals) > 1 else f"{worker} refuses"
        return f"{number} {', '.join(scenarios)}: {reason}"

    def finished(self, batch_id: int, result: BatchResult) -> list[Completed]:
        """Takes the results of a batch; an unexpected batch changes nothing."""
        sent = self._sent.pop(batch_id, None)
        if sent is None:
            return []
        setup = sent.leaders[0].simulation.key
        self._worker_health.answered(result.worker, setup, result)
        self._charge(sent, result.seconds if result.refusal is None or result.results else 0.0)
        answers = {answer.id: answer for answer in result.results}
        if result.refusal is not None:
            self._to_queue([leader for leader in sent.leaders if leader.cell.id not in answers])
            sent.leaders = [leader for leader in sent.leaders if leader.cell.id in answers]
        elif result.results:
            self._costs.observe(setup, len(sent.leaders), result.seconds)
            self._reservation.answered(sent.line, self._costs.seconds_per_cell(setup))
        completed = []
        for leader in sent.leaders:
            answer = answers.get(leader.cell.id) or _broken(
                leader, Breakdown.ERROR, "the worker returned no result for this cell"
            )
            self._affinity.came_back(setup, failed=answer.breakdown is not None)
            if answer.breakdown is None:
                completed += self._complete(leader, answer, result.worker, leader.simulation.breakdowns + 1)
            else:
                completed += self._broke_down(leader, answer, result.worker, alone=sent.alone)
        return completed

    def is_wanted(self, batch_id: int) -> bool:
        """Whether a campaign that asked for a batch at a worker still waits for it."""
        return any(not leader.withdrawn for leader in self._sent[batch_id].leaders)

    def lost(
        self, batch_id: int, worker: str, breakdown: Breakdown, detail: str, seconds: float | None = None, *, begun: bool = True
    ) -> list[Completed]:
        """Takes the loss of a batch: its cells are tried again one by one, and fail without attempts left, or without a budget for another
        one. `seconds`: the worker's time, if known, which is charged to the campaign; `begun`: see `Lost`."""
        sent = self._sent.pop(batch_id, None)
        if sent is None:
            return []
        self._charge(sent, sent.charged if seconds is None else seconds)
        self._affinity.came_back(sent.leaders[0].simulation.key, failed=True)
        answers = [(leader, _broken(leader, breakdown, detail)) for leader in sent.leaders]
        if breakdown is not Breakdown.ERROR:  # the worker is gone as well
            again = partial(self._again_or_failed, worker=worker, alone=sent.alone, begun=begun)
            return [done for answer in answers for done in again(*answer)]
        self._worker_health.failed(worker, detail)
        return [done for answer in answers for done in self._broke_down(*answer, worker, alone=sent.alone)]

    def withdraw(self, tag: str) -> int:
        """Drops the cells of `tag` that are at no worker. Returns how many are: these complete unless lost."""
        running = 0
        for claim in list(self._in_flight.of(tag)):
            if claim.simulation.leader is claim:
                claim.withdrawn = True
                running += 1
            else:
                self._forget(claim)
        self._queue.forget(tag)
        self._reservation.forget(tag)
        self._budgets.pop(tag, None)
        return running

    def keep(self, tag: str, cells: Collection[int]) -> set[int]:
        """Returns the cells of `tag` without an answer. A withdrawal no longer holds for those among `cells`."""
        claims = self._in_flight.of(tag)
        for claim in claims:
            claim.withdrawn &= claim.cell.id not in cells
        return {claim.cell.id for claim in claims}

    def held(self, tag: str) -> int:
        """Cells of `tag` without an answer."""
        return len(self._in_flight.of(tag))

    def setups(self, tag: str | None = None) -> set[SetupKey]:
        """Setups of the cells of `tag` without an answer, or of all cells that are not withdrawn."""
        return self._in_flight.wanted() if tag is None else {claim.simulation.key for claim in self._in_flight.of(tag)}

    def _may_be_long(self, worker: str, line: Line) -> bool:
        """Whether a worker may run a long batch of a line now. Lines behind a line that may not have one must not have one either."""
        if not any(self._is_long(setup) for setup in (*line.groups, *(setup for setup, _ in line.suspects))):
            return True
        most = self._reservation.most(line, list(self._queue.in_turn()), self._worker_health.ready)
        if most >= self._worker_health.ready:
            return True
        long = {sent.worker for sent in self._sent.values() if sent.leaders and self._is_long(sent.leaders[0].simulation.key)}
        return worker not in long and len(long) < most

    def _is_long(self, setup: SetupKey) -> bool:
        return self._reservation.is_long(self._costs.seconds_per_cell(setup))

    def _suspects_for(self, worker: str, line: Line, *, only_short: bool) -> ClaimGroup | None:
        able = (
            group
            for (setup, avoid), group in line.suspects.items()
            if self._worker_health.may_try(worker, setup, avoid) and not (only_short and self._is_long(setup))
        )
        return next(able, None)

    def _group_for(self, worker: str, line: Line, *, only_short: bool) -> ClaimGroup | None:
        able = (
            group
            for setup, group in line.groups.items()
            if not self._worker_health.refuses(worker, setup) and not (only_short and self._is_long(setup))
        )
        chosen = self._affinity.choose(worker, {group.setup: self._to_do(group) for group in able})
        return None if chosen is None else line.groups[chosen]

    def _to_do(self, group: ClaimGroup) -> float:
        cost = self._costs.seconds_per_cell(group.setup)
        return group.waiting * (self._policy.target_seconds if cost is None else cost)

    def _size(self, worker: str, group: ClaimGroup) -> int:
        if self._worker_health.on_probation(worker) or self._affinity.is_fruitless(group.setup):
            return 1
        cost = self._costs.seconds_per_cell(group.setup)
        waiting = self._costs.seconds(self._queue.simulations(group.line.priority))
        workers = self._worker_health.ready
        beside_small = self._reservation.is_beside_small(group.line, workers)
        return batch_size(self._policy, cost, waiting, workers, beside_small=beside_small)

    def _dispatch(self, worker: str, group: ClaimGroup, most: int) -> Dispatch:
        sent = _Sent(worker, group.line, self._queue.take(group, most), alone=group.avoid is not None)
        for leader in sent.leaders:
            leader.simulation.leader = leader
        self._affinity.load(worker, group.setup)
        cells = len(self._in_flight.of(group.line.tag))
        self._reservation.sent(group.line, self._costs.seconds_per_cell(group.setup), cells)
        batch_id = next(self._batch_ids)
        self._sent[batch_id] = sent
        return self._as_dispatch(batch_id, sent)

    def _as_dispatch(self, batch_id: int, sent: _Sent) -> Dispatch:
        first = sent.leaders[0].simulation
        cost = self._costs.seconds_per_cell(first.key)
        expected = None if cost is None else cost * len(sent.leaders)
        self._charge(sent, self._policy.target_seconds if expected is None else expected)
        batch = Batch(first.setup, tuple(leader.cell for leader in sent.leaders))
        breakdowns = {leader.cell.id: leader.simulation.breakdowns for leader in sent.leaders}
        return Dispatch(sent.worker, batch_id, batch, expected, sent.alone, breakdowns)

    def _charge(self, sent: _Sent, seconds: float) -> None:
        """Corrects the charge of a batch to its line."""
        self._queue.charge(sent.line, seconds - sent.charged)
        sent.charged = seconds

    def _to_queue(self, leaders: Sequence[Claim]) -> None:
        """Returns cells to the queue as if they had not been sent."""
        for leader in leaders:
            leader.simulation.leader = None
            if leader.withdrawn:
                self._forget(leader)
        self._queue.put_back(leaders)

    def _broke_down(self, leader: Claim, answer: CellResult, worker: str, *, alone: bool) -> list[Completed]:
        """Handles a cell without a result at a living worker."""
        simulation = leader.simulation
        simulation.witnesses |= {worker}
        if len(simulation.witnesses) >= WITNESSES:
            self._worker_health.confirmed(simulation.witnesses)
        return self._again_or_failed(leader, answer, worker, alone=alone)

    def _again_or_failed(
        self, leader: Claim, answer: CellResult, worker: str, *, alone: bool, begun: bool = True
    ) -> list[Completed]:
        simulation = leader.simulation
        # a suspect may be in a batch all the same; a breakdown there proves nothing against it
        simulation.breakdowns = min(simulation.breakdowns + 1, ATTEMPTS if alone else ATTEMPTS - 1)
        settled = answer.breakdown == Breakdown.ERROR and len(simulation.witnesses) >= WITNESSES
        if settled or simulation.breakdowns >= ATTEMPTS:
            return self._complete(leader, answer, worker, simulation.breakdowns)
        simulation.leader = None
        completed: list[Completed] = []
        if leader.withdrawn:  # with attempts left it has not failed: it was not simulated
            self._forget(leader)
        elif begun and not self._budgets.get(leader.tag, RunBudget()).take():
            completed.append(Completed(leader.tag, worker, answer, simulation.breakdowns))
            self._forget(leader)
        for claim in simulation.claims:
            claim.cell = replace(claim.cell, check=False)  # a suspect is simulated once
            self._changed[claim.cell.id] = simulation.breakdowns
        self._queue.put(simulation)
        return completed

    def _complete(self, leader: Claim, answer: CellResult, worker: str, attempts: int) -> list[Completed]:
        """Completes the claims to a simulation."""
        simulation = leader.simulation
        completed = [Completed(leader.tag, worker, answer, attempts)]
        self._forget(leader)
        for follower in list(simulation.claims):
            its = replace(answer, id=follower.cell.id)
            completed.append(Completed(follower.tag, worker, its, attempts, leader=leader.cell.id))
            self._forget(follower)
        return completed

    def _forget(self, claim: Claim) -> None:
        self._queue.leave(claim)
        self._in_flight.remove(claim)
        self._changed.pop(claim.cell.id, None)

    def _is_alone(self, worker: str) -> bool:
        """Whether a cell broke down at this worker and no other can try it."""
        return any(self._worker_health.no_worker_left(cell.setup, cell.avoid or ()) for cell in self._queue.avoiding(worker))


def _broken(leader: Claim, breakdown: Breakdown, detail: str) -> CellResult:
    return CellResult(leader.cell.id, None, None, {}, None, 0.0, breakdown.value, detail)
