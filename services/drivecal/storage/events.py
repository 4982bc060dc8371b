"""Events of campaigns: few and meaningful, each written in the transaction of its change.

A reader that has seen all events of a campaign up to some id never misses one by asking for those after it: ids of one campaign grow in the
order of commits. SQLite has one writer at a time. PostgreSQL draws a number long before its transaction ends: there a writer that adds
an event holds the lock of the campaign's row from before the number is drawn until the commit.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, case, delete, func, insert, select, update

from drivecal.domain.events import EventKind
from drivecal.storage.engine.records import record
from drivecal.storage.engine.tables import campaigns, events
from drivecal.storage.engine.types import now

POSTED = {EventKind.SUCCEEDED, EventKind.FAILED, EventKind.CANCELLED, EventKind.STALLED, EventKind.DEGRADED}
"""Kinds of the events of campaigns, without single evaluations, that a webhook posts."""


@dataclass(frozen=True, slots=True)
class StoredEvent:
    """An event; `data` depends on its `kind`."""

    id: int
    campaign_sequence: int
    kind: str
    data: Mapping[str, Any]
    created_at: datetime


def add(connection: Connection, campaign_sequence: int, kind: EventKind, data: Mapping[str, Any] | None = None) -> None:
    """Adds an event. The caller changes the campaign's row in the same transaction: streams look for events at a new revision only."""
    if connection.dialect.name == "postgresql":
        held = select(campaigns.c.sequence).where(campaigns.c.sequence == campaign_sequence)
        connection.execute(held.with_for_update(key_share=True))  # not in the way of rows that only refer to the campaign
    values = {"campaign_sequence": campaign_sequence, "kind": kind, "data": dict(data or {}), "created_at": now()}
    if kind in POSTED:
        posted = campaigns.c.kind != "evaluation"
        values["unposted"] = select(case((posted, True))).where(campaigns.c.sequence == campaign_sequence).scalar_subquery()
    connection.execute(insert(events).values(values))


def since(connection: Connection, campaign_sequence: int, last_id: int, limit: int) -> list[StoredEvent]:
    """The first `limit` events of a campaign after the one with id `last_id`, in their order."""
    query = select(events).where(events.c.campaign_sequence == campaign_sequence, events.c.id > last_id)
    return [record(StoredEvent, row) for row in connection.execute(query.order_by(events.c.id).limit(limit))]


def unposted(connection: Connection) -> list[StoredEvent]:
    """The first thousand events of all campaigns, without single evaluations, that no webhook has posted."""
    query = select(events).where(events.c.unposted.is_not(None)).order_by(events.c.id).limit(1000)
    return [record(StoredEvent, row) for row in connection.execute(query)]


def mark_posted(connection: Connection, event_id: int | None = None) -> None:
    """Marks an event as posted, or all of them."""
    here = events.c.unposted.is_not(None) if event_id is None else events.c.id == event_id
    connection.execute(update(events).where(here).values(unposted=None))


def newest_id(connection: Connection, campaign_sequence: int) -> int:
    """Returns the id of a campaign's last event; 0 without events."""
    query = select(func.max(events.c.id)).where(events.c.campaign_sequence == campaign_sequence)
    return connection.execute(query).scalar() or 0


def prune(connection: Connection, older_than: datetime, at_most: int = 10_000) -> int:
    """Removes at most `at_most` older events and returns how many.

    The last event of a campaign stays, however old: it tells a returning client the campaign's state.
    """
    newer = events.alias("newer")
    followed = select(newer.c.id).where(newer.c.campaign_sequence == events.c.campaign_sequence, newer.c.id > events.c.id)
    old = select(events.c.id).where(events.c.created_at < older_than, followed.exists()).limit(at_most)
    return connection.execute(delete(events).where(events.c.id.in_(old))).rowcount
