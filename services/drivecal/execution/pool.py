"""The work pool, a thin driver between `Scheduler`, `Leases` and `Backend`: takes cells and returns results."""

import logging
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from drivecal.contracts.inventory import ResourceAnswer
from drivecal.contracts.work import Batch, BatchResult, SetupRequest
from drivecal.domain.errors import UnavailableError
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.backend import Backend, Finished, Lost, WorkerInfo
from drivecal.execution.measures import DEPARTED, MEASURES
from drivecal.execution.scheduling.in_flight import Completed, Dispatch, RunBudget, Work
from drivecal.execution.scheduling.resources import Resources
from drivecal.execution.scheduling.scheduler import Scheduler
from drivecal.storage import leases
from drivecal.storage.engine.database import Database

ASK_AGAIN_SECONDS = 10.0
"""Pause after every worker failed to run a probe."""
FAILURES_TOLD = 20
"""Failures of a campaign logged in full; then only the 32nd, 64th, 128th and so on."""


@dataclass(slots=True)
class _Question:
    request: SetupRequest
    answer: str | None = None
    batch: int | None = None
    """The batch that asks, at a worker now."""
    refusals: dict[str, str] = field(default_factory=dict)
    """Reasons of workers that gave no answer in this round; kept during the pause after it."""
    trouble: str | None = None
    """The last of all reasons."""
    not_before: float = 0.0
    """The end of the pause after every worker failed; 0 during a round."""

    def refuse(self, worker: str, reason: str) -> None:
        """Notes why a worker gave no answer."""
        self.refusals[worker] = reason
        self.trouble = f"{worker} cannot run the probe of {self.request.problem}: {reason}"


class Questions:
    """Probes that campaigns wait for, by tag. Each is run by one worker, and by another if that one fails."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._open: dict[str, _Question] = {}
        self._last = 0

    def ask(self, request: SetupRequest, tag: str) -> str | None:
        """Returns the answer once a worker has given it, and forgets it; None until then."""
        question = self._open.setdefault(tag, _Question(request))
        if question.answer is not None:
            del self._open[tag]
        return question.answer

    def asks(self, tag: str) -> bool:
        """Returns whether a campaign waits for its answer."""
        return tag in self._open

    def forget(self, tag: str) -> None:
        """Drops the question of a campaign."""
        self._open.pop(tag, None)

    def batch_for(self, worker: str, ready: Collection[str]) -> tuple[int, Batch] | None:
        """Returns a question to send to a worker with a free slot, with its number: negative, as no other batch's is."""
        for question in self._open.values():
            if question.answer is not None or question.batch is not None or self._clock() < question.not_before:
                continue
            if question.not_before:  # the pause is over
                question.refusals.clear()
                question.not_before = 0.0
            if not set(ready) - question.refusals.keys():  # each has failed: from the start, after a pause
                question.not_before = self._clock() + ASK_AGAIN_SECONDS
            elif worker not in question.refusals:
                self._last -= 1
                question.batch = self._last
                return self._last, Batch(replace(question.request, tools=None), ())
        return None

    def answered(self, batch_id: int, result: BatchResult) -> None:
        """Takes an answer, or the reason for a missing one."""
        for question in self._sent(batch_id):
            question.answer = result.tools
            if result.tools is None:
                question.refuse(result.worker, result.refusal or "it gave no answer")

    def lost(self, event: Lost) -> None:
        """Notes that a worker was lost while it was asked, unless the question was taken back."""
        for question in self._sent(event.batch_id):
            if not event.is_back:
                question.refuse(event.worker, event.detail)

    def is_kept_from(self, worker: str) -> bool:
        """True if a campaign waits for an answer that this worker could not give."""
        return any(question.answer is None and worker in question.refusals for question in self._open.values())

    def trouble(self) -> str | None:
        """Returns why a campaign cannot start, or None."""
        return next((question.trouble for question in self._open.values() if question.trouble is not None), None)

    def _sent(self, batch_id: int) -> Iterator[_Question]:
        for question in self._open.values():
            if question.batch == batch_id:
                question.batch = None
                yield question


Counts = Mapping[int, int]
"""Numbers by cell id."""


