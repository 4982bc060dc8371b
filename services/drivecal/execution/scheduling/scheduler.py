"""Chooses the next cells for a worker and handles breakdowns: a pure state machine without clock or I/O.

Campaigns of equal priority share the workers' time (`queue`), identical cells are simulated once (`in_flight`), and workers seldom load
another scenario. The loss of a worker makes each cell that it had begun a suspect, or its batch if that is unknown. A suspect is sent
alone to an idle worker, so that a poison cell harms no other cell. After `ATTEMPTS` breakdowns a cell has failed; innocent cells succeed at
once.

A worker that leaves, killed from outside or with its node, is no fault of its cells: they go to another worker. Two such losses make a
suspect as well, and a cell that lost `MOST_LOSSES` workers, the last ones alone, has failed: it may kill them after all.

A living worker that reports a breakdown may itself be to blame. Its cells are suspects too, but go to another worker, or to the
replacement of the only worker. A refusal of a setup says nothing about the cells: they wait for another worker.
"""

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from drivecal.contracts.inventory import ResourceAnswer
from drivecal.contracts.work import Batch, BatchResult, CellResult, SetupKey, SetupRequest
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.backend import Lost
from drivecal.execution.scheduling.affinity import SetupAffinity
from drivecal.execution.scheduling.batching import TARGET_SECONDS, CellCosts, batch_size
from drivecal.execution.scheduling.in_flight import WITNESSES, Claim, Completed, Dispatch, InFlightCells, RunBudget, Work
from drivecal.execution.scheduling.queue import ClaimGroup, FairQueue, Line
from drivecal.execution.scheduling.refusals import Refusals
from drivecal.execution.scheduling.reservation import Reservation
from drivecal.execution.scheduling.resources import Resources
from drivecal.execution.scheduling.worker_health import WorkerHealth
from drivecal.plugins.simulators import END_SECONDS

