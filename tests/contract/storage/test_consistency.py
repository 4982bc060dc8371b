"""`drivecal db check` finds no fault at any moment of a campaign, and names each planted fault."""

import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import Connection, text
from tests.support.computed import ComputedBackend
from tests.support.effort import tries
from tests.support.runs import WITH_ANALYSIS, dispatcher, get, influenced, run, submit

from drivecal.campaigns.results import verification
from drivecal.campaigns.results.verification import verify
from drivecal.contracts.work import Cell, CellResult
from drivecal.domain.errors import DatabaseError
from drivecal.domain.evaluations import Breakdown
from drivecal.storage import campaigns
from drivecal.storage.engine.database import Database
from drivecal.storage.maintenance import backup

SMALL: dict[str, Any] = WITH_ANALYSIS | {
    "sensitivity": {"intervals": 2, "samples": 3, "threshold": 0.02},
    "optimizer": {"kind": "genetic", "population": 10, "iterations": 3, "seed": 2},
}


OFTEN = tries(25, 1)
"""Steps between two checks."""


def problems(database: Database, *, full: bool = True) -> list[str]:
    """Returns the faults, each with the name of its check."""
    return [f"{item.name}: {problem}" for item in verify(database, full=full) for problem in item.problems]


class UndoneError(Exception):
    """Ends a transaction that is to leave nothing behind."""


