"""The dispatcher: takes campaigns out of the database, has their cells simulated and writes down what comes back.

One thread does everything but the pulse, one dispatcher serves a database. What it holds in memory can be lost at any moment: after a
crash, and after a transaction that failed, campaigns are taken up from their rows.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from datetime import timedelta

from drivecal.campaigns.cells.cell_tracker import Work
from drivecal.configuration import logs
from drivecal.dispatch.jobs import Active, take_up
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import DrivecalError, SupersededError, UnavailableError
from drivecal.execution.backend import BackendLostError, WorkerInfo
from drivecal.execution.measures import MEASURES
from drivecal.execution.pool import WorkPool
from drivecal.plugins.arrays import DamagedArraysError
from drivecal.storage import campaigns, events, traces
from drivecal.storage.campaigns import CampaignHeading
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now

LOOK_SECONDS = 0.25
"""How often new campaigns and requests are looked for."""
TELL_SECONDS = 0.5
POLL_SECONDS = 0.1
TIDY_SECONDS = 60.0
TRACES_KEPT, MOST_TRACES = timedelta(days=1), 200
RETRY_SECONDS = 5.0
"""Until a campaign is taken up again whose cells somebody else seems to have."""

log = logging.getLogger(__name__)


class Dispatcher:
    """See the module. `tell` takes the workers and what is wrong, twice a second, and raises where the dispatcher has to end."""

    def __init__(
        self,
        database: Database,
        pool: WorkPool,
        tell: Callable[[Sequence[WorkerInfo], str | None], None] = lambda _workers, _trouble: None,
        *,
        running_campaigns: int = 8,
        event_days: int = 30,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """`running_campaigns`: at most so many at a time, single evaluations not counted. `event_days`: how long events are kept."""
        self._database = database
        self._pool = pool
        self._tell = tell
        self._running_campaigns = running_campaigns
        self._event_age = timedelta(days=event_days)
        self._clock = clock
        self._active: dict[int, Active] = {}
        self._next_look = self._next_tell = self._next_tidy = 0.0

    def run(self, stop: threading.Event) -> None:
        """Works until `stop` is set. A database that does not answer is waited for; everything goes on when it is back.

        Raises SupersededError and BackendLostError: somebody else goes on, or this process has to begin anew.
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

    def step(self) -> None:
        """One round: report, look for campaigns and requests, feed the workers, write down what came back."""
        if self._clock() >= self._next_tell:
            self._report()
            self._next_tell = self._clock() + TELL_SECONDS
        if self._clock() >= self._next_look:
            self._look()
            self._next_look = self._clock() + LOOK_SECONDS
        if self._clock() >= self._next_tidy:
            self._tidy()
            self._next_tidy = self._clock() + TIDY_SECONDS
        for active in list(self._active.values()):
            with logs.about(campaign=active.campaign.id, campaign_name=active.campaign.name, stage=active.stage):
                self._advance(active)
        by_tag = {active.tag: active for active in self._active.values()}
        for completion in self._pool.poll(POLL_SECONDS):
            if completion.tag in by_tag:
                by_tag[completion.tag].unwritten.append(completion)

    def _report(self) -> None:
        self._tell(self._pool.workers(), self._pool.trouble())

    def _tidy(self) -> None:
        with self._database.transaction() as connection:
            events.prune(connection, now() - self._event_age)
            traces.prune(connection, now() - TRACES_KEPT, MOST_TRACES)

    def _look(self) -> None:
        """Starts what is queued, takes up what was running, does what was requested."""
        with self._database.read() as connection:
            found = campaigns.active(connection)
        running = (CampaignState.RUNNING, CampaignState.CANCELLING)
        # those that ran before a restart have their places, whatever is queued; all others in their order
        for campaign in sorted(found, key=lambda one: one.state not in running):
            with logs.about(campaign=campaign.id, campaign_name=campaign.name):
                self._look_at(campaign)

    def _look_at(self, campaign: CampaignHeading) -> None:
        active = self._active.get(campaign.sequence)
        cancelled = campaign.requested_action == "cancel" or campaign.state is CampaignState.CANCELLING
        if active is None:
            self._guarded(Active(campaign), lambda: self._welcome(campaign, cancelled=cancelled))
        elif cancelled:
            self._stop(active, CampaignState.CANCELLED)
        elif campaign.requested_action == "pause":
            self._stop(active, CampaignState.PAUSED)
        elif active.stopping is CampaignState.PAUSED:  # and resumed again before it rested
            active.stopping = active.job = None

    def _welcome(self, campaign: CampaignHeading, *, cancelled: bool) -> None:
        """Begins to look after a campaign that it did not look after so far. Those that ran before a restart go on in any case."""
        match campaign.state:
            case CampaignState.QUEUED if self._has_room(campaign):
                self._start(campaign)
            case CampaignState.PAUSED if cancelled:
                self._end(Active(campaign), CampaignState.CANCELLED)
            case CampaignState.PAUSED if campaign.requested_action == "resume" and self._has_room(campaign):
                self._resume(campaign)
            case CampaignState.RUNNING | CampaignState.CANCELLING:
                pause = CampaignState.PAUSED if campaign.requested_action == "pause" else None
                stopping = CampaignState.CANCELLED if cancelled else pause  # before anything of it is sent
                log.info("the campaign is taken up where it was")
                self._active[campaign.sequence] = Active(campaign, stopping=stopping)

    def _has_room(self, campaign: CampaignHeading) -> bool:
        """To be asked in the order in which campaigns are to be started."""
        running = sum(active.campaign.kind != "evaluation" for active in self._active.values())
        return campaign.kind == "evaluation" or running < self._running_campaigns

    def _start(self, campaign: CampaignHeading) -> None:
        with self._database.transaction() as connection:
            started = campaigns.start(connection, campaign.sequence)
        if started is not None:
            log.info("the campaign starts")
            self._active[campaign.sequence] = Active(started)

    def _resume(self, campaign: CampaignHeading) -> None:
        with self._database.transaction() as connection:
            resumed = campaigns.change_state(connection, campaign.sequence, [CampaignState.PAUSED], CampaignState.RUNNING)
        if resumed:  # and not cancelled meanwhile
            log.info("the campaign goes on")
            self._active[campaign.sequence] = Active(campaign)

    def _stop(self, active: Active, state: CampaignState) -> None:
        """Sends nothing more of a campaign to workers; what is there already is still written down. A cancel overrules a pause."""
        if active.stopping is state:
            return
        active.stopping = state
        self._pool.withdraw(active.tag)
        if state is CampaignState.CANCELLED:
            with self._database.transaction() as connection:
                sequence = active.campaign.sequence
                campaigns.change_state(connection, sequence, [CampaignState.RUNNING], CampaignState.CANCELLING)

    def _advance(self, active: Active) -> None:
        """Moves one campaign on."""
        self._guarded(active, lambda: self._move(active))

    def _guarded(self, active: Active, act: Callable[[], None]) -> None:
        """What is wrong with one campaign, its rows included, fails that one and no other."""
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
        if active.unwritten:
            with MEASURES.timed("record"):
                work = job.record(active.unwritten)
            active.unwritten.clear()
            self._submit(active, work)
        if active.stopping is not None:
            self._finish_stopping(active)
        elif not self._pool.held(active.tag):
            work = job.work()
            self._submit(active, work)
            if job.finished:
                self._end(active, CampaignState.SUCCEEDED)
            elif not work and not job.goes_on:
                log.warning("cells of the campaign are answered or simulated elsewhere; it is taken up again")
                active.job, active.not_before = None, self._clock() + RETRY_SECONDS

    def _takes_up(self, active: Active) -> bool:
        """Takes a campaign up from its rows; False where there is something to wait for first, or nothing more to do."""
        if self._pool.held(active.tag) or self._clock() < active.not_before:
            return False  # cells of a forgotten job; their results come first
        if active.stopping is not None:  # nobody waits for its results any more; a resumed campaign asks for them again
            self._pool.give_back(active.unwritten)
            active.unwritten.clear()
            self._finish_stopping(active)
            return False
        active.job = take_up(self._database, active.campaign.sequence)
        self._submit(active, _without(active.job.work(), {completion.result.id for completion in active.unwritten}))
        return True

    def _submit(self, active: Active, work: Sequence[Work]) -> None:
        if active.stopping is None:
            for batch in work:
                self._pool.submit(
                    batch.setup,
                    batch.cells,
                    tag=active.tag,
                    priority=active.priority,
                    exclusive=batch.exclusive,
                    breakdowns=batch.breakdowns,
                )

    def _finish_stopping(self, active: Active) -> None:
        if self._pool.held(active.tag) or active.unwritten:
            return
        if active.job is not None:
            active.job.sum_up()
        if active.stopping is CampaignState.CANCELLED:
            self._end(active, CampaignState.CANCELLED)
            return
        with self._database.transaction() as connection:
            paused = campaigns.pause(connection, active.campaign.sequence)
        if paused:
            log.info("the campaign is paused")
            del self._active[active.campaign.sequence]
        else:  # resumed or cancelled meanwhile: the next look sees which
            active.stopping = active.job = None

    def _end(self, active: Active, state: CampaignState, error: str | None = None) -> None:
        self._pool.withdraw(active.tag)
        with self._database.transaction() as connection:
            campaigns.end(connection, active.campaign.sequence, state, error)
        log.info("the campaign %s%s", state, f": {error}" if error else "")
        self._active.pop(active.campaign.sequence, None)

    def _forget_jobs(self) -> None:
        """A transaction failed, perhaps at its commit: what is in memory may differ from the rows, so jobs are taken up anew."""
        for active in self._active.values():
            active.job = None
            self._pool.withdraw(active.tag)
        self._next_look = 0.0


def _without(work: Sequence[Work], answered: Collection[int]) -> list[Work]:
    """Work less the cells whose results are there already."""
    left = (replace(batch, cells=tuple(cell for cell in batch.cells if cell.id not in answered)) for batch in work)
    return [one for one in left if one.cells]
