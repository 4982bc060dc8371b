"""Open event streams: a single poller reads the campaigns of all streams, however many there are.

A stream holds a position and nothing else. It takes later events from its campaign's feed, which holds the newest ones encoded; a stream
that is further behind reads the database itself, page by page. A slow reader therefore costs no memory and delays no other stream; it
misses only outdated progress.
"""

from __future__ import annotations

import asyncio
import json
import logging
from collections import deque
from collections.abc import AsyncGenerator, AsyncIterator, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

from drivecal.api.live.dispatcher_health import degraded, silence
from drivecal.api.responses import seconds_of, state_of
from drivecal.contracts.campaign import CellCounts, CellsByStage
from drivecal.contracts.events import PROGRESS
from drivecal.domain.errors import DrivecalError
from drivecal.domain.events import EventKind, event_text
from drivecal.storage import events, revision_queries
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now
from drivecal.storage.events import StoredEvent
from drivecal.storage.revision_queries import ProgressSnapshot

LOOK_SECONDS = 0.5
"""Interval of the poller, and the shortest interval between two progress messages."""
KEEPALIVE_SECONDS = 15.0
"""Time after which something is sent in any case, so that no proxy closes the connection."""
PATIENCE_SECONDS = 3.0
"""Seconds without an answer of the database before streams report it."""
HELD = 500
"""Events that a feed holds."""
PAGE = 100
"""Events that are read at once."""

log = logging.getLogger("drivecal.api")


@dataclass(frozen=True, slots=True)
class Message:
    """An event of a campaign, or its progress, which has no number. `content` is JSON."""

    number: int | None
    kind: str
    content: str


@dataclass(slots=True)
class Feed:
    """New events and progress of a campaign."""

    sequence: int
    campaign: str
    start: int | None = None
    """`held` has all events after this one; None before the first look."""
    held: deque[tuple[int, Message]] = field(default_factory=deque)
    revision: int = -1
    snapshot: ProgressSnapshot | None = None
    trouble: str | None = None
    """A trouble that the dispatcher cannot report: its own silence, or the database's."""
    progress: Message | None = None
    ended: bool = False
    readers: int = 0
    changed: asyncio.Event = field(default_factory=asyncio.Event)
    """Set with the next change; then another one takes its place."""

    @property
    def newest(self) -> int | None:
        """Id of the last known event."""
        return self.held[-1][0] if self.held else self.start

    def after(self, position: int) -> tuple[list[Message], int]:
        """Returns the held events after a position, and the position after them."""
        later = [event for event in self.held if event[0] > position]
        return [message for _, message in later], later[-1][0] if later else position

    def wake(self) -> None:
        """Lets streams look again."""
        self.changed.set()
        self.changed = asyncio.Event()


@dataclass(frozen=True, slots=True)
class _Look:
    """A consistent reading of the poller."""

    heartbeat_at: datetime | None
    snapshots: Mapping[int, ProgressSnapshot]
    """Progress of changed campaigns."""
    events: Mapping[int, list[StoredEvent]]
    newest: Mapping[int, int]
    """Newest events of campaigns that are read for the first time."""


