"""Open event streams: each looks at its campaign twice a second.

A stream holds a position and nothing else. It reads later events page by page, so a slow reader costs no memory and delays no other
stream; it misses only outdated progress.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from drivecal.api.live.dispatcher_health import degraded, silence
from drivecal.api.responses import seconds_of, state_of
from drivecal.contracts.campaign import CampaignEvent, CampaignProgress
from drivecal.domain.errors import DrivecalError
from drivecal.domain.events import EventKind, event_text
from drivecal.storage import campaigns, events, revision_queries
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now
from drivecal.storage.events import StoredEvent

LOOK_SECONDS = 0.5
"""Time between two looks at a campaign, and the shortest time between two progress messages."""
KEEPALIVE_SECONDS = 15.0
"""Time after which something is sent in any case, so that no proxy closes the connection."""
PATIENCE_SECONDS = 3.0
"""Seconds without an answer of the database before streams report it."""
PAGE = 100
"""Events that are read at once."""


Sent = CampaignEvent | CampaignProgress


@dataclass(frozen=True, slots=True)
class _Look:
    """A consistent reading of a campaign. `snapshot` is None if nothing changed since the last one."""

    heartbeat_at: datetime | None
    snapshot: StoredCampaign | None = None
    events: Sequence[StoredEvent] = ()


class EventHub:
    """The streams of one process."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._closing = asyncio.Event()

    @property
    def closed(self) -> bool:
        """True once all streams end."""
        return self._closing.is_set()

    def close(self) -> None:
        """Ends all streams. Their clients resume them at the next server."""
        self._closing.set()

    async def stream(self, sequence: int, campaign: str, last_id: int) -> AsyncGenerator[Sequence[Sent]]:
        """Yields a campaign's events after `last_id`, past and future, until its end; after KEEPALIVE_SECONDS without any an empty list."""
        position, revision, told = last_id, -1, time.monotonic()
        snapshot: StoredCampaign | None = None
        trouble: str | None = None  # what the dispatcher cannot report: its own silence, or the database's
        looking: asyncio.Task[_Look] | None = None
        try:
            while not self.closed:
                looking = looking or asyncio.create_task(asyncio.to_thread(self._read, sequence, position, revision))
                await asyncio.wait([looking], timeout=PATIENCE_SECONDS)
                look, reason = self._result(looking)
                looking = None if looking.done() else looking
                messages: list[Sent] = []
                said, moment = None, now()
                if look is not None:
                    snapshot = look.snapshot or snapshot
                    if snapshot is None:
                        return  # the campaign is gone
                    messages += [_event(each.id, each.kind, campaign, each.created_at, each.data) for each in look.events]
                    position = look.events[-1].id if look.events else position
                    said = degraded(snapshot, silence(look.heartbeat_at, moment))
                    reason = None if said == snapshot.degraded else said
                is_changed, trouble = reason != trouble, reason
                has_ended = snapshot is not None and snapshot.state.ended
                if is_changed and not has_ended:  # no table holds it: its writer is silent, or was
                    said_now = trouble or (snapshot.degraded if snapshot else None)
                    kind = EventKind.RECOVERED if said_now is None else EventKind.DEGRADED
                    messages.append(_event(None, kind, campaign, moment, {} if said_now is None else {"reason": said_now}))
                has_more = look is not None and len(look.events) == PAGE
                if look is not None and snapshot is not None:
                    revision = -1 if has_more else snapshot.revision
                    if not has_more and (look.snapshot is not None or is_changed):
                        progress = {"state": state_of(snapshot), "degraded": said, "seconds": seconds_of(snapshot, moment)}
                        messages.append(CampaignProgress.of(snapshot, **progress))
                if messages or time.monotonic() - told >= KEEPALIVE_SECONDS:
                    told = time.monotonic()
                    yield messages
                if has_more:
                    continue
                if look is not None and has_ended:
                    return
                with suppress(TimeoutError):
                    async with asyncio.timeout(LOOK_SECONDS):
                        await self._closing.wait()
        finally:
            if looking is not None:
                looking.cancel()

    def _result(self, looking: asyncio.Task[_Look]) -> tuple[_Look | None, str | None]:
        """Returns what a look found, or why the database does not tell."""
        if not looking.done():
            return None, f"the database {self._database.name} does not answer"
        try:
            return looking.result(), None
        except DrivecalError as error:
            return None, str(error)

    def _read(self, sequence: int, position: int, revision: int) -> _Look:
        with self._database.read() as connection:
            heartbeat_at = revision_queries.heartbeat(connection)
            if revision_queries.revision(connection, sequence) in {revision, None}:
                return _Look(heartbeat_at)
            snapshot = campaigns.by_sequence(connection, sequence)
            return _Look(heartbeat_at, snapshot, events.since(connection, sequence, position, PAGE))


def _event(number: int | None, kind: str, campaign: str, at: datetime, data: Mapping[str, Any]) -> CampaignEvent:
    return CampaignEvent(id=number, kind=kind, campaign=campaign, at=at, text=event_text(kind, data), data=dict(data))
