"""Threads of a process that write to one SQLite file."""

import sqlite3
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import pytest

from drivecal.domain.errors import UnavailableError
from drivecal.storage.engine.database import PATIENT, Database, Patience

IMPATIENT = Patience(lock=0.1, connect=1, statement=None, watched=False)


def opened(file: Path, patience: Patience = PATIENT) -> Database:
    """A database with one number."""
    with closing(sqlite3.connect(file)) as connection:
        connection.executescript("PRAGMA journal_mode = WAL; CREATE TABLE IF NOT EXISTS numbers (n INTEGER)")
    return Database.open(f"sqlite:///{file}", patience)


def test_a_thread_that_waits_too_long_for_its_turn_is_refused_and_may_try_again(tmp_path: Path) -> None:
    database, holds, enough = opened(tmp_path / "file.db", IMPATIENT), threading.Event(), threading.Event()

    def hold() -> None:
        with database.transaction():
            holds.set()
            enough.wait(60)

    with ThreadPoolExecutor(1) as thread:
        thread.submit(hold)
        holds.wait(60)
        with pytest.raises(UnavailableError, match="busy"), database.transaction():
            pass
        enough.set()
    with database.transaction():
        pass
    database.dispose()
