"""The dispatcher's pulse: a thread that says every second how it is, whatever the main thread is busy with."""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from types import TracebackType
from typing import Any, Self

from drivecal.dispatch.leadership import Leadership
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import DrivecalError, UnavailableError
from drivecal.execution.backend import WorkerInfo
from drivecal.execution.measures import MEASURES
from drivecal.storage import campaigns, processes
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now
from drivecal.storage.processes import DISPATCHER

EVERY_SECONDS = 1.0
STUCK_AFTER_SECONDS = 60.0
"""Of one step of the main thread, before it is told: those that take up a campaign on a large reference table may take long."""
GRACE_SECONDS = 10.0
"""For the main thread to end the process in peace, once there is no pulse any more."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class _Report:
    """What the main thread said last: the workers, what is wrong in words, and when that was."""

    workers: Sequence[WorkerInfo]
    trouble: str | None
    heard: float
    at: datetime


class Heartbeat:
    """`with Pulse(...)` beats until the block is left. `tell` and `check` are the main thread's."""

    def __init__(
        self,
        database: Database,
        leadership: Leadership,
        renew_lock: Callable[[], None] = lambda: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """`database`: fenced by the tenure. `renew_lock` raises where the right to be this database's dispatcher was lost."""
        self._database = database
        self._leadership = leadership
        self._renew_lock = renew_lock
        self._clock = clock
        self._report = _Report((), "the dispatcher is starting", clock(), now())
        self._written: _Report | None = None
        self._failure: BaseException | None = None
        self._reachable = True
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="pulse", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        del kind, error, traceback
        self._stopped.set()
        self._thread.join(GRACE_SECONDS)  # it may be waiting for the database

    def tell(self, workers: Sequence[WorkerInfo], trouble: str | None) -> None:
        """The main thread lives, and this is how its workers are. Raises what ended the pulse, where it has ended."""
        self._report = _Report(tuple(workers), trouble, self._clock(), now())
        if self._failure is not None:
            raise self._failure

    def wait_until_told(self) -> None:
        """Returns when what was told last is written down, or after a while where that is not possible."""
        deadline = self._clock() + 3 * EVERY_SECONDS
        while self._written is not self._report and self._clock() < deadline:
            time.sleep(0.01)

    def beat(self) -> None:
        """Writes down how the dispatcher is. Raises SupersededError, UnavailableError, and DatabaseError where another server has
        the lock."""
        self._renew_lock()
        report = self._report
        detail: dict[str, Any] = {
            "workers": [asdict(worker) for worker in report.workers],
            "degraded": report.trouble,
            "measures": MEASURES.snapshot(),
        }
        if self._clock() - report.heard > STUCK_AFTER_SECONDS:
            stuck = f"the dispatcher has been busy with one step since {report.at:%H:%M:%S} UTC"
            detail["degraded"] = "; ".join(filter(None, (report.trouble, stuck)))
            detail["stuck_since"] = report.at.isoformat(timespec="seconds")
        with self._database.transaction() as connection:
            processes.heartbeat(connection, DISPATCHER, os.getpid(), self._leadership.began_at, detail)
        with self._database.transaction() as connection:  # apart: it may have to wait for what the main thread is writing
            working = {CampaignState.RUNNING, CampaignState.CANCELLING}
            running = [campaign.sequence for campaign in campaigns.active(connection) if campaign.state in working]
            campaigns.degrade(connection, running, detail["degraded"])
        self._written = report

    def _run(self) -> None:
        while not self._stopped.is_set():
            begun = time.monotonic()
            try:
                self.beat()
                self._note_reachable(None)
            except UnavailableError as error:
                self._note_reachable(error)
            except Exception as error:  # noqa: BLE001  # whatever it is, a dispatcher without a pulse must not go on
                self._fail(error)
                return
            self._stopped.wait(max(0.1, begun + EVERY_SECONDS - time.monotonic()))

    def _note_reachable(self, error: UnavailableError | None) -> None:
        if error is not None and self._reachable:
            log.warning("waiting for the database: %s", error)
        elif error is None and not self._reachable:
            log.info("the database answers again")
        self._reachable = error is None

    def _fail(self, error: Exception) -> None:
        """Has the main thread end the process; where it is stuck, ends it without it."""
        log.error("the dispatcher ends: %s", error, exc_info=None if isinstance(error, DrivecalError) else error)
        self._failure = error
        if not self._stopped.wait(GRACE_SECONDS):
            os._exit(1)
