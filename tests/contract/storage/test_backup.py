"""Backups of a database in use, and back: one moment, complete or not there at all, whichever backend it came from and goes to."""

import os
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from sqlalchemy import text
from tests.support.computed import ComputedBackend
from tests.support.runs import SHORT, dispatcher, finish, get, influenced, post_map, run, submit
from tests.support.storage import PROCESSES, campaign

from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import DatabaseError, UnavailableError
from drivecal.domain.events import EventKind
from drivecal.storage import campaigns, events, generations, results
from drivecal.storage.engine import schema
from drivecal.storage.engine.database import Database
from drivecal.storage.maintenance import backup
from drivecal.storage.maintenance.backup import copy_rows, tables_of
from drivecal.storage.maintenance.consistency import verify

INFLUENCES = {"S1": {"P1": {"influential": False}, "P2": {"influential": True, "lower": 0.5}}}


def silent(table: str, done: int, total: int) -> None:
    """Ignores the progress of a copy."""


@pytest.fixture
def target_url(backend: str, request: pytest.FixtureRequest, tmp_path: Path) -> Callable[[str], str]:
    """Gives the URL of a second, empty database of a backend; on PostgreSQL once."""
    del backend
    return lambda kind: (
        f"sqlite:///{tmp_path / 'restored.db'}" if kind == "sqlite" else str(request.getfixturevalue("postgres_url"))
    )


def fill(database: Database) -> None:
    """Puts everything into a database: an ended campaign with its analysis, events, leases, a campaign that runs."""
    run(database, submit(database, **SHORT), ComputedBackend(1, influenced))
    running = submit(database, stored_map=post_map(database, INFLUENCES), name="running", reduction={"audit": 0.2})
    working = dispatcher(database, ComputedBackend(1))
    while (get(database, running).iteration or 0) < 2 or not get(database, running).cells.pending:
        working.step()
    with database.transaction() as connection:  # those with the largest numbers are gone, and their numbers must not come again
        connection.execute(text("DELETE FROM events WHERE id > 3"))


