import os
import re
import sqlite3
import stat
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from multiprocessing.synchronize import Event
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import Connection, Pool, event, text
from tests.support.databases import leave_it_to_the_system
from tests.support.postgres import create_database
from tests.support.storage import PROCESSES, campaign

from drivecal.domain.errors import DatabaseError, UnavailableError
from drivecal.storage import campaigns
from drivecal.storage.engine import server_lock
from drivecal.storage.engine.database import PROMPT, Database
from drivecal.storage.engine.schema import REVISION_TABLE
from drivecal.storage.engine.tables import metadata
from drivecal.storage.maintenance import backup


def test_the_revisions_make_exactly_the_tables(connection: Connection) -> None:
    context = MigrationContext.configure(connection, opts={"version_table": REVISION_TABLE, "compare_type": True})
    assert compare_metadata(context, metadata) == []


def test_a_new_database_is_usable_after_its_upgrade_and_a_second_one_changes_nothing(empty_url: str) -> None:
    database = Database.open(empty_url)
    database.upgrade()
    with database.transaction() as connection:
        stored = campaign(connection)
    database.upgrade()
    database.check()
    with database.read() as connection:
        assert campaigns.get(connection, stored.id) == stored


def test_a_transaction_that_raises_leaves_nothing_behind(database: Database) -> None:
    def write() -> None:
        with database.transaction() as connection:
            campaign(connection)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write()
    with database.read() as connection:
        assert campaigns.page(connection) == ([], None)


def test_a_reader_sees_one_state_however_long_it_reads(database: Database) -> None:
    with database.read() as reader:
        assert campaigns.active(reader) == []
        with database.transaction() as writer:
            campaign(writer)
        assert campaigns.active(reader) == []
    with database.read() as reader:
        assert len(campaigns.active(reader)) == 1


def test_a_reader_cannot_write(database: Database) -> None:
    with pytest.raises(Exception, match=r"read-?only|cannot be opened for writing"), database.read() as connection:
        campaign(connection)
    with database.transaction() as connection:  # the same pooled connection writes again
        campaign(connection)


@pytest.mark.slow
def test_fifty_requests_get_their_turns_beside_a_process_that_writes_without_a_pause(database: Database) -> None:
    url = database.url.render_as_string(hide_password=False)
    begun, ends = PROCESSES.Event(), PROCESSES.Event()
    writer = PROCESSES.Process(target=_write_without_a_pause, args=(url, 0.3, begun, ends))
    writer.start()
    prompt = Database.open(url, replace(PROMPT, lock=300))

    def write(number: int) -> None:
        with prompt.transaction() as connection:
            campaign(connection, f"{number}")

    try:
        assert begun.wait(60)
        with ThreadPoolExecutor(50) as pool:
            list(pool.map(write, range(50)))
    finally:
        ends.set()
        writer.join()
    with database.read() as connection:
        assert len(campaigns.active(connection)) == 50


def test_processes_with_many_writers_keep_none_from_writing(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'drivecal.db'}"
    databases = [Database.open(url) for _ in range(2)]  # they share nothing, as in two processes
    databases[0].upgrade()
    written, end = [0, 0], time.monotonic() + 300

    def write(number: int) -> None:
        while min(written) < 20 and time.monotonic() < end:
            with databases[number].transaction():
                written[number] += 1

    with ThreadPoolExecutor(9) as pool:
        list(pool.map(write, [0] * 8 + [1]))
    assert min(written) >= 20
    for database in databases:
        assert database._turns is not None
        assert database._turns._locked is None, "the queue is left"


