"""Posts to `DRIVECAL_WEBHOOK` that a campaign ended, stalled, or is degraded.

A thread reads the stored events, so nothing waits for the listener. An event is marked as posted after the listener took it, or after
the last attempt: after a crash before that it is posted again, with the same number.
"""

import http.client
import json
import logging
import os
import threading
import urllib.error
import urllib.request
from collections.abc import Sequence
from typing import Any, Self

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

log = logging.getLogger(__name__)


class _NoRedirects(urllib.request.HTTPRedirectHandler):
    def redirect_request(self, *_: Any) -> None:
        """Refuses redirects: a POST would become a GET without the document."""


class Webhook:
    """The thread that posts. `url` may hold a secret and is in no message."""

    def __init__(self, database: Database, url: str, pauses: Sequence[float] = PAUSES) -> None:
        """`database` is fenced: a dispatcher that lost its office marks nothing as posted."""
        self._database, self._url, self._pauses = database, url, pauses
        self._opener = urllib.request.build_opener(_NoRedirects())
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="webhook", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
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
        document = self._document(event)
        body = json.dumps(document).encode()
        headers = {"Content-Type": "application/json", "User-Agent": "drivecal"}
        why = ""
        for pause in (0.0, *self._pauses):
            if self._stopped.wait(pause):
                return False
            request = urllib.request.Request(self._url, body, headers)  # noqa: S310  # the settings take http and https only
            try:
                with self._opener.open(request, timeout=TIMEOUT_SECONDS):
                    return True
            except urllib.error.HTTPError as error:
                why = f"it answered {error.code}"
            except (OSError, http.client.HTTPException, ValueError) as error:
                why = f"it was not reached ({type(error).__name__})"
        log.warning("the webhook did not take event %d of campaign %s: %s", event.id, document["campaign"]["id"], why)
        return True

    def _document(self, event: StoredEvent) -> dict[str, Any]:
        """Returns what is posted: names and figures, without the settings of the campaign and texts of simulators."""
        campaign = self._database.query(campaigns.by_sequence, event.campaign_sequence)
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
