"""Clocks that are set, and time zones: moments are stored in UTC, and nothing waits for a clock to catch up."""

from __future__ import annotations

import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

import pytest
from sqlalchemy import select, text
from tests.contract.storage.test_leases import pending, take
from tests.support.storage import campaign

from drivecal.api.responses import campaign_answer
from drivecal.storage import campaigns, leases
from drivecal.storage.engine import tables
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now

FOLD = datetime(2026, 10, 25, 0, 30, tzinfo=UTC)
"""02:30 in Berlin, which comes again an hour later."""


@pytest.fixture(params=["Europe/Berlin", "Australia/Lord_Howe", "America/St_Johns"])
def zone(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The time zone of the process."""
    monkeypatch.setenv("TZ", request.param)
    time.tzset()
    yield str(request.param)
    monkeypatch.undo()
    time.tzset()


def test_moments_of_an_hour_that_comes_twice_come_back_in_utc_and_in_order(database: Database, zone: str) -> None:
    moments = [FOLD + timedelta(minutes=10 * number) for number in range(12)]
    with database.transaction() as connection:
        if connection.dialect.name == "postgresql":
            connection.execute(text(f"SET LOCAL TIME ZONE '{zone}'"))
        sequence = campaign(connection).sequence
        rows = [{"campaign_sequence": sequence, "kind": "note", "data": {}, "created_at": moment} for moment in moments]
        connection.execute(tables.events.insert(), rows)
        query = select(tables.events.c.created_at).where(tables.events.c.kind == "note").order_by(tables.events.c.created_at)
        read = list(connection.scalars(query))
        later = query.where(tables.events.c.created_at >= moments[6])
        assert list(connection.scalars(later)) == moments[6:]
    assert read == moments
    assert {moment.tzinfo for moment in read} == {UTC}


def test_a_lease_that_was_given_back_is_granted_again_after_the_clock_was_set_back(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    ids = pending(database, 2)
    take(database, ids)
    with database.transaction() as connection:
        leases.give_back(connection, {ids[0]: 0})
    monkeypatch.setattr(leases, "now", lambda: now() - timedelta(hours=3))
    assert take(database, ids) == {ids[0]: 2}


def test_a_campaign_never_shows_a_negative_time(database: Database) -> None:
    with database.transaction() as connection:
        sequence = campaign(connection).sequence
        campaigns.start(connection, sequence)
        running = campaigns.by_sequence(connection, sequence)
    assert campaign_answer(running, now() - timedelta(hours=1), silent=None).seconds.wall == 0.0
    assert campaign_answer(running, now() + timedelta(hours=1), silent=None).seconds.wall >= 3600.0
