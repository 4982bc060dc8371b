"""New databases: the first in a process runs every revision, the others are copies."""

import sqlite3
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

from drivecal.storage.engine.database import Database
from drivecal.storage.engine.urls import parse, sqlite_file


def migrated(url: str) -> Database:
    """The database at a URL, at this drivecal's revision. A new SQLite file is a copy; anything else is upgraded."""
    file = sqlite_file(parse(url))
    database = Database.open(url)
    if file is None or file.exists():
        database.upgrade()
    else:
        file.write_bytes(_new_file())
    return database


@cache
def _new_file() -> bytes:
    """The bytes of an SQLite database without rows."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "drivecal.db"
        database = Database.open(f"sqlite:///{file}")
        database.upgrade()
        database.dispose()
        return file.read_bytes()


def leave_it_to_the_system(connection: Any, *_: Any) -> None:
    """Has SQLite wait for no disk: what is in the tests' databases need not survive the machine. Listens to the checkout of connections."""
    if isinstance(connection, sqlite3.Connection):
        connection.execute("PRAGMA synchronous = OFF")
