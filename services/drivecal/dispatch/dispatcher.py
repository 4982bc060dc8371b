"""The dispatcher: starts campaigns from the database, has their cells simulated and stores the results.

One thread does everything except the heartbeat and what optimizers compute; each database has one dispatcher. Its memory may be lost at
any moment: after a crash or a failed transaction, campaigns resume from their rows.
"""

import logging
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from datetime import timedelta
from functools import partial
from typing import Any

from sqlalchemy import Connection

from drivecal.campaigns.cells.planning import View
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.resolve.resolved_spec import problem_of
from drivecal.campaigns.resolve.workbench import stored_bundles, with_tools
from drivecal.campaigns.stages.campaign import SingleEvaluation, StagedCampaign, stages_of
from drivecal.campaigns.stages.leader import best_of_all
from drivecal.campaigns.stages.stage import Stage
from drivecal.configuration import logs
from drivecal.contracts.work import SetupRequest
from drivecal.dispatch.heartbeat import Waits
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import ConflictError, DrivecalError, SupersededError, UnavailableError
from drivecal.execution.backend import BackendLostError, WorkerInfo
from drivecal.execution.measures import MEASURES
from drivecal.execution.pool import WorkPool
from drivecal.execution.scheduling.in_flight import Completed, Work
from drivecal.plugins.arrays import DamagedArraysError
from drivecal.storage import campaigns, events, traces
from drivecal.storage.campaigns import CampaignHeading, StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now
from drivecal.storage.maintenance import deletion
from drivecal.storage.outside.sets import AWAITED

EVALUATION_PRIORITY = 1000
"""A user waits for a single evaluation; a campaign can wait a batch longer."""


@dataclass(slots=True)
class Active:
    """A campaign in work. `job` is None until it resumes from its rows. `unwritten`: results to store, also after a failed transaction."""

    campaign: CampaignHeading
    job: StagedCampaign | None = None
    beginning: StagedCampaign | None = None
    """A job that computes before its first cells; then it becomes the `job`."""
    unwritten: list[Completed] = field(default_factory=list)
    stopping: CampaignState | None = None
    """State after the last cell leaves the workers: cancelled or paused."""
    not_before: float = 0.0
    """Earliest time to resume."""
    moved_at: float | None = None
    """Time of the last result, or since when its cells wait; None while none waits or one is at a worker."""
    stalled: bool = False
    """True if an event was recorded for the stall; the next result ends it."""
    write_at: float = 0.0
    """Earliest time to store results while others are under way."""

    @property
    def tag(self) -> str:
        """The pool's tag for the campaign's cells."""
        return self.campaign.id

    @property
    def stage(self) -> Stage | None:
        """The running stage; None if it is not known yet, and after the last."""
        return None if self.job is None else self.job.stage

    @property
    def awaited(self) -> str | None:
        """The reason if another program has to act first."""
        job = self.job or self.beginning
        return AWAITED if job is not None and job.wait == "sets" else None

    @property
    def priority(self) -> int:
        """The priority of the campaign's cells."""
        return EVALUATION_PRIORITY if self.campaign.kind == "evaluation" else self.campaign.priority


Prober = Callable[[SetupRequest], str | None]
"""Returns what the `probe` of a bundle answers on a worker; None until one has answered."""


def take_up(database: Database, sequence: int, probe: Prober, workers: int = 1) -> StagedCampaign | None:
    """Returns a job that continues from the campaign's rows; None while `probe` has no answer for the campaign's bundle.

    Raises ConflictError if any version differs from its start.
    """
    campaign = database.query(campaigns.by_sequence, sequence)
    tools: str | None = (campaign.resolution or {}).get("tools")
    problem = problem_of(campaign, with_tools(stored_bundles(database), tools))
    request = problem.bench.to_probe
    if request is not None:
        tools = probe(request)
        if tools is None:
            return None
        problem = problem_of(campaign, with_tools(stored_bundles(database), tools))
    known = {} if tools is None else {"tools": tools}
    _pin(database, campaign, problem.resolution() | known, may_change=problem.bench.bundle.manifest.has_planner)
    if isinstance(problem, CalibrationProblem):
        return StagedCampaign(stages_of(database, campaign, problem, workers))
    traced = database.query(traces.is_made_by, campaign.sequence)
    view = View(campaign.sequence, campaign.watermark or 0, problem.bench, traced=traced)
    return StagedCampaign(iter([SingleEvaluation(database, campaign, problem, view)]))