class Leases:
    """Leases cells in the database before they are sent. A lease holds until the cell's answer is stored, or until it is given back."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def exchange(self, returned: Counts, wanted: Counts, *, unstarted: Counts, twice: Collection[int]) -> Mapping[int, int]:
        """Gives back the leases of the cells in `returned`, then leases those in `wanted`, all or nothing.

        Both map cell ids to the number of breakdowns so far. `unstarted`: starts of the simulator that did not happen for returned cells;
        `twice`: wanted cells that are simulated twice. Returns the lease number of each granted cell; the others belong to another
        process or have an answer. Raises UnavailableError if the outcome is unknown: call it again with the wanted cells given back;
        and SupersededError if another dispatcher was elected.
        """
        with MEASURES.lease.time(), self._database.transaction() as connection:
            leases.give_back(connection, returned, unstarted)
            return leases.take(connection, wanted, twice)


log = logging.getLogger(__name__)


class WorkPool:
    """Simulates cells on a backend's workers, in batches, and retries lost cells. Not thread-safe. Results are in order of arrival."""

    def __init__(
        self, backend: Backend, leases: Leases, clock: Callable[[], float] = time.monotonic, resources: Resources | None = None
    ) -> None:
        """Makes a pool.

        Args:
            backend: the workers.
            leases: leases the cells before they are sent.
            clock: returns seconds.
            resources: licences and other scarce things, by default none.
        """
        self._backend = backend
        self._leases = leases
        self._scheduler = Scheduler(resources)
        self._clock = clock
        self._sent: dict[int, Dispatch] = {}
        self._numbers: dict[int, int] = {}
        """Lease numbers of cells at workers."""
        self._returned: dict[int, int] = {}
        """Breakdowns of cells whose leases the next exchange gives back."""
        self._unstarted: dict[int, int] = {}
        """Starts of the simulator that did not happen for these cells."""
        self._completed: list[Completed] = []
        self._questions = Questions(clock)
        self._observer = Observer()

    def workers(self) -> list[WorkerInfo]:
        """Returns the backend's workers."""
        return self._backend.workers()

    def trouble(self) -> str | None:
        """Returns the reason for missing or refusing workers, or None."""
        return "; ".join(filter(None, (self._backend.trouble(), self._scheduler.trouble(), self._questions.trouble()))) or None

    def waits(self, tag: str, *, wholly: bool = False) -> str | None:
        """Returns why cells of the campaign `tag` wait for something else than their turn, or None. `wholly`: and none is at a worker."""
        reason, waits = self._scheduler.waits(tag, wholly=wholly), self._scheduler.held(tag) or self._questions.asks(tag)
        if reason is None and waits and all(each.state == "starting" for each in self._backend.workers()):
            return "no worker is ready yet; a first start compiles, which takes up to minutes"
        return reason

    def resources(self) -> list[ResourceAnswer]:
        """Returns the use of each resource."""
        return self._scheduler.resources()

    def probe(self, request: SetupRequest, tag: str) -> str | None:
        """Returns what the `probe` of a bundle answers on a worker; None until one has answered, so call it again."""
        return self._questions.ask(request, tag)

    def hopeless(self, tag: str) -> str | None:
        """Returns the reasons if no worker can run a problem of the campaign `tag`, or none has the tools that it began with, else None."""
        return self._scheduler.hopeless(tag)

    def submit(self, *work: Work, tag: str, priority: int = 0, budget: RunBudget | None = None) -> None:
        """Queues cells and sends as many as workers have room for. Higher priorities go first. `tag` names the cells for `withdraw`;
        `budget` limits how often cells of this tag are tried again.

        Submit the setups of a generation together: with one after the other, all workers would take the first.
        Raises ValueError if a cell is in flight already, and UnavailableError if no cell can be leased: the cells then wait.
        """
        self._scheduler.forget_disputes()
        if budget is not None:
            self._scheduler.limit(tag, budget)
        for cells in work:
            self._scheduler.add(cells, tag, priority)
        self._fill()

    def poll(self, timeout: float, *, feeds: bool = True) -> list[Completed]:
        """Waits up to `timeout` seconds for results, and `feeds` the workers. Every submitted cell comes back exactly once, with a result
        or with a `breakdown` after its last attempt. A cell without a lease is forgotten: it is answered or simulated elsewhere. Returns
        earlier, perhaps empty, when a batch is lost.

        Raises UnavailableError if nothing can be leased; the next call returns the results. Raises BackendLostError.
        """
        if feeds:
            self._fill()
        events = self._backend.wait(timeout)
        self._scheduler.refusals.now = self._clock()
        for event in events:
            self._completed += self._take_in(event)
        if feeds:
            self._fill()
        completed, self._completed = self._completed, []
        return completed

    def withdraw(self, tag: str) -> int:
        """Drops the cells of `tag` that are not at a worker. Returns how many are; `poll` still returns these unless their worker dies. The
        tag is free when `held(tag)` is 0."""
        self._questions.forget(tag)
        return self._scheduler.withdraw(tag)

    def keep(self, tag: str, cells: Collection[int]) -> set[int]:
        """Returns the cells of `tag` that have not come back: do not submit these. A withdrawal no longer holds for those among `cells`."""
        return self._scheduler.keep(tag, cells) | {entry.result.id for entry in self._completed if entry.tag == tag}

    def held(self, tag: str) -> int:
        """Returns the number of cells of `tag` that have not come back."""
        return self._scheduler.held(tag) + sum(completion.tag == tag for completion in self._completed)

    def give_back(self, unwanted: Sequence[Completed]) -> None:
        """Gives back unstored results: their cells may be leased again."""
        leased = [entry for entry in unwanted if not entry.shared]
        self._returned |= {entry.result.id: entry.attempts - 1 for entry in leased}
        self._unstarted |= {entry.result.id: entry.unstarted for entry in leased}

    def _take_in(self, event: Finished | Lost) -> list[Completed]:
        if event.batch_id < 0:
            self._take_answer(event)
            return []
        dispatch = self._sent.pop(event.batch_id, None)
        scheduler = self._scheduler
        finished = scheduler.finished(event.batch_id, event.result) if isinstance(event, Finished) else scheduler.lost(event)
        if dispatch is None:  # it came back before, and the scheduler ignored it too
            return []
        numbers = {cell: self._numbers.pop(cell, None) for cell in dispatch.breakdowns}
        unstarted = _unstarted(dispatch, event)
        completed = [
            replace(entry, lease=numbers.get(entry.result.id), unstarted=unstarted.get(entry.result.id, 0))
            for entry in finished
        ]
        final = {entry.result.id for entry in completed}
        self._unstarted |= {cell: count for cell, count in unstarted.items() if cell not in final}
        # leases of cells without a final answer are given back, with their breakdowns
        broken = breakdowns(dispatch, event)
        self._returned |= {cell: count + (cell in broken) for cell, count in dispatch.breakdowns.items() if cell not in final}
        self._returned |= self._scheduler.take_breakdowns()
        self._observer.came_back(dispatch, event, completed)
        return completed

    def _take_answer(self, event: Finished | Lost) -> None:
        if isinstance(event, Finished):
            self._questions.answered(event.batch_id, event.result)
            self._scheduler.refusals.note(event.result.worker, None, event.result.refusal)
        else:
            self._questions.lost(event)
            if not event.is_back:
                self._scheduler.refusals.note(event.worker, None, event.detail)  # it may live

    def _fill(self) -> None:
        """Fills the free slots. Replaces idle workers that nothing can be sent to, and asks busy workers again that refused a setup."""
        nodes = {worker.id: worker.node for worker in self._backend.workers() if worker.state != "starting"}
        ready = list(nodes)
        self._scheduler.meet(ready, self._clock(), nodes)
        for slot in self._backend.slots():
            question = self._questions.batch_for(slot.worker, ready)
            if question is not None:
                self._backend.submit(slot.worker, *question, None, alone=False)
        while True:
            wanted = [self._scheduler.next_batch(slot.worker, idle=slot.idle) for slot in self._backend.slots()]
            dispatches = [cell for cell in wanted if cell is not None]
            for dispatch in self._lease(dispatches):
                self._backend.submit(
                    dispatch.worker, dispatch.batch_id, dispatch.batch, dispatch.expected_seconds, alone=dispatch.alone
                )
                self._sent[dispatch.batch_id] = dispatch
            if not dispatches:
                break
        idle = {slot.worker for slot in self._backend.slots() if slot.idle}
        for worker in idle:
            self._replace_if_needed(worker)
        self._scheduler.refusals.ask_busy(idle)

    def _lease(self, dispatches: Sequence[Dispatch]) -> list[Dispatch]:
        """Leases the cells of a round's dispatches at once and gives back due leases; returns the dispatches to send."""
        if not dispatches and not self._returned:
            return []
        cells = {cell: count for dispatch in dispatches for cell, count in dispatch.breakdowns.items()}
        twice = {cell.id for dispatch in dispatches for cell in dispatch.batch.cells if cell.check}
        try:
            granted = self._leases.exchange(self._returned, cells, unstarted=self._unstarted, twice=twice)
        except UnavailableError:
            for dispatch in reversed(dispatches):
                self._scheduler.take_back(dispatch.batch_id)
            self._returned |= cells  # they may be leased, with only the answer lost: then they count as started
            self._unstarted = {cell: count for cell, count in self._unstarted.items() if cell not in cells}
            raise
        self._returned.clear()
        self._unstarted.clear()
        self._numbers |= granted
        left = (
            dispatch if granted.keys() >= dispatch.breakdowns.keys() else self._drop(dispatch, granted)
            for dispatch in dispatches
        )
        return [dispatch for dispatch in left if dispatch is not None]

    def _drop(self, dispatch: Dispatch, granted: Mapping[int, int]) -> Dispatch | None:
        refused = dispatch.breakdowns.keys() - granted.keys()
        log.warning("cells that are answered or simulated elsewhere are not simulated again: %s", sorted(refused))
        return self._scheduler.drop(dispatch.batch_id, refused)

    def _replace_if_needed(self, worker: str) -> None:
        fault, refusals = self._scheduler.fault(worker), self._scheduler.refusals
        gives_no_versions = self._questions.is_kept_from(worker) and refusals.is_overdue(worker, [None])
        if fault is not None or self._scheduler.is_stuck(worker) or gives_no_versions:
            self._backend.replace(worker, fault)


