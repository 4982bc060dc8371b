"""`drivecal db check` finds no fault at any moment of a campaign, and names each planted fault."""

from contextlib import nullcontext, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from sqlalchemy import Connection, text
from tests.support.computed import ComputedBackend
from tests.support.effort import tries
from tests.support.runs import SHORT, dispatcher, get, influenced, run, submit

from drivecal.contracts.work import Cell, CellResult
from drivecal.domain.errors import DatabaseError
from drivecal.domain.evaluations import Breakdown
from drivecal.storage import bundles, campaigns
from drivecal.storage.engine.database import Database
from drivecal.storage.maintenance import backup
from drivecal.storage.maintenance.consistency import TOLD, verify

OFTEN = tries(25, 1)
"""Steps between two checks."""


def problems(database: Database) -> list[str]:
    """Returns the faults, each with the name of its check."""
    return [f"{item.name}: {problem}" for item in verify(database) for problem in item.problems]


class UndoneError(Exception):
    """Ends a transaction that is to leave nothing behind."""


def problems_after(database: Database, statement: str) -> list[str]:
    """Returns the faults that the database would have after a commit of the statement: what its transaction sees."""
    result: list[str] = []
    with suppress(UndoneError), database.transaction() as connection:
        _without_foreign_keys(connection)
        connection.execute(text(statement.replace(":", r"\:")))
        seen: Any = SimpleNamespace(read=lambda: nullcontext(connection))
        result = problems(seen)
        raise UndoneError
    return result


def failing(scenario: str, cell: Cell) -> CellResult:
    """Some cells have no result."""
    if cell.parameters["P1"] > 0.8:
        return CellResult(cell.id, None, None, {}, None, 1.0, Breakdown.MEMORY.value, "as asked for")
    return influenced(scenario, cell)


@pytest.mark.faults
def test_nothing_is_broken_at_any_moment_of_campaigns(database: Database) -> None:
    listed = [submit(database, **SHORT), submit(database, **SHORT | {"weights": {"S1": 1}}), submit(database, **SHORT)]
    working = dispatcher(database, ComputedBackend(4, failing))
    steps = 0
    while not all(get(database, item).state.ended for item in listed):
        working.step()
        steps += 1
        if steps % OFTEN == 0:
            assert problems(database) == []
        if get(database, listed[2]).cells.simulated and not get(database, listed[2]).requested_action:
            with database.transaction() as connection:
                if not get(database, listed[2]).state.ended:
                    campaigns.request_action(connection, listed[2].id, "cancel")
        if steps == 40:
            working = dispatcher(database, ComputedBackend(5, failing))
    assert steps > 30
    again = submit(database, stored_map=get(database, listed[0]).influence_map_id, **SHORT | {"weights": {"S2": 1}})
    while not get(database, again).state.ended:
        working.step()
        steps += 1
        if steps % OFTEN == 0:
            assert problems(database) == []
    assert problems(database) == []
    with database.read() as connection:
        assert connection.scalar(text("SELECT count(*) FROM evaluations WHERE outcome = 'failed'")) > 0
        assert connection.scalar(text("SELECT count(*) FROM reference_keys")) > 0


