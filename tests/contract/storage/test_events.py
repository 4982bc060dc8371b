"""Events: in order, complete, and written with what they tell."""

import threading
from datetime import timedelta
from typing import Any

import pytest
from sqlalchemy import Connection, text
from tests.support.storage import campaign

from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import ConflictError
from drivecal.domain.events import EventKind
from drivecal.storage import campaigns, events
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now

MANY = 100


def told(connection: Connection, sequence: int) -> list[tuple[str, Any]]:
    """Kinds and states, in order."""
    return [(item.kind, item.data.get("state")) for item in events.since(connection, sequence, 0, MANY)]


def test_a_reader_gets_what_came_after_the_event_that_it_saw_last(connection: Connection) -> None:
    one, other = campaign(connection).sequence, campaign(connection).sequence
    for number in range(5):
        events.add(connection, one, EventKind.NOTE, {"text": str(number)})
        events.add(connection, other, EventKind.NOTE, {"text": "of another"})
    queued, *notes = events.since(connection, one, 0, MANY)
    assert (queued.kind, queued.campaign_sequence) == ("queued", one)
    assert [note.data["text"] for note in notes] == ["0", "1", "2", "3", "4"]
    assert [note.id for note in notes] == sorted({note.id for note in notes})
    first = events.since(connection, one, notes[0].id, limit=2)
    assert first == notes[1:3]
    assert events.since(connection, one, first[-1].id, limit=MANY) == notes[3:]
    assert events.since(connection, one, notes[-1].id, MANY) == []
    assert events.newest_id(connection, one) == notes[-1].id
    assert events.newest_id(connection, 10**6) == 0
    assert now() - notes[0].created_at < timedelta(minutes=1)


def test_every_change_of_state_is_told_once_and_asking_twice_tells_nothing_more(connection: Connection) -> None:
    stored = campaign(connection)
    sequence = stored.sequence
    for action in ("pause", "pause", "resume", "resume"):
        campaigns.request_action(connection, stored.id, action)
    assert campaigns.start(connection, sequence)
    assert not campaigns.start(connection, sequence)
    for _ in range(2):
        campaigns.request_action(connection, stored.id, "pause")
    campaigns.request_action(connection, stored.id, "resume")  # takes the pause back
    assert not campaigns.carry_out(connection, sequence, "pause")
    campaigns.request_action(connection, stored.id, "pause")
    assert campaigns.carry_out(connection, sequence, "pause")
    for _ in range(2):
        campaigns.request_action(connection, stored.id, "resume")
    assert campaigns.carry_out(connection, sequence, "resume")
    for _ in range(2):
        campaigns.request_action(connection, stored.id, "cancel")
    with pytest.raises(ConflictError):
        campaigns.request_action(connection, stored.id, "resume")
    assert campaigns.carry_out(connection, sequence, "cancel")
    assert campaigns.end(connection, sequence, CampaignState.CANCELLED)
    assert not campaigns.end(connection, sequence, CampaignState.CANCELLED)
    assert told(connection, sequence) == [
        ("queued", "queued"),
        ("paused", "paused"),
        ("queued", "queued"),
        ("running", "running"),
        ("pausing", "running"),
        ("resumed", "running"),
        ("pausing", "running"),
        ("paused", "paused"),
        ("resuming", "paused"),
        ("resumed", "running"),
        ("cancelling", "cancelling"),
        ("cancelled", "cancelled"),
    ]


def test_trouble_is_told_when_it_changes_and_not_with_every_look_at_it(connection: Connection) -> None:
    one, other = campaign(connection).sequence, campaign(connection).sequence
    for sequence in (one, other):
        campaigns.start(connection, sequence)
    for reason in (
        "no workers",
        "no workers",
        "Ray is gone",
        "worker-1.2 died",
        "worker-1.3 died",
        "2 of 4 fail",
        "4 of 4 fail",
        None,
        None,
    ):
        campaigns.degrade(connection, [one, other], reason)
    for sequence in (one, other):
        told = [(event.kind, event.data) for event in events.since(connection, sequence, 0, MANY)[2:]]
        reasons = [data["reason"] for kind, data in told if kind == "degraded"]
        assert reasons == ["no workers", "Ray is gone", "worker-1.2 died", "2 of 4 fail", "4 of 4 fail"], "one for all starts"
        assert [kind for kind, _ in told][5:] == ["recovered"]


def test_old_events_are_forgotten_in_portions_but_the_last_of_each_campaign_stays(connection: Connection) -> None:
    one, other, fresh = (campaign(connection).sequence for _ in range(3))
    for number in range(6):
        events.add(connection, one, EventKind.NOTE, {"text": str(number)})
    events.add(connection, other, EventKind.NOTE, {"text": "the last"})
    connection.execute(text("UPDATE events SET created_at = '2020-01-01 00:00:00'"))
    events.add(connection, fresh, EventKind.NOTE, {"text": "new"})
    limit = now() - timedelta(days=1)
    assert events.prune(connection, limit, at_most=5) == 5
    assert events.prune(connection, limit, at_most=5) == 3
    assert events.prune(connection, limit, at_most=5) == 0
    kept = [[event.data.get("text") for event in events.since(connection, n, 0, MANY)] for n in (one, other, fresh)]
    assert kept == [["5"], ["the last"], ["new"]]


def test_a_reader_cannot_overtake_a_writer_that_has_not_committed_yet(database: Database) -> None:
    """Two writers at one campaign: were numbers drawn without the lock, the reader would see the second's event, and then never ask for the
    first's, which has the smaller number and comes later."""
    with database.transaction() as connection:
        sequence = campaign(connection).sequence
        seen = events.newest_id(connection, sequence)
    first_has_written, second_is_done, seen_in_between = threading.Event(), threading.Event(), []

    def second() -> None:
        first_has_written.wait(10)
        with database.transaction() as connection:
            events.add(connection, sequence, EventKind.NOTE, {"text": "second"})
        second_is_done.set()

    thread = threading.Thread(target=second)
    thread.start()
    with database.transaction() as connection:
        events.add(connection, sequence, EventKind.NOTE, {"text": "first"})
        first_has_written.set()
        assert not second_is_done.wait(0.5), "the second did not wait for the first"
        with database.read() as reading:
            seen_in_between = events.since(reading, sequence, seen, MANY)
    thread.join(10)
    with database.read() as connection:
        result = events.since(connection, sequence, seen, MANY)
    assert seen_in_between == []
    assert [item.data["text"] for item in result] == ["first", "second"]


@pytest.mark.parametrize("backend", ["postgresql"], indirect=True)  # SQLite has one writer
def test_writers_of_different_campaigns_do_not_wait_for_each_other_on_postgresql(database: Database) -> None:
    with database.transaction() as connection:
        one, other = campaign(connection).sequence, campaign(connection).sequence
    with database.transaction() as connection, database.transaction() as beside:
        events.add(connection, one, EventKind.NOTE, {"text": "one"})
        beside.execute(text("SET LOCAL lock_timeout = '2s'"))
        events.add(beside, other, EventKind.NOTE, {"text": "other"})