class Uncommitted:
    """A database as one of its transactions sees it."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    @contextmanager
    def read(self) -> Iterator[Connection]:
        yield self._connection


def problems_after(database: Database, statement: str) -> list[str]:
    """Returns the faults that the database would have after a commit of the statement."""
    result: list[str] = []
    with suppress(UndoneError), database.transaction() as connection:
        _without_foreign_keys(connection)
        connection.execute(text(statement.replace(":", r"\:")))
        seen: Any = Uncommitted(connection)
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
    listed = [submit(database, **SMALL), submit(database, **SMALL | {"weights": {"S1": 1}}), submit(database, **SMALL)]
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
    again = submit(database, stored_map=get(database, listed[0]).influence_map_id, **SMALL | {"weights": {"S2": 1}})
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
        """INSERT INTO leases (evaluation_id, number, attempts, starts, running, lost, term, expires_at)
        VALUES (7, 1, 0, 0, 1, 0, 1, '2026-01-01 00:00:00+00')""",
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
    "a missing key": ("DELETE FROM reference_keys WHERE run_id = 7", "reference keys"),
    "a key of another value": ("UPDATE reference_keys SET run_id = 6 WHERE run_id = 7", "reference keys"),
    "a parameter set under another's key": (
        """UPDATE parameter_sets SET parameter_values = '{"P1": 0.123}' WHERE id = 9""",
        "parameter sets",
    ),
    "a parameter set that is none": ("UPDATE parameter_sets SET parameter_values = '[' WHERE id = 9", "parameter sets"),
    "a specification of nothing": (
        "UPDATE campaigns SET spec = '{\"optimizer\": 7}' WHERE sequence = 1",
        "campaigns, setups and maps",
    ),
    "a setup under another's fingerprint": (
        "UPDATE setups SET fingerprint = 'mine' WHERE id = 1",
        "campaigns, setups and maps",
    ),
    "a map of nothing": (
        "UPDATE influence_maps SET scenarios = '{\"S1\": 7}' WHERE sequence = 1",
        "campaigns, setups and maps",
    ),
}
"""Changes to the rows, and the check that reports each."""


@pytest.fixture
def filled(database: Database) -> Database:
    """A sound database with two campaigns: the first makes an analysis, the second takes its answers from the first."""
    analysed = run(database, submit(database, **SMALL), ComputedBackend(1, influenced))
    run(database, submit(database, stored_map=analysed.influence_map_id, **SMALL), ComputedBackend(2, influenced))
    return database


@pytest.mark.slow("postgresql")
def test_what_is_broken_is_found_and_named(filled: Database, backend: str, subtests: pytest.Subtests) -> None:
    for name, (statement, check) in BROKEN.items():
        with subtests.test(name):
            if name == "a key of another value":
                statement = "UPDATE reference_keys SET key = CAST('0123456789abcdef' AS {}) WHERE run_id = 7".format(
                    "BLOB" if backend == "sqlite" else "BYTEA"
                )
            result = problems_after(filled, statement)
            assert any(problem.startswith(f"{check}: ") for problem in result), result
    assert problems(filled) == [], "each was undone"


def _without_foreign_keys(connection: Connection) -> None:
    """The damage is that of a disk or a person, whom nothing stops."""
    if connection.dialect.name == "postgresql":
        connection.execute(text("SET LOCAL session_replication_role = replica"))


@pytest.mark.slow("postgresql")
@pytest.mark.parametrize(
    ("statement", "words"),
    [
        ("DROP INDEX ix_evaluations_pending", "ix_evaluations_pending"),
        ("ALTER TABLE events DROP COLUMN data", "data"),
        ("DROP TABLE leases", "leases"),
    ],
)
def test_what_a_schema_misses_is_found(empty_url: str, statement: str, words: str) -> None:
    database = Database.open(empty_url)
    database.upgrade()
    assert problems(database) == []
    with database.transaction() as connection:
        connection.execute(text("CREATE TABLE somebody (id INTEGER PRIMARY KEY)"))
        connection.execute(text("CREATE INDEX ix_somebody ON somebody (id)"))
    assert problems(database) == [], "others' tables are their own business"
    with database.transaction() as connection:
        connection.execute(text(statement))
    result = problems(database)
    assert result
    assert all(item.startswith("tables: ") for item in result)
    assert any(words in entry for entry in result)
    database.dispose()


def test_numbers_that_are_taken_are_found(filled: Database) -> None:
    with filled.transaction() as connection:
        if connection.dialect.name == "postgresql":
            connection.execute(text("SELECT setval(pg_get_serial_sequence('runs', 'id'), 5)"))
        else:
            connection.execute(text("UPDATE sqlite_sequence SET seq = 5 WHERE name = 'runs'"))
    [found] = problems(filled)
    assert re.search(r"\bruns\b.*\b6\b", found)


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
    assert any("storage" in problem and "setups" in problem for problem in problems(filled))
    with pytest.raises(DatabaseError, match="setups"):
        backup.write(filled, tmp_path / "backups" / "backup.db", lambda *_: None)
    assert list((tmp_path / "backups").iterdir()) == []


def test_documents_that_are_none_are_found(filled: Database) -> None:
    with filled.transaction() as connection:
        if connection.dialect.name == "postgresql":
            pytest.skip("PostgreSQL takes no such document")
        connection.execute(text("UPDATE runs SET metrics = '{' WHERE id < 4"))
    assert "documents: 3 documents in runs.metrics are no JSON" in problems(filled)


@pytest.mark.slow("postgresql")
def test_a_sample_leaves_out_what_a_full_check_finds(filled: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verification, "SAMPLED", 50)
    assert problems(filled, full=False) == []
    with filled.transaction() as connection:
        connection.execute(text("UPDATE parameter_sets SET parameter_values = '{}' WHERE id IN (7, 8)"))
    sampled = [problem for problem in problems(filled, full=False) if problem.startswith("parameter sets")]
    assert sampled == []  # it looks at every third
    assert any(item.startswith("parameter sets: 2 ") for item in problems(filled))


def test_many_problems_of_a_kind_are_told_in_a_few_sentences(filled: Database) -> None:
    with filled.transaction() as connection:
        connection.execute(text('UPDATE campaign_stages SET cells = \'{"requested": 999, "simulated": 999}\''))
    result = [problem for problem in problems(filled) if problem.startswith("counters")]
    assert len(result) == verification.TOLD + 1
    assert result[-1].startswith("counters: and ")
