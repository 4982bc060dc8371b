"""A superseded dispatcher writes nothing more, even before it notices its successor."""

import threading
from functools import partial

import pytest
from sqlalchemy import Connection, text
from tests.contract.storage.conftest import Backend
from tests.support.serve import until
from tests.support.storage import campaign

from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import SupersededError
from drivecal.storage import campaigns, processes
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now


def elect(database: Database, pid: int = 1) -> Database:
    """The database as a newly elected dispatcher has it."""
    with database.transaction() as connection:
        term = processes.elect(connection, "dispatcher", pid, now())
    return database.fenced(partial(processes.confirm, name="dispatcher", term=term))


def test_every_election_begins_a_new_term_which_heartbeats_leave_alone(connection: Connection) -> None:
    assert processes.term_in_office(connection) == 0
    for term in (1, 2, 3):
        assert processes.elect(connection, "dispatcher", 10 + term, now()) == term
        processes.heartbeat(connection, "dispatcher", 10 + term, now(), {"workers": []})
        stored = processes.read(connection, "dispatcher")
        assert processes.term_in_office(connection) == term
        assert stored is not None
        assert (stored.term, stored.pid) == (term, 10 + term)


def test_a_superseded_dispatcher_reads_but_writes_nothing(database: Database) -> None:
    first = elect(database)
    with first.transaction() as connection:
        sequence = campaign(connection).sequence
    second = elect(database)
    with pytest.raises(SupersededError, match=r"\b2\b.*\b1\b"), first.transaction() as connection:
        campaigns.end(connection, sequence, CampaignState.FAILED)
    with first.read() as connection:
        assert not campaigns.by_sequence(connection, sequence).state.ended
    with second.transaction() as connection:
        campaigns.start(connection, sequence)


def test_nobody_is_elected_while_a_transaction_of_the_one_before_runs(backend: Backend, database: Database) -> None:
    """Writes of a stopped dispatcher are committed before its successor reads, or never."""
    first = elect(database)
    elected = threading.Event()

    def supersede() -> None:
        elect(database, 2)
        elected.set()

    other = threading.Thread(target=supersede)
    with first.transaction() as connection:
        sequence = campaign(connection).sequence
        other.start()
        assert not elected.wait(0.5)
        if backend == "postgresql":
            waiting = "SELECT count(*) FROM pg_stat_activity WHERE wait_event_type = 'Lock' AND query LIKE '%FOR UPDATE%'"

            def waits() -> bool:
                with database.read() as looking:
                    return bool(looking.scalar(text(waiting)) == 1)

            until(waits, "the election waits for the lock")
            assert not elected.is_set()
    other.join(300)
    assert elected.is_set()
    with database.read() as connection:
        assert campaigns.by_sequence(connection, sequence).sequence == sequence
    with pytest.raises(SupersededError), first.transaction():
        raise AssertionError("the body is never reached")


def test_a_transaction_that_began_before_the_election_but_comes_late_is_refused(backend: Backend, database: Database) -> None:
    if backend == "sqlite":
        pytest.skip("a transaction has the only write lock from its first moment")
    elect(database)
    begun, goes_on = threading.Event(), threading.Event()
    superseded: list[SupersededError] = []

    def fence(connection: Connection) -> None:
        """Stops the first dispatcher between the beginning of a transaction and its first statement."""
        begun.set()
        assert goes_on.wait(300)
        processes.confirm(connection, "dispatcher", 1)

    def run() -> None:
        try:
            with database.fenced(fence).transaction() as connection:
                campaign(connection, "too late")
        except SupersededError as error:
            superseded.append(error)

    stopped = threading.Thread(target=run)
    stopped.start()
    assert begun.wait(300)
    elect(database, 2)
    goes_on.set()
    stopped.join(300)
    assert len(superseded) == 1
    with database.read() as connection:
        assert connection.scalar(text("SELECT count(*) FROM campaigns")) == 0


def test_heartbeats_do_not_wait_for_a_long_transaction(backend: Backend, database: Database) -> None:
    if backend == "sqlite":
        pytest.skip("there is one writer at a time")
    own = elect(database)
    with own.transaction(), own.transaction() as beating:
        beating.execute(text("SET LOCAL lock_timeout = '2s'"))
        processes.heartbeat(beating, "dispatcher", 1, now(), {})