@pytest.fixture(scope="module")
def used_sqlite(migrated_sqlite: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An SQLite database with everything in it, to be copied."""
    path = tmp_path_factory.mktemp("used") / "drivecal.db"
    shutil.copy(migrated_sqlite, path)
    database = Database.open(f"sqlite:///{path}")
    fill(database)
    database.dispose()
    return path


@pytest.fixture
def used(backend: str, request: pytest.FixtureRequest, tmp_path: Path) -> Database:
    """A database with everything in it."""
    if backend == "sqlite":
        file = shutil.copy(request.getfixturevalue("used_sqlite"), tmp_path / "drivecal.db")
        database = Database.open(f"sqlite:///{file}")
    else:
        database = Database.open(request.getfixturevalue("clean_postgres"))
        fill(database)
    return database


def everything(database: Database) -> dict[str, Any]:
    """All rows of an SQLite database."""
    with database.read() as connection:
        tables = [*(table.name for table in tables_of(connection)), "sqlite_sequence"]
        return {name: sorted(map(tuple, connection.execute(text(f"SELECT * FROM {name}"))), key=repr) for name in tables}


def as_file(database: Database, tmp_path: Path) -> Database:
    """The database as an SQLite file: itself or a backup of it."""
    if database.url.get_backend_name() == "sqlite":
        return database
    file = tmp_path / f"{len(list(tmp_path.iterdir()))}.db"
    backup.write(database, file, silent)
    return Database.open(f"sqlite:///{file}")


@pytest.mark.slow("postgresql-postgresql", "sqlite-postgresql", "postgresql-sqlite")
@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_restored_rows_are_equal(used: Database, target_url: Callable[[str], str], kind: str, tmp_path: Path) -> None:
    file = tmp_path / "backup.db"
    written = backup.write(used, file, silent)
    assert written.rows["runs"] > 200
    assert written.rows["events"] == 3
    target = Database.open(target_url(kind))
    assert backup.restore(file, target, silent) == written
    assert [verdict for verdict in verify(target) if verdict.problems] == []
    before, after = everything(as_file(used, tmp_path)), everything(as_file(target, tmp_path))
    assert {name: after[name] for name in before} == before
    assert before["sqlite_sequence"]
    with target.transaction() as connection:
        events.add(connection, 1, EventKind.NOTE, {"text": "new"})
        [new] = connection.execute(text("SELECT max(id) FROM events")).scalars()
        campaign(connection)
    assert new > dict(before["sqlite_sequence"])["events"] > 3


@pytest.mark.slow
def test_a_restored_campaign_goes_on(used: Database, target_url: Callable[[str], str], tmp_path: Path, backend: str) -> None:
    backup.write(used, tmp_path / "backup.db", silent)
    target = Database.open(target_url(backend))
    backup.restore(tmp_path / "backup.db", target, silent)
    result = []
    for database in (used, target):
        with database.read() as connection:
            [running] = [item for item in campaigns.page(connection)[0] if item.name == "test" and item.priority == 0][:1]
        ended = finish(database, running, dispatcher(database, ComputedBackend(9)))
        with database.read() as connection:
            rows = [
                (row.id, row.iteration, row.individual, row.scenario, row.outcome, row.score, row.rating, row.reference)
                for row in results.stream(connection, running.sequence)
            ]
            figures, _ = generations.page(connection, running.sequence)
        result.append((ended.state, ended.cells, ended.best, [row[1:7] for row in rows], figures))
    assert result[0] == result[1]
    assert result[0][0] is CampaignState.SUCCEEDED


@pytest.mark.slow
def test_a_backup_holds_one_moment_of_a_used_database(used: Database, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivecal.storage.maintenance.backup.PAGES", 16)
    monkeypatch.setattr("drivecal.storage.maintenance.backup.CHUNK", 200)
    written = []

    def write_meanwhile(*_: object) -> None:
        with used.transaction() as connection:
            written.append(campaign(connection, "meanwhile").sequence)
            connection.execute(text("DELETE FROM leases"))
            connection.execute(text("UPDATE parameter_sets SET parameter_values = '{}'"))

    before = everything(as_file(used, tmp_path))
    copied = backup.write(used, tmp_path / "backup.db", write_meanwhile)
    assert len(written) > 5
    assert everything(Database.open(f"sqlite:///{tmp_path / 'backup.db'}")) | {"sqlite_sequence": 0} == before | {
        "sqlite_sequence": 0
    }
    assert copied.rows["campaigns"] == len(before["campaigns"])
    with used.read() as connection:
        assert connection.scalar(text("SELECT count(*) FROM campaigns WHERE name = 'meanwhile'")) == len(written)


@pytest.mark.parametrize("suffix", ["", "-journal", "-wal"])
def test_an_existing_file_is_never_replaced(database: Database, tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"backup.db{suffix}"
    file.write_text("precious")
    with pytest.raises(DatabaseError):
        backup.write(database, tmp_path / "backup.db", silent)
    assert file.read_text() == "precious"


@pytest.mark.slow("postgresql")
def test_a_backup_that_fails_leaves_nothing_behind(used: Database, tmp_path: Path) -> None:
    with pytest.raises(UnavailableError, match="the disk is gone"):
        backup.write(used, tmp_path / "backup.db", Mock(side_effect=UnavailableError("the disk is gone")))
    assert not list(tmp_path.glob("*backup*"))


def test_a_copy_that_lacks_rows_is_no_backup(used_sqlite: Path, tmp_path: Path) -> None:
    def lose(_: str, done: int, total: int) -> None:
        if done == total:
            (partial,) = tmp_path.glob("*.partial*")
            with closing(sqlite3.connect(partial)) as copy, copy:
                copy.execute("DELETE FROM events")

    database = Database.open(f"sqlite:///{used_sqlite}")
    with pytest.raises(DatabaseError, match="in events"):
        backup.write(database, tmp_path / "backup.db", lose)
    assert not list(tmp_path.glob("*backup*"))


def test_places_where_no_backup_can_be_are_named(database: Database, tmp_path: Path) -> None:
    with pytest.raises(DatabaseError, match=rf"{re.escape(str(tmp_path))}(?!/)"):
        backup.write(database, tmp_path, silent)
    with pytest.raises(DatabaseError, match="/missing"):
        backup.write(database, tmp_path / "missing" / "backup.db", silent)


def test_a_database_is_never_backed_up_into_itself(database: Database, tmp_path: Path) -> None:
    if database.url.get_backend_name() == "sqlite":
        with pytest.raises(DatabaseError):
            backup.write(database, tmp_path / "drivecal.db", silent)
        with pytest.raises(DatabaseError):
            backup.restore(tmp_path / "drivecal.db", database, silent)
    database.check()


def test_an_empty_database_is_not_backed_up(empty_url: str, tmp_path: Path) -> None:
    database = Database.open(empty_url)
    with pytest.raises(DatabaseError):
        backup.write(database, tmp_path / "backup.db", silent)
    assert not (tmp_path / "backup.db").exists()
    assert not (tmp_path / "drivecal.db").exists(), "looking for it does not make it"


def test_a_database_without_one_of_its_tables_is_not_copied(empty_url: str, tmp_path: Path) -> None:
    database, target = Database.open(empty_url), Database.open(f"sqlite:///{tmp_path / 'target.db'}")
    for item in (database, target):
        item.upgrade()
    with database.transaction() as connection:
        connection.execute(text("DROP TABLE leases"))
    with pytest.raises(DatabaseError, match="leases"), database.read() as source, target.transaction() as connection:
        copy_rows(source, connection, silent)


@pytest.mark.slow("postgresql")
def test_a_database_with_rows_is_not_restored_into(used: Database, tmp_path: Path) -> None:
    file = tmp_path / "backup.db"
    backup.write(used, file, silent)
    with pytest.raises(DatabaseError, match=r"\d in campaigns"):
        backup.restore(file, used, silent)
    with used.read() as connection:
        assert connection.scalar(text("SELECT count(*) FROM runs")) > 200


@pytest.mark.slow("postgresql")
def test_tables_of_another_program_outlive_a_restore(database: Database, empty_url: str, tmp_path: Path) -> None:
    file = tmp_path / "backup.db"
    backup.write(database, file, silent)
    target = Database.open(empty_url.replace("drivecal.db", "target.db"))
    target.upgrade()
    with target.transaction() as connection:
        connection.execute(text("CREATE TABLE moz_places (id INTEGER)"))
    with pytest.raises(DatabaseError, match="moz_places"):
        backup.restore(file, target, silent)
    with target.transaction() as connection:
        connection.execute(text("INSERT INTO moz_places VALUES (1)"))
        assert connection.scalar(text("SELECT count(*) FROM campaigns")) == 0
        connection.execute(text("DROP TABLE moz_places"))
    assert backup.restore(file, target, silent).rows["campaigns"] == 0


@pytest.mark.slow("postgresql")
def test_an_unused_database_is_empty(used: Database, target_url: Callable[[str], str], tmp_path: Path, backend: str) -> None:
    target = Database.open(target_url(backend))
    target.upgrade()
    with target.transaction() as connection:
        connection.execute(
            text("INSERT INTO processes SELECT 'dispatcher', 1, now, now, '{}', 7 FROM (SELECT CURRENT_TIMESTAMP AS now) t")
        )
    written = backup.write(used, tmp_path / "backup.db", silent)
    assert backup.restore(tmp_path / "backup.db", target, silent) == written


@pytest.mark.parametrize("content", [b"This is no database." * 100, b"", b"\x00" * 4096])
def test_what_is_no_backup_is_not_restored(empty_url: str, tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "notes.txt"
    file.write_bytes(content)
    database = Database.open(empty_url)
    with pytest.raises(DatabaseError, match=r"notes\.txt"):
        backup.restore(file, database, silent)
    with pytest.raises(DatabaseError, match=re.escape(str(tmp_path / "missing"))):
        backup.restore(tmp_path / "missing", database, silent)
    assert file.read_bytes() == content


@pytest.mark.slow("postgresql")
def test_a_damaged_backup_is_refused(used: Database, target_url: Callable[[str], str], tmp_path: Path, backend: str) -> None:
    file = tmp_path / "backup.db"
    backup.write(used, file, silent)
    with closing(sqlite3.connect(file)) as plain:
        size = plain.execute("PRAGMA page_size").fetchone()[0]
        root = plain.execute("SELECT rootpage FROM sqlite_master WHERE name = 'ix_runs_setup_id_id'").fetchone()[0]
    content = bytearray(file.read_bytes())
    content[(root - 1) * size + 8 : root * size] = os.urandom(size - 8)
    file.write_bytes(content)
    target = Database.open(target_url(backend))
    with pytest.raises(DatabaseError, match="damaged"):
        backup.restore(file, target, silent)
    with pytest.raises(DatabaseError):
        target.check()


def test_a_newer_releases_backup_is_refused(database: Database, target_url: Callable[[str], str], tmp_path: Path) -> None:
    file = tmp_path / "backup.db"
    backup.write(database, file, silent)
    with closing(sqlite3.connect(file)) as plain, plain:
        plain.execute(f"UPDATE {schema.REVISION_TABLE} SET version_num = '9999'")
    target = Database.open(target_url("sqlite"))
    with pytest.raises(DatabaseError, match=r"backup\.db.*9999"):
        backup.restore(file, target, silent)


@pytest.mark.slow
def test_a_killed_restore_has_no_rows(used: Database, target_url: Callable[[str], str], tmp_path: Path, backend: str) -> None:
    file = tmp_path / "backup.db"
    written = backup.write(used, file, silent)
    url = target_url(backend)
    process = PROCESSES.Process(target=_restore_and_die, args=(file, url))
    process.start()
    process.join()
    assert process.exitcode == -signal.SIGKILL
    target = Database.open(url)
    assert backup.restore(file, target, silent) == written
    assert [verdict for verdict in verify(target) if verdict.problems] == []


def _restore_and_die(file: Path, url: str) -> None:
    backup.PAGES = 16

    def die(table: str, done: int, total: int) -> None:
        if table in {"pages", "runs"} and done > 0 and (done < total or table == "runs"):
            os.kill(os.getpid(), signal.SIGKILL)

    backup.restore(file, Database.open(url), die)


@pytest.mark.slow("postgresql")
def test_a_backup_is_one_file_that_can_be_read_where_nothing_can_be_written(used: Database, tmp_path: Path) -> None:
    folder = tmp_path / "shelf"
    folder.mkdir()
    backup.write(used, folder / "backup.db", silent)
    assert [item.name for item in folder.iterdir()] == ["backup.db"]
    with closing(sqlite3.connect(f"file:{folder / 'backup.db'}?mode=ro&immutable=1", uri=True)) as plain:
        assert plain.execute("PRAGMA journal_mode").fetchone() == ("delete",)
        assert plain.execute("SELECT count(*) FROM runs").fetchone()[0] > 200


@pytest.fixture(autouse=True)
def _no_copies_left(tmp_path: Path) -> Iterator[None]:
    yield
    assert not list(tmp_path.glob("*.partial*"))


KILLED_SERVER = """
import os, sqlite3, sys
served = sqlite3.connect(sys.argv[1])
served.execute("PRAGMA journal_mode = WAL")
served.execute("PRAGMA wal_autocheckpoint = 0")
served.execute("UPDATE campaigns SET name = 'served'")
served.commit()
os.kill(os.getpid(), 9)
"""


def killed_while_serving(file: Path) -> Path:
    """Leaves a backup with the write-ahead log of a killed process."""
    assert subprocess.run([sys.executable, "-c", KILLED_SERVER, str(file)], check=False).returncode == -signal.SIGKILL
    log = file.with_name(f"{file.name}-wal")
    assert log.stat().st_size
    return log


def names_in(file: Path) -> set[str]:
    """Returns the names of the campaigns in a file that is opened as it is."""
    with closing(sqlite3.connect(file)) as plain:
        assert plain.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        return {name for (name,) in plain.execute("SELECT name FROM campaigns")}


@pytest.mark.slow("postgresql")
def test_a_log_that_is_left_of_a_removed_database_does_not_change_the_restored_one(database: Database, tmp_path: Path) -> None:
    file, target = tmp_path / "backup.db", tmp_path / "restored.db"
    with database.transaction() as connection:
        campaign(connection, "first")
    backup.write(database, file, silent)
    backup.write(database, target, silent)
    killed_while_serving(target)
    target.unlink()
    restored = Database.open(f"sqlite:///{target}")
    backup.restore(file, restored, silent)
    restored.dispose()
    assert names_in(target) == {"first"}
