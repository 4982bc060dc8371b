"""The revision of a database: created and upgraded by Alembic, checked before anything else touches it."""

import os
import sqlite3
from contextlib import closing
from functools import cache
from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.script import ScriptDirectory
from sqlalchemy import URL, Connection, inspect, text

from drivecal.domain.errors import DatabaseError
from drivecal.storage.engine.urls import sqlite_file

REVISION_TABLE = "drivecal_revision"
"""Holds the revision. Its name tells drivecal's databases from databases of other programs that use Alembic."""
MIGRATIONS = Path(__file__).parents[1] / "migrations"
"""Folder of the revisions."""
UPGRADE_LOCK = 0x64726976
"""Key of the advisory lock that lets one process upgrade at a time on PostgreSQL."""


def refuse_missing(url: URL) -> None:
    """Raises DatabaseError if the file is not there."""
    file = sqlite_file(url)
    if file is None:
        return
    if file.is_dir():
        raise DatabaseError(f"{file} is a folder; name a file in it")
    if not file.exists():
        raise DatabaseError(f"there is no database {file}; `drivecal db upgrade` creates it")


def prepare_file(url: URL) -> None:
    """Creates a new SQLite database and its folder, for this user alone. Raises DatabaseError if that or writing there is not possible."""
    file = sqlite_file(url)
    if file is None:
        return
    try:
        file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        if not file.exists():
            file.touch(mode=0o600)  # SQLite gives its companion files the same mode
    except OSError as error:
        remedy = "name another file, or give the user that runs drivecal the right to write there"
        raise DatabaseError(f"{error.filename} cannot be created: {error.strerror}; {remedy}") from error
    refuse_missing(url)
    for path in (file, file.parent):
        if not os.access(path, os.W_OK):
            raise DatabaseError(f"{path} is not writable; give the user that runs drivecal the right to write there")


def refuse_foreign(connection: Connection, database: str) -> None:
    """Raises DatabaseError if the database holds another program's tables or was made by a drivecal with other tables."""
    tables = inspect(connection).get_table_names()
    if tables and REVISION_TABLE not in tables:
        listed = ", ".join(sorted(tables)[:3])
        raise DatabaseError(f"{database} holds another program's tables ({listed}); give drivecal a database of its own")
    revision = revision_of(connection)
    if revision is not None and revision not in known_revisions():
        message = f"{database} was made by another drivecal: its tables are of revision {revision}, which is not {known_revisions()[0]}"
        raise DatabaseError(f"{message}; install the drivecal that made it, or name another database")


def refuse_encoding(connection: Connection, database: str) -> None:
    """Raises DatabaseError if a PostgreSQL database cannot hold all characters."""
    encoding = "UTF8" if connection.dialect.name != "postgresql" else connection.scalar(text("SHOW server_encoding"))
    if encoding != "UTF8":
        message = f"{database} has the encoding {encoding}, not UTF8"
        raise DatabaseError(
            f"{message}; create one with ENCODING 'UTF8', and copy what is stored by `drivecal db backup` and `db restore`"
        )


def refuse_unmigrated(connection: Connection, database: str) -> None:
    """Raises DatabaseError if the database is not at this drivecal's revision."""
    revision, head = revision_of(connection), known_revisions()[0]
    if revision != head:
        state = "is empty" if revision is None else f"is at revision {revision}, this drivecal needs {head}"
        raise DatabaseError(f"{database} {state}; run `drivecal db upgrade`")


def use_write_ahead_log(url: URL) -> None:
    """Switches to write-ahead logging: readers do not wait for the writer. The mode stays in the file."""
    file = sqlite_file(url)
    if file is not None:
        with closing(sqlite3.connect(file, timeout=30)) as connection:
            connection.execute("PRAGMA journal_mode = WAL")


def upgrade(connection: Connection, database: str, to: str = "head") -> None:
    """Runs the missing revisions up to `to` inside the connection's transaction: all of them or none."""
    if connection.dialect.name == "postgresql":
        connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": UPGRADE_LOCK})
    refuse_foreign(connection, database)  # once more, under the lock
    config = Config(attributes={"connection": connection})
    config.set_main_option("script_location", str(MIGRATIONS).replace("%", "%%"))
    command.upgrade(config, to)


def revision_of(connection: Connection) -> str | None:
    """The database's revision; None if it has none of drivecal's tables."""
    if REVISION_TABLE not in inspect(connection).get_table_names():
        return None
    return connection.execute(text(f"SELECT version_num FROM {REVISION_TABLE}")).scalar()  # noqa: S608  # a constant


@cache
def known_revisions() -> tuple[str, ...]:
    """All revisions that this drivecal knows, newest first. Read once: readiness asks for them every few seconds."""
    return tuple(script.revision for script in ScriptDirectory(str(MIGRATIONS)).walk_revisions())