def test_a_process_that_stands_still_holds_up_no_other(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    database = Database.open(f"sqlite:///{tmp_path / 'drivecal.db'}", replace(PROMPT, lock=0.2))
    database.upgrade()
    queue = tmp_path / "drivecal.db.queue"
    with queue.open("r+b") as held:
        assert server_lock.try_lock(held)
        for _ in range(2):  # the second does not ask again
            with database.transaction() as connection:
                campaign(connection, "written")
    with database.read() as connection:
        assert len(campaigns.active(connection)) == 2
    assert [str(queue) in record.getMessage() for record in caplog.records] == [True]


def _write_without_a_pause(url: str, seconds: float, begun: Event, ends: Event) -> None:
    """Holds one transaction after the other, each for `seconds`."""
    database = Database.open(url)
    while not ends.is_set():
        with database.transaction():
            begun.set()
            time.sleep(seconds)
    database.dispose()


def test_a_database_that_is_not_migrated_is_refused_with_the_remedy(empty_url: str, tmp_path: Path) -> None:
    with pytest.raises(DatabaseError, match="`drivecal db upgrade`"):
        Database.open(empty_url).check()
    assert not (tmp_path / "drivecal.db").exists(), "looking for it does not make it"


def test_another_programs_database_is_refused_and_left_as_it_was(empty_url: str) -> None:
    database = Database.open(empty_url)
    with database.transaction() as connection:
        connection.execute(text("CREATE TABLE moz_places (id INTEGER)"))
    for use in (database.check, database.upgrade):
        with pytest.raises(DatabaseError, match="moz_places"):
            use()
    with database.read() as connection:
        if connection.dialect.name == "sqlite":
            assert connection.exec_driver_sql("PRAGMA journal_mode").scalar() == "delete"


def test_a_database_of_another_drivecal_is_refused(empty_url: str) -> None:
    database = Database.open(empty_url)
    database.upgrade()
    with database.transaction() as connection:
        connection.execute(text(f"UPDATE {REVISION_TABLE} SET version_num = '9999'"))
    for use in (database.check, database.upgrade):
        with pytest.raises(DatabaseError, match="9999"):
            use()


@pytest.mark.parametrize("content", [b"This is no database." * 100, b"\x00" * 4096])
def test_a_file_that_is_no_database_is_refused_and_left_as_it_was(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "notes.txt"
    file.write_bytes(content)
    for use in (Database.open(f"sqlite:///{file}").check, Database.open(f"sqlite:///{file}").upgrade):
        with pytest.raises(DatabaseError, match=r"notes\.txt"):
            use()
    assert file.read_bytes() == content


def test_a_damaged_database_is_called_damaged(migrated_sqlite: Path, tmp_path: Path) -> None:
    file = tmp_path / "drivecal.db"
    content = bytearray(migrated_sqlite.read_bytes())
    content[100:4096] = b"\xff" * 3996
    file.write_bytes(content)
    with pytest.raises(DatabaseError, match=re.escape(str(file))):
        Database.open(f"sqlite:///{file}").check()


def test_a_new_database_belongs_to_its_user_alone_whatever_the_umask(tmp_path: Path) -> None:
    file = tmp_path / "home" / "drivecal.db"
    database, before = Database.open(f"sqlite:///{file}"), os.umask(0)
    try:
        database.upgrade()
        with database.transaction():
            modes = {path.name: stat.S_IMODE(path.stat().st_mode) for path in (file.parent, *file.parent.iterdir())}
    finally:
        os.umask(before)
    assert modes.pop("home") == 0o700
    assert modes == dict.fromkeys(("drivecal.db", "drivecal.db-wal", "drivecal.db-shm", "drivecal.db.queue"), 0o600)


def test_a_folder_in_place_of_the_file_is_refused(tmp_path: Path) -> None:
    for use in (Database.open(f"sqlite:///{tmp_path}").check, Database.open(f"sqlite:///{tmp_path}").upgrade):
        with pytest.raises(DatabaseError, match=rf"{re.escape(str(tmp_path))}(?!/)"):
            use()


def test_a_folder_that_cannot_be_created_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DatabaseError, match=re.escape(str(tmp_path / "file"))):
        Database.open(f"sqlite:///{tmp_path / 'file' / 'drivecal.db'}").upgrade()


def test_a_folder_without_the_right_to_write_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # For root every folder is writable, and tests run as root in containers: take the right away where it is asked for.
    monkeypatch.setattr("drivecal.storage.engine.schema.os.access", lambda *_: False)
    with pytest.raises(DatabaseError, match=re.escape(str(tmp_path))):
        Database.open(f"sqlite:///{tmp_path / 'drivecal.db'}").upgrade()


def test_an_unreachable_postgresql_is_named_without_the_password() -> None:
    database = Database.open("postgresql://someone:s3cret@127.0.0.1:1/drivecal?password=s3cret")
    for use in (database.check, database.upgrade, lambda: database.read().__enter__()):
        with pytest.raises(UnavailableError, match="check the URL and that the server runs") as caught:
            use()
        assert "s3cret" not in str(caught.value)
        assert "someone:***@127.0.0.1:1/drivecal" in str(caught.value)


def test_a_database_that_another_program_keeps_locked_is_unavailable(migrated_sqlite: Path, tmp_path: Path) -> None:
    file = tmp_path / "drivecal.db"
    file.write_bytes(migrated_sqlite.read_bytes())
    database = Database.open(f"sqlite:///{file}", replace(PROMPT, lock=0.1))
    with closing(sqlite3.connect(file, isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")
        with pytest.raises(UnavailableError), database.transaction():
            pass
        with database.read() as connection:
            assert campaigns.active(connection) == []
    with database.transaction() as connection:
        campaign(connection)


def test_lost_connections_are_replaced(clean_postgres: str, postgres_server: str) -> None:
    database = Database.open(clean_postgres)

    def write() -> None:
        with database.transaction() as connection:
            pid = connection.scalar(text("SELECT pg_backend_pid()"))
            with Database.open(postgres_server).transaction() as other:
                other.execute(text("SELECT pg_terminate_backend(:pid)"), {"pid": pid})
            campaign(connection)

    with pytest.raises(UnavailableError):
        write()
    with database.transaction() as connection:
        campaign(connection)
    with database.read() as connection:
        assert len(campaigns.active(connection)) == 1


def test_sqlite_waits_for_the_disk_at_every_commit(migrated_sqlite: Path) -> None:
    event.remove(Pool, "checkout", leave_it_to_the_system)
    try:
        database = Database.open(f"sqlite:///{migrated_sqlite}")
        with database.read() as connection:
            values = [
                connection.exec_driver_sql(f"PRAGMA {name}").scalar()
                for name in ("journal_mode", "synchronous", "foreign_keys")
            ]
    finally:
        event.listen(Pool, "checkout", leave_it_to_the_system)
    assert values == ["wal", 2, 1]


def test_rows_cannot_point_to_rows_that_are_not_there(database: Database) -> None:
    with pytest.raises(Exception, match=r"(?i)foreign key"), database.transaction() as connection:
        connection.execute(text("INSERT INTO ratings (run_id, evaluator, score, rating) VALUES (1, 'reference 1', 1, 1.0)"))


@pytest.mark.parametrize("encoding", ["LATIN1", "SQL_ASCII"])
def test_a_database_that_lacks_characters_is_refused(postgres_server: str, encoding: str, tmp_path: Path) -> None:
    target = Database.open(create_database(postgres_server, f"in_{encoding.lower()}", encoding))
    with pytest.raises(DatabaseError, match=encoding):
        target.upgrade()
    source = Database.open(f"sqlite:///{tmp_path / 'source.db'}")
    source.upgrade()
    backup.write(source, tmp_path / "backup.db", lambda *_: None)
    with pytest.raises(DatabaseError, match=encoding):
        backup.restore(tmp_path / "backup.db", target, lambda *_: None)
