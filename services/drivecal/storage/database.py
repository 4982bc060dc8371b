"""The database: one pool of connections per process, and transactions that behave alike on SQLite and PostgreSQL."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from sqlalchemy import URL, Connection, Engine, create_engine, event

from drivecal.domain.errors import DatabaseError, UnavailableError
from drivecal.storage import schema, urls
from drivecal.storage.failures import translated
from drivecal.storage.types import to_json

BUSY_SECONDS = 30
"""How long a writer waits for another one on SQLite before UnavailableError."""
CONNECT_SECONDS = 5
"""How long PostgreSQL may take to answer a new connection."""
OLDEST_SQLITE = (3, 35, 0)
"""The first release with RETURNING."""


class Database:
    """An open database. Threads share it; processes each open their own. Functions of the other modules take its connections."""

    def __init__(self, url: URL, engine: Engine) -> None:
        self.url = url
        self.name = urls.shown(url)
        """For messages: without the password."""
        self._engine = engine

    @classmethod
    def open(cls, url: str) -> Database:
        """Prepares the pool; nothing is connected yet. Raises DatabaseError where the URL names no usable database."""
        parsed = urls.parse(url)
        if parsed.get_backend_name() == "sqlite" and sqlite3.sqlite_version_info < OLDEST_SQLITE:
            needed = ".".join(map(str, OLDEST_SQLITE))
            raise DatabaseError(f"SQLite {sqlite3.sqlite_version} is too old; drivecal needs {needed} or PostgreSQL")
        return cls(parsed, make_engine(parsed))

    @contextmanager
    def read(self) -> Iterator[Connection]:
        """A connection that sees one consistent state and cannot write."""
        with translated(self.name), self._engine.connect() as connection:
            if connection.dialect.name == "postgresql":
                connection = connection.execution_options(isolation_level="REPEATABLE READ", postgresql_readonly=True)
            with connection.begin():
                yield connection

    @contextmanager
    def transaction(self) -> Iterator[Connection]:
        """A connection whose writes are committed together at the end, or not at all where the body raises.

        On SQLite it has the write lock from its start. After UnavailableError the writes may have been committed all the same (the
        answer to the commit may be what got lost): read again before writing once more.
        """
        with translated(self.name), self._engine.connect() as connection:
            connection = connection.execution_options(drivecal_writes=True)
            with connection.begin():
                yield connection

    def upgrade(self) -> None:
        """Creates the database or brings it to this drivecal's revision. Safe when several processes do it at once.

        Raises DatabaseError as `check`, but for what is only missing or older.
        """
        with self._plain_errors():
            schema.prepare_file(self.url)
            with self._engine.connect() as connection:
                schema.refuse_foreign(connection, self.name)
            schema.use_write_ahead_log(self.url)
            with self.transaction() as connection:
                schema.upgrade(connection, self.name)

    def check(self) -> None:
        """Raises DatabaseError saying what is wrong and what to do where drivecal cannot work with this database as it is."""
        with self._plain_errors():
            schema.refuse_missing(self.url)
            with self._engine.connect() as connection:
                schema.refuse_foreign(connection, self.name)
                schema.refuse_unmigrated(connection, self.name)

    def dispose(self) -> None:
        """Closes the pool's connections."""
        self._engine.dispose()

    @contextmanager
    def _plain_errors(self) -> Iterator[None]:
        try:
            with translated(self.name):
                yield
        except UnavailableError as error:
            raise DatabaseError(f"{error}; check the URL and that the server runs") from error


def make_engine(url: URL) -> Engine:
    """An engine with drivecal's settings for SQLite or PostgreSQL."""
    if url.get_backend_name() == "sqlite":
        # isolation_level None: the driver leaves transactions to us.
        arguments: dict[str, Any] = {"timeout": BUSY_SECONDS, "isolation_level": None}
    else:
        arguments = {"connect_timeout": CONNECT_SECONDS, "application_name": "drivecal"}
    engine = create_engine(
        url,
        connect_args=arguments,
        json_serializer=to_json,
        hide_parameters=True,  # messages and logs name statements, not thousands of values
        pool_size=5,
        max_overflow=35,  # as many as the API has threads; idle ones above pool_size are closed
        pool_timeout=BUSY_SECONDS,
        pool_pre_ping=url.get_backend_name() == "postgresql",
    )
    if url.get_backend_name() == "sqlite":
        event.listen(engine, "connect", _prepare_sqlite)
        event.listen(engine, "begin", _begin_sqlite)
    else:
        event.listen(engine, "connect", _prepare_postgresql)
    return engine


def _prepare_sqlite(connection: Any, _record: Any) -> None:
    for pragma in ("synchronous = FULL", "foreign_keys = ON", "cache_size = -65536", "temp_store = MEMORY"):
        connection.execute(f"PRAGMA {pragma}")


def _begin_sqlite(connection: Connection) -> None:
    """Writers take the lock at once: two readers that both want to write later would end in a deadlock that no waiting resolves."""
    writes = connection.get_execution_options().get("drivecal_writes", False)
    connection.exec_driver_sql(f"PRAGMA query_only = {'OFF' if writes else 'ON'}")
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")


def _prepare_postgresql(connection: Any, _record: Any) -> None:
    # Look-ups touch some thousand rows of large tables. jit compiles longer than they run, and the default cost of a random page,
    # that of a turning disk, makes the planner prefer a scan of the whole table.
    connection.execute("SET jit = off")
    connection.execute("SET random_page_cost = 1.1")
    connection.commit()
