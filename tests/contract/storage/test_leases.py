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


def pending(connection: Connection, count: int) -> list[int]:
    """Evaluations without an answer."""
    sequence, setup, sets = begun(connection, count)
    return evaluations.insert(connection, sequence, [cell(n, setup, one) for n, one in enumerate(sets)])


def take(connection: Connection, ids: list[int], breakdowns: int = 0) -> dict[int, int]:
    return leases.take(connection, dict.fromkeys(ids, breakdowns))


def elect(connection: Connection) -> None:
    processes.elect(connection, "dispatcher", 1, now())


def test_a_leased_cell_is_not_granted_again_until_it_is_given_back(connection: Connection) -> None:
    ids = pending(connection, 5)
    assert take(connection, ids[:3]) == dict.fromkeys(ids[:3], 1)
    assert take(connection, ids) == dict.fromkeys(ids[3:], 1)
    leases.give_back(connection, {ids[0]: 1, ids[1]: 0})
    assert take(connection, ids) == {ids[0]: 2, ids[1]: 2}


def test_a_lease_of_an_earlier_term_is_over(connection: Connection) -> None:
    ids = pending(connection, 2)
    assert take(connection, ids[:1]) == {ids[0]: 1}
    assert take(connection, ids[:1]) == {}
    elect(connection)
    assert take(connection, ids[:1]) == {ids[0]: 2}
    assert take(connection, ids[:1]) == {}


def test_a_lease_counts_starts_before_they_happen(connection: Connection) -> None:
    ids = pending(connection, 3)
    leases.take(connection, dict.fromkeys(ids, 0), twice={ids[0]})
    for _ in range(2):  # the second has no effect
        leases.give_back(connection, {ids[0]: 1, ids[1]: 0}, {ids[0]: 1, ids[1]: 1})
    assert leases.starts(connection, ids) == {ids[0]: 1, ids[1]: 0, ids[2]: 0}
    take(connection, ids[:2])
    assert leases.starts(connection, ids) == {ids[0]: 1, ids[1]: 0, ids[2]: 0}
    assert leases.end(connection, ids[:1]) == {ids[0]: (2, 0)}
    sequence = connection.scalar(text("SELECT campaign_sequence FROM evaluations WHERE id = :id"), {"id": ids[0]})
    assert leases.forget(connection, int(sequence)) == {StageName.CALIBRATION: (2, 0)}


def test_starts_that_end_with_their_dispatcher_or_worker_are_lost(connection: Connection) -> None:
    ids = pending(connection, 4)
    take(connection, ids)
    elect(connection)
    take(connection, ids[:2])
    leases.give_back(connection, {ids[1]: 0})
    assert leases.starts(connection, ids) == dict.fromkeys(ids, 0)
    assert leases.end(connection, ids[:3]) == {ids[0]: (2, 1), ids[1]: (2, 2), ids[2]: (1, 1)}
    sequence = connection.scalar(text("SELECT campaign_sequence FROM evaluations WHERE id = :id"), {"id": ids[0]})
    assert leases.forget(connection, int(sequence)) == {StageName.CALIBRATION: (1, 1)}


def test_a_cell_whose_starts_are_all_lost_takes_the_run_of_another(connection: Connection) -> None:
    """The first one has its own, the second one lost its start with a worker, the third one with a dispatcher, the last one had none."""
    ids = pending(connection, 4)
    take(connection, ids[2:3])
    elect(connection)
    take(connection, ids[:2])
    leases.give_back(connection, {ids[1]: 0})
    answers = [AnsweredCell(number, Outcome.SIMULATED, 5.0, 5.0, None) for number in ids]
    assert evaluations.answer(connection, answers) == (3, 2, 3)


def test_what_has_its_answer_is_not_leased(connection: Connection) -> None:
    ids = pending(connection, 3)
    evaluations.answer(connection, [AnsweredCell(ids[1], Outcome.FAILED, None, None, None, "crash")])
    assert take(connection, [*ids, 10**9]) == {ids[0]: 1, ids[2]: 1}


def test_only_the_last_lease_of_the_term_in_office_is_current(connection: Connection) -> None:
    ids = pending(connection, 4)
    take(connection, ids)
    leases.give_back(connection, {ids[0]: 1})
    take(connection, ids[:1], breakdowns=1)
    assert leases.current(connection, {ids[0]: 1, ids[1]: 1, ids[2]: 7, 10**9: 1}) == {ids[1]}
    assert leases.current(connection, {ids[0]: 2}) == {ids[0]}
    leases.end(connection, ids[:2])
    assert leases.current(connection, {ids[0]: 2, ids[1]: 1}) == set(), "a result counts once"
    elect(connection)
    assert leases.current(connection, {ids[3]: 1}) == set(), "its dispatcher is not in office any more"
    assert sorted(connection.scalars(select(table.c.evaluation_id))) == ids[2:]


def test_breakdowns_survive_a_dispatcher_and_its_own_end_is_none(connection: Connection) -> None:
    ids = pending(connection, 3)
    take(connection, ids[:2])
    leases.give_back(connection, {ids[0]: 1})
    elect(connection)
    assert leases.breakdowns(connection, ids) == {ids[0]: 1}
    take(connection, ids, breakdowns=1)
    elect(connection)
    assert leases.breakdowns(connection, ids) == dict.fromkeys(ids, 1)
    leases.give_back(connection, dict.fromkeys(ids, 2))
    assert leases.breakdowns(connection, ids) == dict.fromkeys(ids, 1), "a dispatcher of an earlier term has no say"


def test_an_ended_campaign_has_no_leases(connection: Connection) -> None:
    one, other = pending(connection, 3), pending(connection, 3)
    take(connection, [*one, *other])
    sequence = connection.scalar(text(f"SELECT campaign_sequence FROM evaluations WHERE id = {one[0]}"))
    leases.forget(connection, int(sequence))
    assert sorted(connection.scalars(select(table.c.evaluation_id))) == other


def test_two_connections_lease_different_cells_and_neither_waits(backend: Backend, database: Database) -> None:
    if backend == "sqlite":
        pytest.skip("there is one writer at a time")
    with database.transaction() as connection:
        ids = pending(connection, 40)
    with database.transaction() as one, database.transaction() as other:
        for connection in (one, other):
            connection.execute(text("SET LOCAL lock_timeout = '2s'"))
        first = leases.take(one, dict.fromkeys(ids[:25], 0))
        second = leases.take(other, dict.fromkeys(ids, 0))
    assert sorted(first) == ids[:25]
    assert sorted(second) == ids[25:]


@pytest.mark.slow("postgresql")
def test_leases_are_found_by_their_keys_among_very_many(database: Database, subtests: pytest.Subtests) -> None:
    with database.transaction() as connection:
        ids = pending(connection, 5_000)
        take(connection, ids)
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