def _pin(database: Database, campaign: StoredCampaign, resolution: Mapping[str, Any], *, may_change: bool) -> None:
    """Stores the versions that a campaign starts with, or checks that they are unchanged. `may_change`: until its first stage begins, they
    may differ from the versions at its submission."""
    begun = campaign.resolution
    may_change |= begun is not None and "tools" in resolution and "tools" not in begun
    if begun is None or (may_change and not campaign.stages):
        with database.transaction() as connection:
            campaigns.set_resolution(connection, campaign.sequence, resolution)
        return
    changed = [part for part in resolution if resolution[part] != begun.get(part)]
    if changed:
        raise ConflictError(
            f"the campaign was begun with another version of its {' and '.join(changed)}; submit it again: results of two versions"
            " cannot be compared"
        )


LOOK_SECONDS = 0.25
"""Interval between checks for new campaigns and requests."""
REPORT_SECONDS = 0.5
POLL_SECONDS = 0.1
TIDY_SECONDS, BUSY_TIDY_SECONDS = 60.0, 1.0
"""Intervals of tidying, and while there is more to remove than goes in a transaction."""
EVENTS_KEPT = timedelta(days=30)
"""Age of events after which they are forgotten; the last one of each campaign stays."""
TRACES_KEPT, MOST_TRACES = timedelta(days=1), 200
STALL_SECONDS = 600.0
"""Time without a result after which a campaign whose cells wait has stalled."""
MOST_BEGUN = 8
"""Most campaigns for each place. Campaigns that wait for sets of other programs take none, and go on at once when sets come."""
EXACT_PLACES = 100
"""Campaigns that are told their place in the queue: each start changes all of these rows."""
RETRY_SECONDS = 5.0
"""Delay before a campaign resumes whose cells were answered or simulated elsewhere."""

log = logging.getLogger(__name__)


