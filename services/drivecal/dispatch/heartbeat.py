"""The right to be the dispatcher, and its heartbeat: a thread that stores its state every second, also while the main thread is busy."""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Self

from sqlalchemy import Connection

from drivecal.contracts.inventory import ResourceAnswer
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import DrivecalError, UnavailableError
from drivecal.execution.backend import WorkerInfo
from drivecal.execution.measures import MEASURES
from drivecal.storage import campaigns, processes
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now
from drivecal.storage.processes import DISPATCHER


@dataclass(frozen=True, slots=True)
class Leadership:
    """A dispatcher's `term` number and start time. `follows`: there was a dispatcher before it."""

    term: int
    began_at: datetime
    follows: bool = False

    @classmethod
    def begin(cls, database: Database) -> Leadership:
        """Elects this process; from now on no other process writes. The caller must hold the lock."""
        began_at = now()
        with database.transaction() as connection:
            last = processes.read(connection, DISPATCHER)
            term = processes.elect(connection, DISPATCHER, os.getpid(), began_at)
            return cls(term, began_at, follows=last is not None)

    def free_in(self, settle_seconds: float) -> float:
        """Returns the time (s) for which runs of the dispatcher before may still go on. That dispatcher, whose heartbeats an outage of the
        database may have kept back, notices the election soon and ends, and its workers with it, whose runs take at most `settle_seconds`
        more."""
        return EVERY_SECONDS + GRACE_SECONDS + settle_seconds if self.follows else 0.0

    def fence(self, connection: Connection) -> None:
        """Raises SupersededError if the leadership is over; see `Database.fenced`."""
        processes.confirm(connection, DISPATCHER, self.term)


EVERY_SECONDS = 1.0
STARTING, STARTING_SECONDS = ("the dispatcher is starting", "the workers are being started"), 60.0
"""Troubles of each start, which are none of a campaign's for a while."""
STUCK_AFTER_SECONDS = 12.0
"""Time limit of a main-thread step before it is reported; resuming a campaign on a large reference table may take long."""
HUNG_AFTER_SECONDS = 180.0
"""The same for a main thread that does not compute, before this process ends: another one resumes its campaigns."""
COMPUTING_SHARE = 0.05
"""Share of a core from which on the main thread is taken to wait for threads that compute, e.g. train a prediction."""
LONGEST_TRAINING_SECONDS = 3600.0
"""Time without a report after which it is not: other threads may have something to do for ever."""
GRACE_SECONDS = 10.0
"""Time for the main thread to end the process after the heartbeat has stopped."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Waits:
    """Reasons why campaigns wait, by number, and the use of resources."""

    campaigns: Mapping[int, str] = field(default_factory=dict)
    resources: Sequence[ResourceAnswer] = ()


@dataclass(frozen=True, slots=True)
class _Report:
    """The main thread's latest report: workers, problems, waits, and time."""

    workers: Sequence[WorkerInfo]
    trouble: str | None
    waits: Waits
    heard: float
    at: datetime