def _unstarted(dispatch: Dispatch, event: Finished | Lost) -> dict[int, int]:
    """Returns by cell how many of the starts that its lease counts did not happen. A batch that a lost worker had begun counts as started,
    unless its starts are known. A busy simulator was started for the first cell that it left."""
    planned = {cell.id: 1 + cell.check for cell in dispatch.batch.cells}
    if isinstance(event, Lost) and event.begun and event.starts is not None:
        return {cell: max(0, count - event.starts.get(cell, 0)) for cell, count in planned.items()}
    if isinstance(event, Lost):
        return dict.fromkeys(planned, 0) if event.begun else planned
    started = {answer.id: answer.starts for answer in event.result.results}
    left = {cell: count for cell, count in planned.items() if cell not in started}
    if event.result.busy is not None:
        started |= dict.fromkeys(list(left)[:1], 1)
    elif event.result.refusal is None:
        started |= left
    return {cell: count - started.get(cell, 0) for cell, count in planned.items()}


class Observer:
    """Reports every returned batch."""

    def __init__(self) -> None:
        self._failures: Counter[str] = Counter()

    def came_back(self, dispatch: Dispatch, event: Finished | Lost, completed: Collection[Completed]) -> None:
        """Notes a returned batch; its cells that are not `completed` are sent again."""
        broken = breakdowns(dispatch, event)
        if isinstance(event, Finished):
            result = event.result
            if result.refusal is None and dispatch.batch.cells:
                MEASURES.batch.observe(result.seconds)
            if result.busy is not None:
                MEASURES.busy_answers.inc()
            for answer in result.results:
                if answer.breakdown is None:
                    MEASURES.evaluation.observe(answer.milliseconds / 1000)
        elif event.departed and event.begun:
            MEASURES.breakdowns.labels(DEPARTED).inc()
        for kind in broken.values():
            MEASURES.breakdowns.labels(kind).inc()
        for cell in broken.keys() - {completion.result.id for completion in completed}:
            MEASURES.retries.labels(broken[cell]).inc()
        for failed in completed:
            if failed.result.breakdown is not None:
                self._tell_failure(failed)

    def _tell_failure(self, completed: Completed) -> None:
        """Logs the first failures of a campaign, then fewer and fewer: thousands may be alike."""
        self._failures[completed.tag] += 1
        count = self._failures[completed.tag]
        if count <= FAILURES_TOLD or count.bit_count() == 1:
            result = completed.result
            log.warning(
                "cell %d has no result after %d attempts (%s, at last on %s; failure %d of this campaign): %s",
                *(result.id, completed.attempts, result.breakdown, completed.worker, count, result.detail),
                extra={"campaign": completed.tag},
            )


def breakdowns(dispatch: Dispatch, event: Finished | Lost) -> Mapping[int, str]:
    """Returns the kind of breakdown by cell id. Cells have none that a refusal or a busy simulator leaves, whose worker left,
    or that it had not begun."""
    if isinstance(event, Lost):
        return {} if event.departed else dict.fromkeys(event.blamed(dispatch.breakdowns), event.breakdown.value)
    result: BatchResult = event.result
    answered = {answer.id: answer.breakdown for answer in result.results}
    missing = None if result.refusal is not None or result.busy is not None else Breakdown.ERROR.value
    kinds = ((cell, answered.get(cell, missing)) for cell in dispatch.breakdowns)
    return {cell: kind for cell, kind in kinds if kind is not None}
