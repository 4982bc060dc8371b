"""Threads of a process that write to one SQLite file."""

from __future__ import annotations

import sqlite3
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import pytest
from sqlalchemy import text

from drivecal.domain.errors import UnavailableError
from drivecal.storage.engine.database import PATIENT, Database, Patience

IMPATIENT = Patience(lock=0.1, connect=1, statement=None, watched=False)


def opened(file: Path, patience: Patience = PATIENT) -> Database:
    """A database with one number."""
    with closing(sqlite3.connect(file)) as connection:
        connection.executescript("PRAGMA journal_mode = WAL; CREATE TABLE IF NOT EXISTS numbers (n INTEGER)")
    return Database.open(f"sqlite:///{file}", patience)


def test_threads_that_write_at_once_all_get_their_turn(tmp_path: Path) -> None:
    database = opened(tmp_path / "file.db")

    def write(number: int) -> None:
        for _ in range(5):
            with database.transaction() as connection:
                connection.execute(text("INSERT INTO numbers VALUES (:n)"), {"n": number})

    with ThreadPoolExecutor(30) as threads:
        list(threads.map(write, range(30)))
    with database.read() as connection:
        assert connection.scalar(text("SELECT count(*) FROM numbers")) == 150
    database.dispose()


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


def test_a_lock_of_another_process_is_named_as_such(tmp_path: Path) -> None:
    database = opened(tmp_path / "file.db", IMPATIENT)
    with closing(sqlite3.connect(tmp_path / "file.db", isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(UnavailableError, match="another process"), database.transaction():
            pass
    with database.transaction():
        pass
    database.dispose()
