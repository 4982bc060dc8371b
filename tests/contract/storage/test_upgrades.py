"""Upgrades to a later revision lose nothing, run in one transaction, and have nothing between the two revisions."""

import os
import runpy
import shutil
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import Column, Connection, Engine, Index, MetaData, Text, event, inspect, text
from tests.support.storage import PROCESSES, campaign, cell, sample_set_ids, setup_id, simulate
from typer.testing import CliRunner

from drivecal.cli.__main__ import app
from drivecal.domain.errors import DatabaseError
from drivecal.storage.engine import schema, server_lock, tables
from drivecal.storage.engine.database import Database
from drivecal.storage.maintenance import backup
from drivecal.storage.maintenance.consistency import check_storage

FIRST, SECOND = (schema.known_revisions.__wrapped__()[0], False, False), ("0002", True, True)
LATER = f"""
import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "{FIRST[0]}"


def upgrade():
    op.create_table("remarks", sa.Column("id", sa.Integer(), primary_key=True))
    op.add_column("campaigns", sa.Column("mood", sa.Text(), nullable=False, server_default="calm"))
    op.execute("UPDATE campaigns SET mood = 'glad' WHERE name = 'campaign'")
    with op.batch_alter_table("processes") as processes:  # SQLite copies the table
        processes.alter_column("pid", nullable=True)
    op.create_index("ix_runs_worker", "runs", ["worker"])
"""
"""A revision after this drivecal's: a table, a column with values, a column of another kind, an index."""
RUNS = 30


@pytest.fixture
def later(tmp_path: Path) -> Path:
    """The folder of the revisions of a later drivecal."""
    folder = tmp_path / "later" / "migrations"
    shutil.copytree(schema.MIGRATIONS, folder)
    (folder / "versions" / "later_0002.py").write_text(LATER)
    return folder


@pytest.fixture
def old(empty_url: str, later: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Database]:
    """A database with rows at the first revision, for a drivecal with a second one."""
    opened = Database.open(empty_url)
    opened.upgrade()
    with opened.transaction() as connection:
        setup, sets = setup_id(connection), sample_set_ids(connection, RUNS)
        cells = [cell(number, setup, parameter_set) for number, parameter_set in enumerate(sets)]
        simulate(connection, campaign(connection).sequence, cells)
    monkeypatch.setattr(schema, "MIGRATIONS", later)
    schema.known_revisions.cache_clear()
    yield opened
    schema.known_revisions.cache_clear()


def stored(connection: Connection) -> dict[str, list[Any]]:
    """Returns all rows by table, without the revision and what only the later revision has."""
    tables = [name for name in inspect(connection).get_table_names() if name not in {schema.REVISION_TABLE, "remarks"}]
    rows = {name: connection.execute(text(f"SELECT * FROM {name}")).mappings() for name in tables}
    return {name: [{key: row[key] for key in row if key != "mood"} for row in listed] for name, listed in rows.items()}


def revision_of(database: Database) -> tuple[str | None, bool, bool]:
    """Returns the revision that a database says, and whether the later table and column are there."""
    with database.read() as connection:
        columns = {column["name"] for column in inspect(connection).get_columns("campaigns")}
        return schema.revision_of(connection), inspect(connection).has_table("remarks"), "mood" in columns


def assert_upgraded(database: Database, before: dict[str, list[Any]]) -> None:
    """Fails unless all rows are there at the second revision, and sound."""
    database.check()
    assert revision_of(database) == SECOND
    with database.read() as connection:
        assert stored(connection) == before
        assert connection.scalars(text("SELECT mood FROM campaigns")).all() == ["glad"]
        assert list(check_storage(connection)) == []


def rows_of(database: Database) -> dict[str, list[Any]]:
    """Returns all rows by table."""
    with database.read() as connection:
        rows = stored(connection)
    assert len(rows["runs"]) == RUNS
    return rows


def test_an_upgrade_keeps_all_rows(old: Database) -> None:
    before = rows_of(old)
    with pytest.raises(DatabaseError, match=FIRST[0]):
        old.check()
    old.upgrade()
    assert_upgraded(old, before)


