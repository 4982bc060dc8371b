"""Threads of a process that write to one SQLite file."""

import sqlite3
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import pytest

from drivecal.domain.errors import UnavailableError
from drivecal.storage.engine.database import PATIENT, Database, Patience

IMPATIENT = Patience(lock=0.1, connect=1, statement=None)


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


OTHER = """
import sys, time
from sqlalchemy import text
from drivecal.storage.engine.database import Database
database, seen = Database.open(sys.argv[1]), []
for _ in range(11):
    with database.transaction() as connection:
        seen.append(connection.scalar(text("SELECT count(*) FROM numbers")))
    time.sleep(0.03)
print(seen[-1] - seen[0])
"""


def test_threads_that_write_all_the_time_let_another_process_write(tmp_path: Path) -> None:
    database, stop = opened(tmp_path / "file.db"), threading.Event()

    def write() -> None:
        while not stop.is_set():
            with database.transaction() as connection:
                connection.exec_driver_sql("INSERT INTO numbers VALUES (1)")
                stop.wait(0.01)

    with ThreadPoolExecutor(8) as threads:
        for _ in range(8):
            threads.submit(write)
        command = [sys.executable, "-c", OTHER, f"sqlite:///{tmp_path / 'file.db'}"]
        between = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False).stdout
        stop.set()
    assert int(between) < 150  # ten turns: some 500 if a process kept its turn for half a second
