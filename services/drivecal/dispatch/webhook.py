"""Posts to `DRIVECAL_WEBHOOK` that a campaign ended, stalled, or is degraded.

A thread reads the stored events, so nothing waits for the listener. An event is marked as posted after the listener took it, or after
the last attempt: after a crash before that it is posted again, with the same number.
"""

import logging
import os
import ssl
import threading
from collections.abc import Sequence
from types import TracebackType
from typing import Any, Self

import httpx

from drivecal.domain.errors import SupersededError, UnavailableError
from drivecal.storage import campaigns, events, processes
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now
from drivecal.storage.events import StoredEvent

NAME = "webhook"
"""Name of the row that says when the first webhook began."""
EVERY_SECONDS, AFTER_FAULT_SECONDS, TIMEOUT_SECONDS = 1.0, 60.0, 10.0
PAUSES = (1.0, 5.0, 25.0)
"""Seconds before each further attempt; after the last one the event is given up."""

AGENT = {"User-Agent": "drivecal"}

log = logging.getLogger(__name__)
logging.getLogger("httpx").setLevel(logging.WARNING)  # it logs the URL of each request


class Webhook:
    """The thread that posts. `url` may hold a secret and is in no message."""

    def __init__(self, database: Database, url: str, pauses: Sequence[float] = PAUSES) -> None:
        """`database` is fenced: a dispatcher that lost its office marks nothing as posted."""
        self._database, self._url, self._pauses = database, url, pauses
        self._tls = ssl.create_default_context()  # knows the certificates of this system, unlike httpx
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="webhook", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        del kind, error, traceback
        self._stopped.set()  # a post that is under way ends with the process, and is repeated by the next one

    def _run(self) -> None:
        while not self._stopped.is_set():
            try:
                self.post()
            except UnavailableError:
                pass  # the heartbeat says so
            except SupersededError:
                return  # the elected dispatcher posts
            except Exception:  # a fault of this thread must not end the dispatcher
                log.exception("the next webhook is posted after %g s", AFTER_FAULT_SECONDS)
                self._stopped.wait(AFTER_FAULT_SECONDS)
            self._stopped.wait(EVERY_SECONDS)

    def post(self) -> None:
        """Posts the events that were not posted yet; none that is older than the first call ever."""
        with self._database.read() as connection:
            process, due = processes.read(connection, NAME), events.unposted(connection)
        if process is None:
            with self._database.transaction() as connection:
                processes.heartbeat(connection, NAME, os.getpid(), now(), {})
                events.mark_posted(connection)
            return
        for event in due:
            if not self._deliver(event):
                return
            with self._database.transaction() as connection:
                events.mark_posted(connection, event.id)

    def _deliver(self, event: StoredEvent) -> bool:
        """Returns whether an event was taken or is given up; False if the process ends first."""
        document, why = self._document(event), ""
        for pause in (0.0, *self._pauses):
            if self._stopped.wait(pause):
                return False
            try:  # redirects are not followed: a POST would become a GET without the document
                with httpx.stream(
                    "POST", self._url, json=document, headers=AGENT, timeout=TIMEOUT_SECONDS, verify=self._tls
                ) as answer:
                    if answer.is_success:
                        return True
                    why = f"it answered {answer.status_code}"
            except (httpx.HTTPError, httpx.InvalidURL, ImportError, OSError, ValueError) as error:  # ImportError: a SOCKS proxy
                why = f"it was not reached ({type(error).__name__})"
        log.warning("the webhook did not take event %d of campaign %s: %s", event.id, document["campaign"]["id"], why)
        return True

    def _document(self, event: StoredEvent) -> dict[str, Any]:
        """Returns what is posted: names and figures, without the settings of the campaign and texts of simulators."""
        with self._database.read() as connection:
            campaign = campaigns.by_sequence(connection, event.campaign_sequence)
        best, baseline = campaign.best, campaign.baseline
        return {
            "event": event.kind,
            "number": event.id,
            "at": event.created_at.isoformat(),
            "campaign": {
                "id": campaign.id,
                "name": campaign.name,
                "state": campaign.state,
                "objective": None if best is None else best.objective,
                "baseline": None if baseline is None else baseline.objective,
            },
            "path": f"/api/v1/campaigns/{campaign.id}",
        }