class EventHub:
    """The streams of one process. Create and use it within one event loop."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._feeds: dict[int, Feed] = {}
        self._wanted = asyncio.Event()
        self.closed = False

    @asynccontextmanager
    async def running(self) -> AsyncIterator[EventHub]:
        """Polls until the block is left."""
        poller = asyncio.create_task(self._poll())
        try:
            yield self
        finally:
            self.close()
            poller.cancel()
            with suppress(asyncio.CancelledError):
                await poller

    def close(self) -> None:
        """Ends all streams. Their clients resume them at the next server."""
        self.closed = True
        self._wanted.set()
        for feed in self._feeds.values():
            feed.wake()

    async def stream(self, sequence: int, campaign: str, last_id: int) -> AsyncGenerator[Sequence[Message]]:
        """Yields a campaign's events after the event `last_id`, past and future, until its end; without any for KEEPALIVE_SECONDS an empty
        list."""
        position, progress, trouble = last_id, None, None
        with self._feed(sequence, campaign) as feed:
            while not self.closed:
                changed = feed.changed
                if feed.start is not None and position < feed.start:
                    messages, position = await self._history(feed, position)
                    if messages:
                        yield messages
                    continue
                messages, position = feed.after(position)
                if feed.trouble != trouble and not feed.ended:
                    trouble = feed.trouble
                    messages.append(_unstored(campaign, trouble or (feed.snapshot.degraded if feed.snapshot else None)))
                if feed.progress is not None and feed.progress != progress:
                    progress = feed.progress
                    messages.append(progress)
                if messages:
                    yield messages
                elif feed.ended:
                    return
                elif not await _within(KEEPALIVE_SECONDS, changed):
                    yield []

    @contextmanager
    def _feed(self, sequence: int, campaign: str) -> Iterator[Feed]:
        feed = self._feeds.get(sequence)
        if feed is None:
            feed = self._feeds[sequence] = Feed(sequence, campaign)
            self._wanted.set()
        feed.readers += 1
        try:
            yield feed
        finally:
            feed.readers -= 1
            if not feed.readers:
                del self._feeds[sequence]

    async def _history(self, feed: Feed, position: int) -> tuple[list[Message], int]:
        """Returns a page of events after a position, from the database, and the position after them."""

        def read() -> tuple[list[Message], int]:
            with self._database.read() as connection:
                page = events.since(connection, feed.sequence, position, PAGE)
            # None: what the feed begins after has been forgotten meanwhile.
            return [stored(event, feed.campaign) for event in page], page[-1].id if page else max(position, feed.start or 0)

        try:
            return await asyncio.to_thread(read)
        except DrivecalError:
            await _within(LOOK_SECONDS, feed.changed)  # the poller tells of it
            return [], position

    async def _poll(self) -> None:
        only_new = False
        while not self.closed:
            self._wanted.clear()
            try:
                await self._look(only_new=only_new)
            except DrivecalError as error:
                self._tell_outage(str(error))
            except Exception:  # must not end the poller: the streams would hang
                log.exception("event streams could not be fed")
            if self._feeds:
                only_new = await _within(LOOK_SECONDS, self._wanted)
            else:
                await self._wanted.wait()

    async def _look(self, *, only_new: bool) -> None:
        """Reads the campaigns of all feeds; with `only_new`, only campaigns that were not read yet."""
        feeds = [feed for feed in self._feeds.values() if not feed.ended and not (only_new and feed.start is not None)]
        if not feeds:
            return
        known = {feed.sequence: (feed.newest, feed.revision) for feed in feeds}
        looking = asyncio.create_task(asyncio.to_thread(self._read, known))
        done, _ = await asyncio.wait([looking], timeout=PATIENCE_SECONDS)
        if not done:
            self._tell_outage(f"the database {self._database.name} does not answer")
        look = await looking
        moment = now()
        silent = silence(look.heartbeat_at, moment)
        for feed in feeds:
            if self._take_in(feed, look, silent, moment):
                feed.wake()

    def _read(self, known: Mapping[int, tuple[int | None, int]]) -> _Look:
        with self._database.read() as connection:
            revisions = revision_queries.revisions(connection, known)
            changed = [sequence for sequence, revision in revisions.items() if known[sequence][1] != revision]
            new_events: dict[int, list[StoredEvent]] = {}
            newest: dict[int, int] = {}
            for sequence in changed:
                last = known[sequence][0]
                if last is None:
                    newest[sequence] = events.newest_id(connection, sequence)
                else:
                    new_events[sequence] = events.since(connection, sequence, last, PAGE)
            snapshots = {snapshot.sequence: snapshot for snapshot in revision_queries.snapshots(connection, changed)}
            return _Look(revision_queries.heartbeat(connection), snapshots, new_events, newest)

    def _take_in(self, feed: Feed, look: _Look, silent: str | None, moment: datetime) -> bool:
        """Updates a feed; returns whether anything of its campaign changed."""
        snapshot = look.snapshots.get(feed.sequence)
        if snapshot is not None:
            feed.snapshot, feed.revision = snapshot, snapshot.revision
            if feed.start is None:
                feed.start = look.newest.get(feed.sequence, 0)
            new_events = look.events.get(feed.sequence, [])
            feed.held.extend((event.id, stored(event, feed.campaign)) for event in new_events)
            while len(feed.held) > HELD:
                feed.start = feed.held.popleft()[0]
            if len(new_events) == PAGE:
                feed.revision = -1  # there is more
            else:
                feed.ended = snapshot.state.ended
        if feed.snapshot is None:
            return False
        said = degraded(feed.snapshot, silent)
        trouble = None if said == feed.snapshot.degraded else said
        if snapshot is None and trouble == feed.trouble:
            return False
        feed.trouble = trouble
        feed.progress = Message(None, PROGRESS, json.dumps(progress_document(feed.snapshot, said, moment)))
        return True

    def _tell_outage(self, reason: str) -> None:
        for feed in self._feeds.values():
            if feed.trouble != reason and not feed.ended:
                feed.trouble = reason
                feed.wake()


def stored(event: StoredEvent, campaign: str) -> Message:
    """Returns a stored event as a message."""
    return _event(event.id, event.kind, campaign, event.created_at, event.data)


def progress_document(snapshot: ProgressSnapshot, said: str | None, moment: datetime) -> dict[str, Any]:
    """Returns the `CampaignProgress` of a running campaign. `said`: why it is degraded."""
    cells = CellsByStage(stages={stage: CellCounts(**counts) for stage, counts in snapshot.stages.items()})
    return {
        "state": state_of(snapshot),
        "requested_action": snapshot.requested_action,
        "degraded": said,
        "waiting": snapshot.waiting,
        "stage": snapshot.stage,
        "iteration": snapshot.iteration,
        "progress": snapshot.progress,
        **cells.model_dump(),
        "best_objective": None if snapshot.best is None else snapshot.best["objective"],
        "seconds": seconds_of(snapshot, moment).model_dump(),
    }


def _unstored(campaign: str, trouble: str | None) -> Message:
    """Returns the event that the dispatcher or the database is silent, or answers again. No table holds it: its writer is silent."""
    if trouble is None:
        return _event(None, EventKind.RECOVERED, campaign, now(), {})
    return _event(None, EventKind.DEGRADED, campaign, now(), {"reason": trouble})


def _event(number: int | None, kind: str, campaign: str, at: datetime, data: Mapping[str, Any]) -> Message:
    document = {
        "id": number,
        "kind": kind,
        "campaign": campaign,
        "at": at.isoformat(),
        "text": event_text(kind, data),
        "data": data,
    }
    return Message(number, kind, json.dumps(document))


async def _within(seconds: float, event: asyncio.Event) -> bool:
    """Returns whether an event was set within `seconds`."""
    try:
        async with asyncio.timeout(seconds):
            await event.wait()
    except TimeoutError:
        return False
    return True