BROKEN: dict[str, tuple[str, str]] = {
    "a counter": (
        """UPDATE campaign_stages SET cells = '{"reused": 999}' WHERE campaign_sequence = 1 AND stage = 2""",
        "counters",
    ),
    "a counter of the sensitivity stage": (
        """UPDATE campaign_stages SET cells = '{"requested": 1}' WHERE campaign_sequence = 1 AND stage = 1""",
        "counters",
    ),
    "an answer is gone": ("UPDATE evaluations SET outcome = NULL WHERE id = 7", "ended campaigns"),
    "a lease of an ended campaign": (
        """INSERT INTO leases (evaluation_id, number, attempts, starts, running, lost, term, at_worker)
        VALUES (7, 1, 0, 0, 1, 0, 1, TRUE)""",
        "ended campaigns",
    ),
    "an end without its moment": ("UPDATE campaigns SET ended_at = NULL WHERE sequence = 1", "ended campaigns"),
    "an answer without its run": ("UPDATE evaluations SET run_id = NULL WHERE id = 7", "answered cells"),
    "an answer with the run of another cell": ("UPDATE evaluations SET run_id = run_id + 1 WHERE id = 7", "answered cells"),
    "an answer without its score": ("UPDATE evaluations SET score = NULL WHERE id = 7", "answered cells"),
    "a copy of nothing": ("UPDATE evaluations SET reference = 99999 WHERE outcome = 'reused'", "answered cells"),
    "a run without a rating": ("DELETE FROM ratings WHERE run_id = 7", "references"),
    "a run of no cell": ("UPDATE runs SET evaluation_id = 99999 WHERE id = 7", "references"),
    "a watermark beyond all runs": ("UPDATE campaigns SET watermark = 99999 WHERE sequence = 1", "references"),
    "a score in a key": ("UPDATE reference_keys SET score = 6 - score WHERE run_id = 7", "copies in reference keys"),
}
"""Changes to the rows, and the check that reports each."""


@pytest.fixture
def filled(database: Database) -> Database:
    """A sound database with two campaigns: the first makes an analysis, the second takes its answers from the first."""
    analysed = run(database, submit(database, **SHORT), ComputedBackend(1, influenced))
    run(database, submit(database, stored_map=analysed.influence_map_id, **SHORT), ComputedBackend(2, influenced))
    return database


@pytest.mark.slow("postgresql")
def test_what_is_broken_is_found_and_named(filled: Database, subtests: pytest.Subtests) -> None:
    for name, (statement, check) in BROKEN.items():
        with subtests.test(name):
            result = problems_after(filled, statement)
            assert any(problem.startswith(f"{check}: ") for problem in result), result
    many = problems_after(filled, 'UPDATE campaign_stages SET cells = \'{"requested": 999, "simulated": 999}\'')
    counters = [problem for problem in many if problem.startswith("counters")]
    assert len(counters) == TOLD + 1
    assert counters[-1].startswith("counters: and ")
    assert problems(filled) == [], "each was undone"


def test_a_damaged_problem_is_named(database: Database) -> None:
    with database.transaction() as connection:
        bundles.add(connection, digest="0" * 64, name="damaged", manifest={}, archive=b"no archive")
    assert [problem.partition(":")[0] for problem in problems(database)] == ["problems"]


def _without_foreign_keys(connection: Connection) -> None:
    """The damage is that of a disk or a person, whom nothing stops."""
    if connection.dialect.name == "postgresql":
        connection.execute(text("SET LOCAL session_replication_role = replica"))


@pytest.mark.slow("postgresql")
def test_rows_that_point_nowhere_are_found_and_not_backed_up(filled: Database, tmp_path: Path) -> None:
    (tmp_path / "backups").mkdir()
    with filled.transaction() as connection:
        connection.execute(text("UPDATE evaluations SET run_id = 1 WHERE run_id = 7"))
    with filled._engine.connect() as connection:  # a connection that checks nothing
        if connection.dialect.name == "postgresql":
            connection.execute(text("SET session_replication_role = replica"))
        else:
            connection.exec_driver_sql("PRAGMA query_only = OFF")
            connection.exec_driver_sql("COMMIT")
            connection.exec_driver_sql("PRAGMA foreign_keys = OFF")
        connection.execute(text("DELETE FROM setups WHERE id = 1"))
        connection.commit()
    if filled.url.get_backend_name() == "sqlite":  # PostgreSQL has no check of rows that its triggers let pass
        assert any("storage" in problem and "setups" in problem for problem in problems(filled))
    with pytest.raises(DatabaseError, match="setups"):
        backup.write(filled, tmp_path / "backups" / "backup.db", lambda *_: None)
    assert list((tmp_path / "backups").iterdir()) == []