def test_changed_tables_are_another_revision(monkeypatch: pytest.MonkeyPatch) -> None:
    changed = MetaData()
    for table in tables.metadata.sorted_tables:
        table.to_metadata(changed)
    monkeypatch.setattr(tables, "metadata", changed)
    runs, file = changed.tables["runs"], str(schema.MIGRATIONS / "versions" / "initial_0001.py")
    assert runpy.run_path(file)["revision"] == FIRST[0]
    runs.append_column(Column("mood", Text))
    assert (second := runpy.run_path(file)["revision"]) != FIRST[0]
    Index("ix_mood", runs.c.mood)
    assert runpy.run_path(file)["revision"] not in {FIRST[0], second}


@pytest.mark.slow
@pytest.mark.parametrize("statement", [1, 4, None])
def test_a_killed_upgrade_leaves_the_old_revision(old: Database, later: Path, statement: int | None) -> None:
    before = rows_of(old)
    process = PROCESSES.Process(target=_upgrade_and_die, args=(old.url.render_as_string(hide_password=False), later, statement))
    process.start()
    process.join()
    assert process.exitcode == -signal.SIGKILL
    assert revision_of(old) == FIRST
    assert rows_of(old) == before
    old.upgrade()
    assert_upgraded(old, before)


def _upgrade_and_die(url: str, revisions: Path, at: int | None) -> None:
    """Ends the process after a number of changing statements of the upgrade; None: when it is about to commit."""
    schema.MIGRATIONS = revisions
    changes = 0

    def count(_: Any, __: Any, statement: str, *___: Any) -> None:
        nonlocal changes
        changes += statement.lstrip().startswith(("CREATE", "ALTER", "INSERT", "UPDATE", "DROP"))
        if changes == at:
            os.kill(os.getpid(), signal.SIGKILL)

    def commit(_: Any) -> None:
        if changes:
            os.kill(os.getpid(), signal.SIGKILL)

    event.listen(Engine, "after_cursor_execute", count)
    event.listen(Engine, "commit", commit)
    Database.open(url).upgrade()


def test_two_processes_may_upgrade_an_old_database_at_once(old: Database, later: Path) -> None:
    before, url = rows_of(old), old.url.render_as_string(hide_password=False)
    with PROCESSES.Pool(2) as pool:
        pool.starmap(_upgrade, [(url, later)] * 2)
    assert_upgraded(old, before)


def _upgrade(url: str, revisions: Path) -> None:
    schema.MIGRATIONS = revisions
    Database.open(url).upgrade()


def test_an_upgrade_is_refused_while_a_server_holds_the_database(old: Database) -> None:
    url = old.url.render_as_string(hide_password=False)
    arguments = ["db", "upgrade", "--database-url", url]
    with server_lock.hold(url):
        assert CliRunner().invoke(app, arguments).exit_code == 1
        assert revision_of(old) == FIRST
    assert CliRunner().invoke(app, arguments).exit_code == 0
    assert revision_of(old) == SECOND


def test_a_reader_sees_the_old_revision_or_the_new_one(old: Database) -> None:
    ended, moments = threading.Event(), [revision_of(old)]

    def upgrade() -> None:
        try:
            old.upgrade()
        finally:
            ended.set()

    writer = threading.Thread(target=upgrade)
    writer.start()
    while not ended.is_set():
        moments.append(revision_of(old))
    writer.join()
    moments.append(revision_of(old))
    assert (moments[0], moments[-1]) == (FIRST, SECOND)
    assert set(moments) == {FIRST, SECOND}


@pytest.mark.slow("postgresql")
def test_a_backup_of_an_old_revision_is_restored_and_upgraded(old: Database, tmp_path: Path) -> None:
    before, file = rows_of(old), tmp_path / "backup.db"
    assert backup.write(old, file, lambda *_: None).revision == FIRST[0]
    target = Database.open(f"sqlite:///{tmp_path / 'restored.db'}")
    assert backup.restore(file, target, lambda *_: None).revision == FIRST[0]
    assert revision_of(target) == SECOND
    with target.read() as connection:
        assert len(stored(connection)["runs"]) == len(before["runs"])