class Heartbeat:
    """A context manager that beats until its block ends. The main thread calls `report`."""

    def __init__(
        self,
        database: Database,
        leadership: Leadership,
        renew_lock: Callable[[], None] = lambda: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """`database` is fenced by the leadership; `renew_lock` raises if this process lost the right to be the dispatcher."""
        self._database = database
        self._leadership = leadership
        self._renew_lock = renew_lock
        self._clock, self._begun = clock, clock()
        self._report = _Report((), STARTING[0], Waits(), clock(), now())
        self._written: _Report | None = None
        self._failure: BaseException | None = None
        self._reachable = True
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="heartbeat", daemon=True)
        self._clock_of_main = time.pthread_getcpuclockid(threading.get_ident())
        self._computed = self._computed_by_all = 0.0
        self._looked_at = self._computed_at = clock()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        self._thread.join(GRACE_SECONDS)  # it may be waiting for the database

    def report(self, workers: Sequence[WorkerInfo], trouble: str | None, waits: Waits | None = None) -> None:
        """Takes the main thread's report. Raises the error that ended the heartbeat, if any."""
        self._report = _Report(tuple(workers), trouble, waits or Waits(), self._clock(), now())
        if self._failure is not None:
            raise self._failure

    def wait_until_stored(self) -> None:
        """Returns when the latest report is stored, or after a timeout."""
        deadline = self._clock() + 3 * EVERY_SECONDS
        while self._written is not self._report and self._clock() < deadline:
            time.sleep(0.01)

    def beat(self) -> None:
        """Stores the dispatcher's state. Raises SupersededError, UnavailableError, and DatabaseError if another server holds the lock."""
        self._renew_lock()
        report = self._report
        detail: dict[str, Any] = {
            "workers": [worker.model_dump(mode="json") for worker in report.workers],
            "degraded": report.trouble,
            "resources": [use.model_dump() for use in report.waits.resources],
            "measures": MEASURES.snapshot(),
        }
        if self._clock() - report.heard > STUCK_AFTER_SECONDS:
            stuck = f"the dispatcher has been busy with one step since {report.at:%H:%M:%S} UTC"
            detail["degraded"] = "; ".join(filter(None, (report.trouble, stuck)))
            detail["stuck_since"] = report.at.isoformat(timespec="seconds")
        with self._database.transaction() as connection:
            processes.heartbeat(connection, DISPATCHER, os.getpid(), self._leadership.began_at, detail)
        with self._database.transaction() as connection:  # separate: it may wait for the main thread's writes
            working = {CampaignState.RUNNING, CampaignState.CANCELLING}
            running = [campaign.sequence for campaign in campaigns.active(connection) if campaign.state in working]
            if report.trouble not in STARTING or self._clock() > self._begun + STARTING_SECONDS:
                campaigns.degrade(connection, running, detail["degraded"])
            campaigns.explain(connection, report.waits.campaigns)
        self._written = report

    def _run(self) -> None:
        while not self._stopped.is_set():
            begun = time.monotonic()
            if self._is_hung():
                log.error("the dispatcher ends: its main thread hangs since %s UTC", f"{self._report.at:%H:%M:%S}")
                os._exit(1)
            try:
                self.beat()
                self._note_reachable(None)
            except UnavailableError as error:
                self._note_reachable(error)
            except Exception as error:  # noqa: BLE001  # a dispatcher without a heartbeat must not continue
                self._fail(error)
                return
            self._stopped.wait(max(0.1, begun + EVERY_SECONDS - time.monotonic()))

    def _is_hung(self) -> bool:
        """Returns whether the main thread has neither reported nor computed for long, nor waited for threads that compute."""
        moment, computed = self._clock(), time.clock_gettime(self._clock_of_main)
        by_all = time.process_time() - time.thread_time()  # without this thread, which always has something to do
        waits = by_all > self._computed_by_all + COMPUTING_SHARE * (moment - self._looked_at)
        if computed > self._computed + 0.01 or (waits and moment < self._report.heard + LONGEST_TRAINING_SECONDS):
            self._computed, self._computed_at = computed, moment
        self._computed_by_all, self._looked_at = by_all, moment
        return moment - max(self._report.heard, self._computed_at) > HUNG_AFTER_SECONDS

    def _note_reachable(self, error: UnavailableError | None) -> None:
        if error is not None and self._reachable:
            log.warning("waiting for the database: %s", error)
        elif error is None and not self._reachable:
            log.info("the database answers again")
        self._reachable = error is None

    def _fail(self, error: Exception) -> None:
        """Makes the main thread end the process; ends the process itself if the main thread is stuck."""
        log.error("the dispatcher ends: %s", error, exc_info=None if isinstance(error, DrivecalError) else error)
        self._failure = error
        if not self._stopped.wait(GRACE_SECONDS):
            os._exit(1)