class Dispatcher:
    """The dispatcher's loop. `report` receives workers, problems and waits twice a second, and raises if the dispatcher must end."""

    def __init__(
        self,
        database: Database,
        pool: WorkPool,
        report: Callable[[Sequence[WorkerInfo], str | None, Waits], None] = lambda *_: None,
        *,
        running_campaigns: int = 8,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """`running_campaigns` limits concurrent campaigns, without single evaluations."""
        self._database = database
        self._pool = pool
        self._take_report = report
        self._running_campaigns = running_campaigns
        self._clock = clock
        self._active: dict[int, Active] = {}
        self._in_line: list[CampaignHeading] = []
        """Campaigns that wait to be started, or to go on, in their order."""
        self._next_look = self._next_report = self._next_tidy = 0.0
        self._removal: Iterator[bool] = iter(())

    def run(self, stop: threading.Event) -> None:
        """Works until `stop` is set. Waits for a database that does not answer, and continues when it is back.

        Raises SupersededError and BackendLostError: another dispatcher continues, or this process must restart.
        """
        pause = 0.5
        while not stop.is_set():
            try:
                self.step()
                pause = 0.5
            except UnavailableError as error:
                log.warning("waiting for the database: %s", error)
                self._forget_jobs()
                self._report()
                stop.wait(pause)
                pause = min(2 * pause, 10.0)
        with suppress(UnavailableError, SupersededError, BackendLostError):  # what has come is simulated again then
            self._take(self._pool.poll(0.0, feeds=False))
            for active in list(self._active.values()):
                if active.job is not None and active.unwritten:
                    self._guarded(active, partial(self._record, active, active.job))

    def step(self) -> None:
        """Runs one round: report, check campaigns and requests, feed the workers, store results."""
        if self._clock() >= self._next_report:
            self._report()
            self._next_report = self._clock() + REPORT_SECONDS
        if self._clock() >= self._next_look:
            self._look()
            self._next_look = self._clock() + LOOK_SECONDS
        if self._clock() >= self._next_tidy:
            more = self._tidy()
            self._next_tidy = self._clock() + (BUSY_TIDY_SECONDS if more else TIDY_SECONDS)
        for active in list(self._active.values()):
            stage = None if active.stage is None else active.stage.name
            with logs.about(campaign=active.campaign.id, campaign_name=active.campaign.name, stage=stage):
                self._guarded(active, partial(self._move, active))
        paces = [active.stage.write_seconds for active in self._active.values() if active.stage is not None]
        self._take(self._pool.poll(min([POLL_SECONDS, *paces])))

    def _take(self, results: Iterable[Completed]) -> None:
        by_tag = {active.tag: active for active in self._active.values()}
        for completion in results:
            if completion.tag in by_tag:
                by_tag[completion.tag].unwritten.append(completion)

    def _report(self) -> None:
        waits = {number: self._pool.waits(each.tag) or each.awaited for number, each in self._active.items()} | self._places()
        said = {sequence: reason for sequence, reason in waits.items() if reason is not None}
        self._take_report(self._pool.workers(), self._pool.trouble(), Waits(said, self._pool.resources()))

    def _places(self) -> dict[int, str]:
        """Returns why campaigns wait to be started or to go on, by number."""
        most, count = self._running_campaigns, len(self._in_line)
        why = f"{most} campaigns run, the most at a time on this server (DRIVECAL_RUNNING_CAMPAIGNS)"
        if self._begun >= MOST_BEGUN * most:
            why = f"{self._begun:,} campaigns have begun, and most wait for sets of other programs: finish or cancel some"
        order = "higher priorities first, then the order of submission"
        far = f"more than {EXACT_PLACES} campaigns are before it in the queue: {order}"
        return {waiting.sequence: far for waiting in self._in_line[EXACT_PLACES:]} | {
            waiting.sequence: f"{why}; place {place} of {count} in the queue with priority {waiting.priority}: {order}"
            for place, waiting in enumerate(self._in_line[:EXACT_PLACES], start=1)
        }

    def _tidy(self) -> bool:
        """Removes what is old, and some of what is out of use; True if there may be more of it."""
        stalled = self._newly_stalled()
        with self._database.transaction() as connection:
            for active, reason in stalled:
                campaigns.stall(connection, active.campaign.sequence, round(STALL_SECONDS / 60), reason)
            events.prune(connection, now() - EVENTS_KEPT)
            traces.prune(connection, now() - TRACES_KEPT, MOST_TRACES)
        for active, _ in stalled:
            active.stalled = True
        with suppress(UnavailableError):  # of a lock: there is no hurry
            if next(self._removal, False):
                return True
            self._removal = deletion.removal(self._database)
            return next(self._removal, False)
        return False

    def _newly_stalled(self) -> list[tuple[Active, str]]:
        """Returns the campaigns whose cells have all waited for long, each with the reason; each stall once."""
        stalled = []
        for active in self._active.values():
            reason = self._pool.waits(active.tag, wholly=True)
            if reason is None:
                active.moved_at = None
            elif active.moved_at is None:
                active.moved_at = self._clock()
            elif not active.stalled and self._clock() - active.moved_at >= STALL_SECONDS:
                stalled.append((active, reason))
        return stalled

    def _look(self) -> None:
        """Starts queued campaigns, resumes running campaigns, and applies requested actions."""
        headings = self._database.query(campaigns.active)
        running = (CampaignState.RUNNING, CampaignState.CANCELLING)
        for sequence in self._active.keys() - {heading.sequence for heading in headings if heading.state in running}:
            active = self._active.pop(sequence)  # the commit that paused or ended it succeeded, and only its answer was lost
            self._pool.withdraw(active.tag)
            self._pool.give_back(active.unwritten)
        # campaigns that ran before a restart keep their places; all others follow in order
        for campaign in sorted(headings, key=lambda heading: heading.state not in running):
            with logs.about(campaign=campaign.id, campaign_name=campaign.name):
                self._look_at(campaign)
        idle = [each for each in headings if each.sequence not in self._active and each.kind != "evaluation"]
        resumed = CampaignState.PAUSED, "resume"
        waiting = [
            each for each in idle if each.state is CampaignState.QUEUED or (each.state, each.requested_action) == resumed
        ]
        self._in_line = waiting if self._is_full else []

    def _look_at(self, campaign: CampaignHeading) -> None:
        active = self._active.get(campaign.sequence)
        cancelled = campaign.requested_action == "cancel" or campaign.state is CampaignState.CANCELLING
        if active is None:
            self._guarded(Active(campaign), lambda: self._welcome(campaign, cancelled=cancelled))
        elif cancelled:
            self._stop(active, CampaignState.CANCELLED)
        elif campaign.requested_action == "pause":
            self._stop(active, CampaignState.PAUSED)
        elif active.stopping is CampaignState.PAUSED:  # resumed before the pause took effect
            active.stopping = active.job = None

    def _welcome(self, campaign: CampaignHeading, *, cancelled: bool) -> None:
        """Starts or resumes a campaign. Campaigns that ran before a restart always continue."""
        match campaign.state:
            case CampaignState.QUEUED if self._has_room(campaign):
                self._start(campaign)
            case CampaignState.PAUSED if cancelled:
                self._end(Active(campaign), CampaignState.CANCELLED)
            case CampaignState.PAUSED if campaign.requested_action == "resume" and self._has_room(campaign):
                self._resume(campaign)
            case CampaignState.RUNNING | CampaignState.CANCELLING:
                pause = CampaignState.PAUSED if campaign.requested_action == "pause" else None
                stopping = CampaignState.CANCELLED if cancelled else pause  # before any cell is sent
                log.info("the campaign resumes where it stopped")
                self._active[campaign.sequence] = Active(campaign, stopping=stopping)

    def _has_room(self, campaign: CampaignHeading) -> bool:
        """Returns whether the campaign may start now. The caller asks in starting order."""
        return campaign.kind == "evaluation" or not self._is_full

    @property
    def _is_full(self) -> bool:
        """True if no further campaign may begin to run: single evaluations, and campaigns that wait for other programs, take no place."""
        busy = sum(each.campaign.kind != "evaluation" and each.awaited is None for each in self._active.values())
        return busy >= self._running_campaigns or self._begun >= MOST_BEGUN * self._running_campaigns

    @property
    def _begun(self) -> int:
        """Number of active campaigns, without single evaluations."""
        return sum(each.campaign.kind != "evaluation" for each in self._active.values())

    def _start(self, campaign: CampaignHeading) -> None:
        with self._database.transaction() as connection:
            started = campaigns.start(connection, campaign.sequence)
        if started is not None:
            log.info("the campaign starts")
            self._active[campaign.sequence] = Active(started)

    def _resume(self, campaign: CampaignHeading) -> None:
        with self._database.transaction() as connection:
            resumed = campaigns.carry_out(connection, campaign.sequence, "resume")
        if resumed:  # and neither paused again nor cancelled meanwhile
            log.info("the campaign goes on")
            self._active[campaign.sequence] = Active(campaign)

    def _stop(self, active: Active, state: CampaignState) -> None:
        """Sends no more cells of a campaign to workers; stores results that are under way. A cancel overrides a pause."""
        if active.stopping is state:
            return
        active.stopping = state
        self._pool.withdraw(active.tag)
        if state is CampaignState.CANCELLED:
            with self._database.transaction() as connection:
                campaigns.carry_out(connection, active.campaign.sequence, "cancel")

    def _guarded(self, active: Active, act: Callable[[], object]) -> None:
        """Confines an error, also in stored rows, to its own campaign."""
        try:
            act()
        except DamagedArraysError as error:  # waiting does not mend what a plug-in was shipped with, and others do not need it
            self._end(active, CampaignState.FAILED, str(error))
        except (UnavailableError, SupersededError, BackendLostError):
            raise
        except DrivecalError as error:
            self._end(active, CampaignState.FAILED, str(error))
        except Exception as error:  # a bug must cost one campaign, not the service
            log.exception("the campaign failed")
            self._end(active, CampaignState.FAILED, f"internal error: {type(error).__name__}: {error}")

    def _move(self, active: Active) -> None:
        if active.job is None and not self._takes_up(active):
            return
        job = active.job
        if job is None:
            return
        if active.unwritten and (self._clock() >= active.write_at or not self._pool.held(active.tag)):
            self._submit(active, self._record(active, job))
        if active.stopping is not None:
            self._finish_stopping(active)
            return
        held = self._pool.held(active.tag)
        if held and (reason := self._pool.hopeless(active.tag)) is not None:
            raise ConflictError(reason)
        if held and job.stage is not None and not job.stage.asks_ahead:
            return
        work = job.work()
        self._submit(active, work)
        if job.stage is None:
            self._end(active, CampaignState.SUCCEEDED)
        elif not work and job.wait == "answers" and not held:
            log.warning("cells of the campaign are answered or simulated elsewhere; it starts again from the database")
            active.job, active.not_before = None, self._clock() + RETRY_SECONDS

    def _takes_up(self, active: Active) -> bool:
        """Resumes a campaign from its rows; False if it must wait first, or has nothing left to do."""
        if self._clock() < active.not_before or (active.stopping is not None and self._pool.held(active.tag)):
            return False
        if active.stopping is not None:  # results are dropped; a resumed campaign requests them again
            self._pool.give_back(active.unwritten)
            active.unwritten.clear()
            self._finish_stopping(active)
            return False
        if active.beginning is None:
            active.beginning = take_up(
                self._database,
                active.campaign.sequence,
                lambda request: self._pool.probe(request, active.tag),
                len(self._pool.workers()),
            )
        if active.beginning is None:  # a worker is asked for the versions of its tools
            active.not_before = self._clock() + LOOK_SECONDS
            return False
        work = active.beginning.work()
        if not work and active.beginning.wait in {"computation", "sets"}:  # it does not know yet which results it waits for
            return False
        active.job, active.beginning = active.beginning, None
        held = self._pool.keep(active.tag, {cell.id for batch in work for cell in batch.cells})  # of a dropped job, at workers
        self._submit(active, _without(work, held | {completion.result.id for completion in active.unwritten}))
        return True

    def _record(self, active: Active, job: StagedCampaign) -> Sequence[Work]:
        """Stores the results that have come, and returns the work that follows."""
        with MEASURES.record.time():
            work = job.record(active.unwritten)
        active.unwritten.clear()
        active.moved_at, active.stalled = self._clock(), False
        active.write_at = self._clock() + (0.0 if job.stage is None else job.stage.write_seconds)
        return work

    def _submit(self, active: Active, work: Sequence[Work]) -> None:
        if active.stopping is None:
            budget = None if active.stage is None else active.stage.budget
            self._pool.submit(*work, tag=active.tag, priority=active.priority, budget=budget)

    def _finish_stopping(self, active: Active) -> None:
        if self._pool.held(active.tag) or active.unwritten:
            return
        if active.stopping is CampaignState.CANCELLED:
            self._end(active, CampaignState.CANCELLED)
            return
        with self._database.transaction() as connection:
            paused = campaigns.carry_out(connection, active.campaign.sequence, "pause")
        if paused:
            log.info("the campaign is paused")
            del self._active[active.campaign.sequence]
        else:  # resumed or cancelled meanwhile: the next check decides
            active.stopping = active.job = None

    def _end(self, active: Active, state: CampaignState, error: str | None = None) -> None:
        self._pool.withdraw(active.tag)
        note_best = None if state is CampaignState.SUCCEEDED else self._best_of_all(active.campaign.sequence)
        with self._database.transaction() as connection:
            if note_best is not None:
                with _ends_all_the_same(), connection.begin_nested():
                    note_best(connection)
            campaigns.end(connection, active.campaign.sequence, state, error)
        log.info("the campaign %s%s", state, f": {error}" if error else "")
        self._active.pop(active.campaign.sequence, None)

    def _best_of_all(self, sequence: int) -> Callable[[Connection], None] | None:
        """Returns what stores the best set of a search that ends early; None without a search, or if that fails."""
        campaign = self._database.query(campaigns.by_sequence, sequence)
        with _ends_all_the_same():
            problem = None if campaign.search is None else problem_of(campaign, stored_bundles(self._database))
            if isinstance(problem, CalibrationProblem):
                return best_of_all(self._database, campaign, problem)
        return None

    def _forget_jobs(self) -> None:
        """Drops jobs after a failed transaction: memory may differ from the rows, so each job resumes from its rows."""
        for active in self._active.values():
            active.job = active.beginning = None
            self._pool.withdraw(active.tag)
        self._next_look = 0.0


@contextmanager
def _ends_all_the_same() -> Iterator[None]:
    """Keeps what is wrong with the best set of a campaign from hindering its end; without the database that waits."""
    try:
        yield
    except (UnavailableError, SupersededError):
        raise
    except Exception:
        log.exception("its best set stays what the last closed round made it")


def _without(work: Sequence[Work], answered: Collection[int]) -> list[Work]:
    """Returns the work without cells whose results have arrived."""
    left = (replace(batch, cells=tuple(cell for cell in batch.cells if cell.id not in answered)) for batch in work)
    return [batch for batch in left if batch.cells]
