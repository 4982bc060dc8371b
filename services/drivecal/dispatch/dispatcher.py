"""The dispatcher: takes campaigns out of the database, has their cells simulated and writes down what comes back.

One thread does everything, one dispatcher serves a database. What it holds in memory can be lost at any moment: after a crash, and
after a transaction that failed, campaigns are taken up from their rows.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from drivecal.campaigns.evaluation import SingleEvaluation
from drivecal.campaigns.ledger import Work
from drivecal.campaigns.pinned import problem_of
from drivecal.campaigns.planning import View
from drivecal.campaigns.problem import EvaluationProblem
from drivecal.campaigns.staged import StagedCampaign
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import ConflictError, DrivecalError, UnavailableError
from drivecal.execution.pool import WorkPool
from drivecal.execution.scheduler import Completed
from drivecal.storage import campaigns, processes
from drivecal.storage.campaigns import CampaignHeading, StoredCampaign
from drivecal.storage.database import Database
from drivecal.storage.types import now

log = logging.getLogger(__name__)

NAME = "dispatcher"
"""Under which it reports itself."""
LOOK_SECONDS = 0.25
"""How often new campaigns and requests are looked for."""
HEARTBEAT_SECONDS = 1.0
POLL_SECONDS = 0.1
EVALUATION_PRIORITY = 1000
"""Somebody waits for a single evaluation; a campaign can wait a batch longer."""

Job = StagedCampaign | SingleEvaluation


@dataclass(slots=True)
class _Active:
    """A campaign in work. `job` is None until it is taken up from its rows; `unwritten` survives a failed transaction."""

    campaign: CampaignHeading
    job: Job | None = None
    unwritten: list[Completed] = field(default_factory=list)
    stopping: CampaignState | None = None
    """Where it goes once nothing of it is at a worker: cancelled or paused."""

    @property
    def tag(self) -> str:
        return self.campaign.id

    @property
    def priority(self) -> int:
        return EVALUATION_PRIORITY if self.campaign.kind == "evaluation" else self.campaign.priority


class Dispatcher:
    """See the module. `renew_lock` raises where the right to be this database's dispatcher was lost."""

    def __init__(
        self,
        database: Database,
        pool: WorkPool,
        renew_lock: Callable[[], None] = lambda: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._database = database
        self._pool = pool
        self._renew_lock = renew_lock
        self._clock = clock
        self._started_at = now()
        self._active: dict[int, _Active] = {}
        self._next_look = self._next_beat = 0.0

    def run(self, stop: threading.Event) -> None:
        """Works until `stop` is set. A database that does not answer is waited for; everything goes on when it is back."""
        pause = 0.5
        while not stop.is_set():
            try:
                self.step()
                pause = 0.5
            except UnavailableError as error:
                log.warning("waiting for the database: %s", error)
                self._forget_jobs()
                stop.wait(pause)
                pause = min(2 * pause, 10.0)

    def step(self) -> None:
        """One round: report, look for campaigns and requests, feed the workers, write down what came back."""
        if self._clock() >= self._next_beat:
            self._beat()
            self._next_beat = self._clock() + HEARTBEAT_SECONDS
        if self._clock() >= self._next_look:
            self._look()
            self._next_look = self._clock() + LOOK_SECONDS
        for active in list(self._active.values()):
            self._advance(active)
        by_tag = {active.tag: active for active in self._active.values()}
        for one in self._pool.poll(POLL_SECONDS):
            if one.tag in by_tag:
                by_tag[one.tag].unwritten.append(one)

    def _beat(self) -> None:
        self._renew_lock()
        detail = {"workers": [asdict(worker) for worker in self._pool.workers()], "degraded": self._pool.trouble()}
        with self._database.transaction() as connection:
            processes.heartbeat(connection, NAME, os.getpid(), self._started_at, detail)
            campaigns.degrade(connection, [active.campaign.sequence for active in self._active.values()], self._pool.trouble())

    def _look(self) -> None:
        """Starts what is queued, takes up what was running, does what was requested."""
        with self._database.read() as connection:
            found = campaigns.active(connection)
        for campaign in found:
            active = self._active.get(campaign.sequence)
            cancelled = campaign.requested_action == "cancel" or campaign.state is CampaignState.CANCELLING
            if active is None:
                self._welcome(campaign, cancelled=cancelled)
            elif cancelled:
                self._stop(active, CampaignState.CANCELLED)
            elif campaign.requested_action == "pause":
                self._stop(active, CampaignState.PAUSED)
            elif active.stopping is CampaignState.PAUSED:  # and resumed again before it rested
                active.stopping = active.job = None

    def _welcome(self, campaign: CampaignHeading, *, cancelled: bool) -> None:
        """Begins to look after a campaign that it did not look after so far."""
        match campaign.state:
            case CampaignState.QUEUED:
                self._start(campaign)
            case CampaignState.PAUSED if cancelled:
                self._end(_Active(campaign), CampaignState.CANCELLED)
            case CampaignState.PAUSED if campaign.requested_action == "resume":
                self._resume(campaign)
            case CampaignState.RUNNING | CampaignState.CANCELLING:
                self._active[campaign.sequence] = _Active(campaign, stopping=CampaignState.CANCELLED if cancelled else None)

    def _start(self, campaign: CampaignHeading) -> None:
        with self._database.transaction() as connection:
            started = campaigns.start(connection, campaign.sequence)
        if started is not None:
            log.info("campaign %s (%s) starts", campaign.id, campaign.name)
            self._active[campaign.sequence] = _Active(started)

    def _resume(self, campaign: CampaignHeading) -> None:
        with self._database.transaction() as connection:
            resumed = campaigns.change_state(connection, campaign.sequence, [CampaignState.PAUSED], CampaignState.RUNNING)
        if resumed:  # and not cancelled meanwhile
            log.info("campaign %s goes on", campaign.id)
            self._active[campaign.sequence] = _Active(campaign)

    def _stop(self, active: _Active, state: CampaignState) -> None:
        """Sends nothing more of a campaign to workers; what is there already is still written down. A cancel overrules a pause."""
        if active.stopping is state:
            return
        active.stopping = state
        self._pool.withdraw(active.tag)
        if state is CampaignState.CANCELLED:
            with self._database.transaction() as connection:
                sequence = active.campaign.sequence
                campaigns.change_state(connection, sequence, [CampaignState.RUNNING], CampaignState.CANCELLING)

    def _advance(self, active: _Active) -> None:
        """Moves one campaign on. What is wrong with one campaign fails that one, and no other."""
        try:
            if active.job is None:
                if self._pool.held(active.tag):
                    return  # cells of a forgotten job; their results come first
                if active.stopping is not None:  # nobody waits for them any more; a resumed campaign asks for them again
                    active.unwritten.clear()
                    self._finish_stopping(active)
                    return
                active.job = self._take_up(active)
                self._submit(active, _without(active.job.work(), {one.result.id for one in active.unwritten}))
            if active.unwritten:
                work = active.job.record(active.unwritten)
                active.unwritten.clear()
                self._submit(active, work)
            if active.stopping is not None:
                self._finish_stopping(active)
            elif not self._pool.held(active.tag):
                self._submit(active, active.job.work())
                if active.job.finished:
                    self._end(active, CampaignState.SUCCEEDED)
        except UnavailableError:
            raise
        except DrivecalError as error:
            self._end(active, CampaignState.FAILED, str(error))
        except Exception as error:  # a bug must cost one campaign, not the service
            log.exception("campaign %s failed", active.campaign.id)
            self._end(active, CampaignState.FAILED, f"internal error: {type(error).__name__}: {error}")

    def _take_up(self, active: _Active) -> Job:
        """A job that goes on from the campaign's rows. Raises ConflictError where it was begun with another version of anything."""
        with self._database.read() as connection:
            campaign = campaigns.by_sequence(connection, active.campaign.sequence)
        problem = problem_of(campaign)
        self._pin(campaign, problem.resolution())
        if isinstance(problem, EvaluationProblem):
            view = View(campaign.sequence, campaign.watermark or 0, problem.bench)
            return SingleEvaluation(self._database, campaign, problem, view)
        return StagedCampaign(self._database, campaign, problem)

    def _pin(self, campaign: StoredCampaign, resolution: dict[str, Any]) -> None:
        """Writes down what a campaign is begun with; later, makes sure that it goes on with the same."""
        if campaign.resolution is None:
            with self._database.transaction() as connection:
                campaigns.set_resolution(connection, campaign.sequence, resolution)
            return
        changed = [part for part in resolution if resolution[part] != campaign.resolution.get(part)]
        if changed:
            raise ConflictError(
                f"the campaign was begun with another version of its {' and '.join(changed)}; submit it again: results of two versions"
                " cannot be compared"
            )

    def _submit(self, active: _Active, work: list[Work]) -> None:
        if active.stopping is None:
            for one in work:
                self._pool.submit(one.setup, one.cells, tag=active.tag, priority=active.priority)

    def _finish_stopping(self, active: _Active) -> None:
        if self._pool.held(active.tag) or active.unwritten:
            return
        if active.stopping is CampaignState.CANCELLED:
            self._end(active, CampaignState.CANCELLED)
            return
        with self._database.transaction() as connection:
            paused = campaigns.pause(connection, active.campaign.sequence)
        if paused:
            log.info("campaign %s is paused", active.campaign.id)
            del self._active[active.campaign.sequence]
        else:  # resumed or cancelled meanwhile: the next look sees which
            active.stopping = active.job = None

    def _end(self, active: _Active, state: CampaignState, error: str | None = None) -> None:
        self._pool.withdraw(active.tag)
        with self._database.transaction() as connection:
            campaigns.end(connection, active.campaign.sequence, state, error)
        log.info("campaign %s %s%s", active.campaign.id, state, f": {error}" if error else "")
        self._active.pop(active.campaign.sequence, None)

    def _forget_jobs(self) -> None:
        """A transaction failed, perhaps at its commit: what is in memory may differ from the rows, so jobs are taken up anew."""
        for active in self._active.values():
            active.job = None
            self._pool.withdraw(active.tag)
        self._next_look = self._next_beat = 0.0


def _without(work: Sequence[Work], answered: Collection[int]) -> list[Work]:
    """Work less the cells whose results are there already."""
    left = (Work(one.setup, tuple(cell for cell in one.cells if cell.id not in answered)) for one in work)
    return [one for one in left if one.cells]
