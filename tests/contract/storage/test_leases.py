import re
from collections.abc import Callable
from typing import Any

import pytest
from sqlalchemy import Connection, select, text
from tests.contract.storage.conftest import Backend
from tests.contract.storage.test_query_plans import gather_statistics, plans, scanned
from tests.support.storage import begun, cell

from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import Outcome
from drivecal.storage import evaluations, leases, processes
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.tables import leases as table
from drivecal.storage.engine.types import now
from drivecal.storage.evaluations import AnsweredCell


def pending(database: Database, count: int) -> list[int]:
    """Evaluations without an answer."""
    with database.transaction() as connection:
        sequence, setup, sets = begun(connection, count)
        return evaluations.insert(connection, sequence, [cell(n, setup, one) for n, one in enumerate(sets)])


def take(database: Database, ids: list[int], breakdowns: int = 0) -> dict[int, int]:
    with database.transaction() as connection:
        return leases.take(connection, dict.fromkeys(ids, breakdowns))


def elect(database: Database) -> None:
    with database.transaction() as connection:
        processes.elect(connection, "dispatcher", 1, now())


def test_a_leased_cell_is_not_granted_again_until_it_is_given_back(database: Database) -> None:
    ids = pending(database, 5)
    assert take(database, ids[:3]) == dict.fromkeys(ids[:3], 1)
    assert take(database, ids) == dict.fromkeys(ids[3:], 1)
    with database.transaction() as connection:
        leases.give_back(connection, {ids[0]: 1, ids[1]: 0})
    assert take(database, ids) == {ids[0]: 2, ids[1]: 2}


def test_a_lease_of_an_earlier_term_is_over(database: Database) -> None:
    ids = pending(database, 2)
    assert take(database, ids[:1]) == {ids[0]: 1}
    assert take(database, ids[:1]) == {}
    elect(database)
    assert take(database, ids[:1]) == {ids[0]: 2}
    assert take(database, ids[:1]) == {}


def test_a_lease_counts_starts_before_they_happen(database: Database) -> None:
    ids = pending(database, 3)
    with database.transaction() as connection:
        leases.take(connection, dict.fromkeys(ids, 0), twice={ids[0]})
        for _ in range(2):  # the second has no effect
            leases.give_back(connection, {ids[0]: 1, ids[1]: 0}, {ids[0]: 1, ids[1]: 1})
        assert leases.starts(connection, ids) == 1 + 3
    take(database, ids[:2])
    with database.transaction() as connection:
        assert leases.starts(connection, ids) == 1 + 3
        assert leases.end(connection, ids[:1]) == {ids[0]: (2, 0)}
        sequence = connection.scalar(text("SELECT campaign_sequence FROM evaluations WHERE id = :id"), {"id": ids[0]})
        assert leases.forget(connection, int(sequence)) == {StageName.CALIBRATION: (2, 0)}


def test_starts_that_end_with_their_dispatcher_or_worker_are_lost(database: Database) -> None:
    ids = pending(database, 2)
    take(database, ids)
    elect(database)
    take(database, ids)
    with database.transaction() as connection:
        leases.give_back(connection, {ids[1]: 0})
        assert leases.starts(connection, ids) == 2
        assert leases.end(connection, ids) == {ids[0]: (2, 1), ids[1]: (2, 2)}


def test_what_has_its_answer_is_not_leased(database: Database) -> None:
    ids = pending(database, 3)
    with database.transaction() as connection:
        evaluations.answer(connection, [AnsweredCell(ids[1], Outcome.FAILED, None, None, None, "crash")])
    assert take(database, [*ids, 10**9]) == {ids[0]: 1, ids[2]: 1}


def test_only_the_last_lease_of_the_term_in_office_is_current(database: Database) -> None:
    ids = pending(database, 4)
    take(database, ids)
    with database.transaction() as connection:
        leases.give_back(connection, {ids[0]: 1})
    take(database, ids[:1], breakdowns=1)
    with database.transaction() as connection:
        assert leases.current(connection, {ids[0]: 1, ids[1]: 1, ids[2]: 7, 10**9: 1}) == {ids[1]}
        assert leases.current(connection, {ids[0]: 2}) == {ids[0]}
        leases.end(connection, ids[:2])
        assert leases.current(connection, {ids[0]: 2, ids[1]: 1}) == set(), "a result counts once"
    elect(database)
    with database.transaction() as connection:
        assert leases.current(connection, {ids[3]: 1}) == set(), "its dispatcher is not in office any more"
        assert sorted(connection.scalars(select(table.c.evaluation_id))) == ids[2:]


def test_breakdowns_survive_a_dispatcher_and_its_own_end_is_none(database: Database) -> None:
    ids = pending(database, 3)
    take(database, ids[:2])
    with database.transaction() as connection:
        leases.give_back(connection, {ids[0]: 1})
    elect(database)
    with database.read() as connection:
        assert leases.breakdowns(connection, ids) == {ids[0]: 1}
    take(database, ids, breakdowns=1)
    elect(database)
    with database.transaction() as connection:
        assert leases.breakdowns(connection, ids) == dict.fromkeys(ids, 1)
        leases.give_back(connection, dict.fromkeys(ids, 2))
        assert leases.breakdowns(connection, ids) == dict.fromkeys(ids, 1), "a dispatcher of an earlier term has no say"


def test_an_ended_campaign_has_no_leases(database: Database) -> None:
    one, other = pending(database, 3), pending(database, 3)
    take(database, [*one, *other])
    with database.transaction() as connection:
        sequence = connection.scalar(text(f"SELECT campaign_sequence FROM evaluations WHERE id = {one[0]}"))
        leases.forget(connection, int(sequence))
        assert sorted(connection.scalars(select(table.c.evaluation_id))) == other


def test_two_connections_lease_different_cells_and_neither_waits(backend: Backend, database: Database) -> None:
    if backend == "sqlite":
        pytest.skip("there is one writer at a time")
    ids = pending(database, 40)
    with database.transaction() as one, database.transaction() as other:
        for connection in (one, other):
            connection.execute(text("SET LOCAL lock_timeout = '2s'"))
        first = leases.take(one, dict.fromkeys(ids[:25], 0))
        second = leases.take(other, dict.fromkeys(ids, 0))
    assert sorted(first) == ids[:25]
    assert sorted(second) == ids[25:]


@pytest.mark.slow("postgresql")
def test_leases_are_found_by_their_keys_among_very_many(database: Database, subtests: pytest.Subtests) -> None:
    ids = pending(database, 5_000)
    take(database, ids)
    gather_statistics(database)
    some = ids[:30]
    uses: dict[str, Callable[[Connection], Any]] = {
        "take": lambda connection: leases.take(connection, dict.fromkeys(some, 0)),
        "breakdowns": lambda connection: leases.breakdowns(connection, some),
        "give back": lambda connection: leases.give_back(connection, dict.fromkeys(some, 1)),
        "current": lambda connection: leases.current(connection, dict.fromkeys(some, 1)),
        "end": lambda connection: leases.end(connection, some),
    }
    with database.transaction() as connection:
        for name, use in uses.items():
            with subtests.test(name):
                plan = plans(connection, use)
                assert scanned(plan) == set(), plan
                assert not re.search(r'SCAN leases|"Seq Scan"[^{]*"leases"', plan), plan
                assert re.search("pk_(leases|evaluations)|INTEGER PRIMARY KEY", plan), plan
