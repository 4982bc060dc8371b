"""Backups under a name that was used before: nothing of the earlier file gets into the new one, and the earlier one is kept whole."""

from __future__ import annotations

import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from tests.support.storage import campaign

from drivecal.domain.errors import DatabaseError
from drivecal.storage.engine import locks
from drivecal.storage.engine.database import Database
from drivecal.storage.maintenance import backup


def silent(table: str, done: int, total: int) -> None:
    """Reports no progress."""


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
    """Leaves the log of a process that was killed beside a backup."""
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
def test_an_earlier_backup_is_complete_until_the_new_one_has_its_name(
    database: Database, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, seen = tmp_path / "backup.db", []
    with database.transaction() as connection:
        campaign(connection, "first")
    backup.write(database, file, silent)
    killed_while_serving(file)
    replace = Path.replace

    def look_and_replace(path: Path, target: Path) -> Path:
        seen.append(names_in(target))
        return replace(path, target)

    monkeypatch.setattr(Path, "replace", look_and_replace)
    backup.write(database, file, silent, force=True)
    assert seen == [{"served"}]
    assert names_in(file) == {"first"}


@pytest.mark.slow("postgresql")
@pytest.mark.parametrize("suffix", ["-journal", "-wal", "-shm"])
def test_what_is_left_of_a_removed_backup_is_removed_only_by_force(database: Database, tmp_path: Path, suffix: str) -> None:
    file = tmp_path / "backup.db"
    left = tmp_path / f"backup.db{suffix}"
    left.write_bytes(b"left")
    with pytest.raises(DatabaseError, match=rf"backup\.db{suffix}.*--force"):
        backup.write(database, file, silent)
    assert not file.exists()
    assert left.read_bytes() == b"left"
    backup.write(database, file, silent, force=True)
    assert not left.exists()
    names_in(file)


@pytest.mark.slow("postgresql")
def test_a_backup_that_a_server_or_another_process_uses_is_not_replaced(database: Database, tmp_path: Path) -> None:
    file = tmp_path / "backup.db"
    with database.transaction() as connection:
        campaign(connection, "first")
    backup.write(database, file, silent)
    with locks.hold(f"sqlite:///{file}"), pytest.raises(DatabaseError, match="a drivecal server uses"):
        backup.write(database, file, silent, force=True)
    with closing(sqlite3.connect(file)) as user:
        user.execute("PRAGMA journal_mode = WAL")
        user.execute("UPDATE campaigns SET name = 'used'")
        user.commit()
        with pytest.raises(DatabaseError, match="cannot be replaced"):
            backup.write(database, file, silent, force=True)
        assert names_in(file) == {"used"}
    backup.write(database, file, silent, force=True)
    assert names_in(file) == {"first"}
    assert not list(tmp_path.glob("*.partial*"))


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
