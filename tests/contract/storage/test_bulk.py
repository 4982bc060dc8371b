"""Statements over many rows do to the database what `Connection.execute` does with them, one after the other."""

from datetime import UTC, datetime, timedelta, timezone
from typing import Any

from sqlalchemy import Connection, bindparam, delete, select, update
from tests.support.storage import new_run, sample_set_ids, setup_id

from drivecal.storage.engine.bulk import execute_rows, insert, numbers
from drivecal.storage.engine.tables import processes, ratings, runs
from drivecal.storage.references.runs import insert_results

HERE = timezone(timedelta(hours=5))
ROWS: list[dict[str, Any]] = [
    {
        "name": name,
        "pid": pid,
        "started_at": datetime(2026, 1, pid, 12, tzinfo=HERE),
        "detail": {"b": [pid, None], "a": float("nan")},
    }
    for pid, name in enumerate(("first", "second", "third"), 1)
]
MOMENT = datetime(2026, 7, 1, 12, 30, 0, 250, tzinfo=UTC)


def stored(connection: Connection) -> list[tuple[Any, ...]]:
    """Everything of the processes, in the order of their numbers."""
    return [tuple(row) for row in connection.execute(select(processes).order_by(processes.c.pid))]


def test_rows_are_inserted_and_changed_as_by_sqlalchemy_itself(connection: Connection) -> None:
    new = processes.insert().values(heartbeat_at=MOMENT, term=3)
    change = update(processes).where(processes.c.name == bindparam("which"), processes.c.term == 3)
    changes = [{"which": "second", "process": 20}, {"which": "none", "process": 1}, {"which": "third", "process": 30}]
    for row in ROWS:
        connection.execute(new, row)
    for row in changes:
        connection.execute(change.values(pid=bindparam("process")), row)
    expected = stored(connection)
    connection.execute(delete(processes))
    execute_rows(connection, new, ROWS)
    changed = execute_rows(connection, change.values(pid=bindparam("process")), changes)
    assert stored(connection) == expected
    assert changed == 2
    assert [row[1] for row in expected] == [1, 20, 30]


def test_a_row_that_is_there_stays(connection: Connection) -> None:
    keep = insert(connection, processes).values(heartbeat_at=MOMENT).on_conflict_do_nothing(index_elements=["name"])
    execute_rows(connection, keep, ROWS[:2])
    execute_rows(connection, keep, [row | {"pid": 9} for row in ROWS])
    assert [row[1] for row in stored(connection)] == [1, 2, 9]
    assert execute_rows(connection, keep, []) == 0


def test_a_number_is_given_once_whatever_is_deleted(connection: Connection) -> None:
    given = list(numbers(connection, runs.c.id, 3))
    assert given == [1, 2, 3]
    assert list(numbers(connection, runs.c.id, 0)) == []
    setup = setup_id(connection)
    one, two = insert_results(connection, [new_run(setup, number) for number in sample_set_ids(connection, 2)])
    assert (one.id, two.id) == (4, 5)
    for table in (ratings, runs):
        connection.execute(delete(table))
    assert list(numbers(connection, runs.c.id, 2)) == [6, 7]