ATTEMPTS = 3
"""Breakdowns after which a cell has failed."""
MOST_LOSSES = 10
"""Workers that leave with a cell before it has failed: at workers that live through half of their runs, one cell in a thousand."""
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

    def __init__(self, resources: Resources | None = None) -> None:
        """`resources`: the scarce things of the server, by default none."""
        self._resources = resources or Resources({})
        self._is_scarce = False
        """True once a setup needed resources, or was busy; before, nothing is asked about resources."""
        self._closing: dict[int, tuple[str, SetupRequest]] = {}
        """Setups that workers are asked to close, by batch."""
        self._costs = CellCosts()
        self._in_flight = InFlightCells()
        self._queue = FairQueue()
        self._reservation = Reservation()
        self.refusals = Refusals()
        self._worker_health = WorkerHealth(self.refusals)
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
        self._is_scarce |= bool(work.setup.resources)
        cost, had_none = self._costs.seconds_per_cell(setup), not self._in_flight.of(tag)
        claims = self._in_flight.add(work, tag, priority)
        if claims:
            self._reservation.given(tag, priority, None if cost is None else cost * len(claims), had_none=had_none)
        for claim in claims:
            simulation = claim.simulation
            count = min(work.breakdowns.get(claim.cell.id, 0), ATTEMPTS - 1)
            if count > simulation.breakdowns:  # a suspect now
                self._queue.withdraw(simulation)
                simulation.breakdowns = count
                if simulation.leader is None:
                    self._queue.put(simulation)
            elif simulation.leader is None:
                self._queue.join(claim)

    def meet(self, ready: Sequence[str], now: float = 0.0, nodes: Mapping[str, str] | None = None) -> None:
        """Notes which workers have started and live, the time (s), and the nodes by worker, by default a node for each."""
        self.refusals.meet({worker: worker for worker in ready} if nodes is None else nodes, now)
        self._reservation.meet(now)
        self._worker_health.meet(ready)
        self._resources.meet(ready, now)
        self._affinity.meet(ready)

    def next_batch(self, worker: str, *, idle: bool) -> Dispatch | None:
        """Returns the batch for a free slot of a worker, or None. A suspect is sent alone and never behind a running batch; until then its
        worker gets nothing. A worker to be replaced gets nothing either. A worker with resources closes their setup before another.
        Resources that a campaign lacks when its turn comes are kept for it: it would wait for a second licence for ever."""
        if self.fault(worker) is not None:
            return None
        only_short = False
        self._resources.kept_back = set()
        for line in self._queue.in_turn():
            if not self._has_startable(worker, line):
                self._keep_back(worker, line)
                continue
            only_short = only_short or not self._may_be_long(worker, line)
            group = self._suspects_for(worker, line, only_short=only_short)
            if group is not None:
                if not idle:
                    return None
                if (closing := self._close(worker, group.setup)) is not None:
                    return closing
                self._passed_over *= not group.avoid
                return self._dispatch(worker, group, 1)
            group = self._group_for(worker, line, only_short=only_short)
            if group is not None:
                if not idle and not self._resources.may_queue(worker, self._in_flight.setup(group.setup)):
                    return None
                if idle and (closing := self._close(worker, group.setup)) is not None:
                    return closing
                if self._is_alone(worker):
                    if self._passed_over >= MOST_PASSED_OVER:
                        return None
                    self._passed_over += 1
                return self._dispatch(worker, group, self._size(worker, group))
            self._keep_back(worker, line)
        return self._close(worker, None) if idle else None

    def take_back(self, batch_id: int) -> None:
        """A dispatch was not sent after all: its cells return to the front of their queues, as if they had not been taken out."""
        if self._is_closed(batch_id, done=False):
            return
        sent = self._sent.pop(batch_id)
        self._resources.end(sent.worker, sent.leaders[0].simulation.setup)
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
        self._resources.end(sent.worker, dropped[0].simulation.setup)
        self._charge(self._sent.pop(batch_id), 0.0)
        return None

    def take_breakdowns(self) -> dict[int, int]:
        """Returns the breakdowns of outstanding cells, by id, that changed since the last call: to be stored for the next scheduler."""
        changed, self._changed = self._changed, {}
        return changed

    def fault(self, worker: str) -> str | None:
        """Returns the reason to replace a worker that never has results, or None."""
        return self._worker_health.fault(worker)

    def is_stuck(self, worker: str) -> bool:
        """Returns whether an idle worker keeps cells waiting: no other can try a cell that broke down there, or it long refused some."""
        return self._is_alone(worker) or self.refusals.is_overdue(worker, self._queue.setups())

    def hopeless(self, tag: str) -> str | None:
        """Returns the reasons if no worker will run a setup of `tag`, else None."""
        return self.refusals.hopeless(self.setups(tag)) if self.refusals.are_disputed else None

    def forget_disputes(self) -> None:
        """Drops the disputes of setups that no campaign waits for."""
        if self.refusals.are_disputed:
            self.refusals.keep(self.setups())

    def trouble(self) -> str | None:
        """Returns a message about workers that refuse waiting setups, or None."""
        setups = self._in_flight.setups()
        refusals = self.refusals.reasons(setups)
        if not refusals:
            return None
        scenarios = sorted({cell.scenario for setup, cell in setups.items() if self.refusals.reasons({setup})})
        worker, reason = next(iter(refusals.items()))
        number = f"{len(refusals)} workers refuse" if len(refusals) > 1 else f"{worker} refuses"
        return f"{number} {', '.join(scenarios)}: {reason}"

    def finished(self, batch_id: int, result: BatchResult) -> list[Completed]:
        """Takes the results of a batch; an unexpected batch changes nothing."""
        sent = self._sent.pop(batch_id, None)
        if sent is None:
            self._is_closed(batch_id, done=True)
            return []
        setup, request = sent.leaders[0].simulation.key, sent.leaders[0].simulation.setup
        self.refusals.answered(request, result, is_wanted=any(not leader.withdrawn for leader in sent.leaders))
        self._worker_health.answered(result.worker, result)
        self._resources.end(sent.worker, request, closed=result.refusal is not None)
        self._resources.note(sent.worker, request, result.busy)
        self._is_scarce |= result.busy is not None
        is_stopped = result.refusal is not None or result.busy is not None
        self._charge(sent, result.seconds if result.results or not is_stopped else 0.0)
        answers = {answer.id: answer for answer in result.results}
        if is_stopped:
            self._to_queue([leader for leader in sent.leaders if leader.cell.id not in answers])
            sent.leaders = [leader for leader in sent.leaders if leader.cell.id in answers]
        elif result.results:
            self._costs.observe(setup, len(sent.leaders), result.seconds)
            self._reservation.answered(sent.line, self._costs.seconds_per_cell(setup))
        completed = []
        for leader in sent.leaders:
            answer = answers.get(leader.cell.id) or _broken(leader, Breakdown.ERROR, "the worker returned no result for it")
            self._affinity.came_back(setup, failed=answer.breakdown is not None)
            if answer.breakdown is None:
                completed += self._complete(leader, answer, result.worker, leader.simulation.breakdowns + 1)
            else:
                completed += self._broke_down(leader, answer, result.worker, alone=sent.alone)
        return completed

    def lost(self, event: Lost) -> list[Completed]:
        """Takes the loss of a batch: the blamed cells are tried again one by one, and fail without attempts left, or without a budget for
        another one. A cell without a start takes nothing from a budget. The breakdown is `ERROR` if the worker lives."""
        if event.is_back:
            self.take_back(event.batch_id)
            return []
        worker = event.worker
        if event.breakdown is not Breakdown.ERROR:
            self._resources.leave(worker)
        sent = self._sent.pop(event.batch_id, None)
        if sent is None:
            self._is_closed(event.batch_id, done=False)
            return []
        self._resources.end(worker, sent.leaders[0].simulation.setup)
        self._charge(sent, sent.charged if event.seconds is None else event.seconds)
        self._affinity.came_back(sent.leaders[0].simulation.key, failed=True)
        answers = [(leader, _broken(leader, event.breakdown, event.detail)) for leader in sent.leaders]
        if event.breakdown is not Breakdown.ERROR:  # the worker is gone as well
            completed: list[Completed] = []
            blamed = event.blamed([leader.cell.id for leader in sent.leaders])
            for leader, answer in answers:
                is_blamed = leader.cell.id in blamed
                if event.departed or not is_blamed:
                    completed += self._after_departure(leader, answer, worker, alone=sent.alone, blamed=is_blamed)
                else:
                    begun = event.starts is None or leader.cell.id in event.starts
                    completed += self._again_or_failed(leader, answer, worker, alone=sent.alone, begun=begun)
            return completed
        self._worker_health.failed(worker, event.detail)
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
        self.forget_disputes()
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

    def waits(self, tag: str, *, wholly: bool = False) -> str | None:
        """Returns why cells of `tag` wait for something else than their turn, or None. `wholly`: and no cell of it is at a worker."""
        if wholly and any(claim.simulation.leader is not None for claim in self._in_flight.of(tag)):
            return None
        reasons: dict[str, list[str]] = {}
        for key in self._queue.setups(tag) if self._is_scarce else ():
            setup = self._in_flight.setup(key)
            if (reason := self._resources.why(setup)) is not None:
                reasons.setdefault(reason, []).append(setup.scenario)
        said = [f"{', '.join(sorted(set(scenarios)))}: {reason}" for reason, scenarios in sorted(reasons.items())]
        if not said and (higher := self._higher_than(tag)) is not None:
            said.append(f"all workers are at campaigns of a higher priority, up to {higher}")
        return f"cells wait; {'; '.join(said)}" if said else None

    def _higher_than(self, tag: str) -> int | None:
        """Returns the highest priority with waiting cells if it keeps all workers from a campaign, else None."""
        first = next(self._queue.in_turn(), None)
        own = next(iter(self._in_flight.of(tag)), None)
        is_kept = first is not None and own is not None and first.priority > own.priority
        return first.priority if first and is_kept and all(sent.line.tag != tag for sent in self._sent.values()) else None

    def resources(self) -> list[ResourceAnswer]:
        """Returns the use of each resource."""
        return self._resources.use()

    def _has_startable(self, worker: str, line: Line) -> bool:
        """Returns whether a worker may start a cell of a line: its resources are free and its simulator is not busy."""
        return not self._is_scarce or any(self._may_start(worker, setup) for setup in line.setups)

    def _keep_back(self, worker: str, line: Line) -> None:
        for setup in line.setups if self._is_scarce else ():
            if worker not in self.refusals.refusing(setup):  # it would wait here in vain
                self._resources.keep_back(worker, self._in_flight.setup(setup))

    def _may_start(self, worker: str, setup: SetupKey) -> bool:
        return not self._is_scarce or self._resources.may_start(worker, self._in_flight.setup(setup))

    def _close(self, worker: str, chosen: SetupKey | None) -> Dispatch | None:
        """Returns the request to close a setup that holds resources at an idle worker, if there is one."""
        setup = self._resources.to_close(worker, None if chosen is None else self._in_flight.setup(chosen))
        if setup is None:
            return None
        batch_id = next(self._batch_ids)
        self._closing[batch_id] = worker, setup
        self._resources.close(worker, setup)
        return Dispatch(worker, batch_id, Batch(setup, (), closes=True), END_SECONDS, alone=False, breakdowns={})

    def _is_closed(self, batch_id: int, *, done: bool) -> bool:
        """Takes the answer to a request to close a setup; returns whether the batch is one."""
        worker, setup = self._closing.pop(batch_id, (None, None))
        if worker is not None and setup is not None:
            self._resources.closed(worker, setup, done=done)
        return setup is not None

    def _may_be_long(self, worker: str, line: Line) -> bool:
        """Returns whether a worker may run a long batch of a line now. If not, the lines behind it may not have one either."""
        if not any(self._is_long(setup) for setup in line.setups):
            return True
        waiting = [other for other in self._queue.in_turn() if self._has_startable(worker, other)]
        most = self._reservation.most(line, waiting, self._worker_health.ready)
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
            if self._worker_health.may_try(worker, setup, avoid)
            and not (only_short and self._is_long(setup))
            and self._may_start(worker, setup)
        )
        return next(able, None)

    def _group_for(self, worker: str, line: Line, *, only_short: bool) -> ClaimGroup | None:
        able = [
            group
            for setup, group in line.groups.items()
            if worker not in self.refusals.refusing(setup)
            and not (only_short and self._is_long(setup))
            and self._may_start(worker, setup)
        ]
        if self._is_scarce:  # what is scarce is never left to the end
            able = [group for group in able if self._in_flight.setup(group.setup).resources] or able
        cost = self._costs.seconds_per_cell
        chosen = self._affinity.choose(
            worker, {group.setup: group.waiting * (cost(group.setup) or TARGET_SECONDS) for group in able}
        )
        return None if chosen is None else line.groups[chosen]

    def _size(self, worker: str, group: ClaimGroup) -> int:
        if self._worker_health.on_probation(worker) or self._affinity.is_fruitless(group.setup):
            return 1
        cost = self._costs.seconds_per_cell(group.setup)
        waiting = self._costs.seconds(self._queue.waiting(group.line.priority))
        workers = self._worker_health.ready
        beside_small = self._reservation.is_beside_small(group.line, workers)
        return batch_size(cost, waiting, workers, beside_small=beside_small)

    def _dispatch(self, worker: str, group: ClaimGroup, most: int) -> Dispatch:
        sent = _Sent(worker, group.line, self._queue.take(group, most), alone=group.avoid is not None)
        for leader in sent.leaders:
            leader.simulation.leader = leader
        self._resources.take(worker, self._in_flight.setup(group.setup))
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
        self._charge(sent, TARGET_SECONDS if expected is None else expected)
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
        if begun:
            simulation.fault = f"{answer.breakdown}: {answer.detail or 'no message'}"
        completed: list[Completed] = []
        budget = self._budgets.get(leader.tag)
        if begun and not leader.withdrawn and budget is not None and not budget.take(leader.cell.id):
            completed.append(Completed(leader.tag, worker, answer, simulation.breakdowns))
            leader.withdrawn = True
        self._try_again(leader)
        self._changed |= {claim.cell.id: simulation.breakdowns for claim in simulation.claims}
        return completed

    def _after_departure(self, leader: Claim, answer: CellResult, worker: str, *, alone: bool, blamed: bool) -> list[Completed]:
        """Handles a cell whose worker left, or ended without its doing: the run takes neither an attempt nor a part of the budget."""
        simulation = leader.simulation
        simulation.losses += blamed
        if alone and simulation.losses >= MOST_LOSSES:
            detail = f"{answer.detail}; {simulation.losses} workers left with this cell, the last ones while it ran alone"
            return self._complete(leader, replace(answer, detail=detail), worker, max(1, simulation.breakdowns))
        self._try_again(leader)
        return []

    def _try_again(self, leader: Claim) -> None:
        """Queues the simulation of a lost cell again, without a cell that its campaign dropped: it was not simulated."""
        simulation = leader.simulation
        simulation.leader = None
        if leader.withdrawn:
            self._forget(leader)
        if simulation.is_suspect:  # it is simulated once
            for claim in simulation.claims:
                claim.cell = replace(claim.cell, check=False)
        self._queue.put(simulation)

    def _complete(self, leader: Claim, answer: CellResult, worker: str, attempts: int) -> list[Completed]:
        simulation = leader.simulation
        if answer.breakdown is None and simulation.fault is not None:
            answer = replace(answer, detail=simulation.fault)
        completed = [Completed(leader.tag, worker, answer, attempts)]
        self._forget(leader)
        for follower in list(simulation.claims):
            its = replace(answer, id=follower.cell.id)
            completed.append(Completed(follower.tag, worker, its, attempts, shared=True))
            self._forget(follower)
        return completed

    def _forget(self, claim: Claim) -> None:
        self._queue.leave(claim)
        self._in_flight.remove(claim)
        self._changed.pop(claim.cell.id, None)

    def _is_alone(self, worker: str) -> bool:
        """Returns whether a cell broke down at this worker and no other can try it."""
        return any(not self._worker_health.able(cell.setup, cell.avoid or ()) for cell in self._queue.avoiding(worker))


def _broken(leader: Claim, breakdown: Breakdown, detail: str) -> CellResult:
    return CellResult(leader.cell.id, None, None, {}, None, 0.0, breakdown.value, detail)
