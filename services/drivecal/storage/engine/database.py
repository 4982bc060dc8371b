"""The database: one pool of connections per process, and transactions that behave alike on SQLite and PostgreSQL."""

from __future__ import annotations

import logging
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import IO, Any, Concatenate, ParamSpec, TypeVar

from sqlalchemy import URL, Connection, Engine, create_engine, event

from drivecal.domain.errors import DatabaseError, UnavailableError
from drivecal.storage.engine import schema, server_lock, urls
from drivecal.storage.engine.failures import ServerLiveness, mind_absence, translated
from drivecal.storage.engine.types import to_json

OLDEST_SQLITE = (3, 35, 0)
"""The first release with RETURNING."""

Given = ParamSpec("Given")
Answered = TypeVar("Answered")


@dataclass(frozen=True, slots=True)
class Patience:
    """Waits for the database before UnavailableError, s, and the memory of a connection. All but `lock` and `cache` concern PostgreSQL."""

    lock: float
    """Limit for a lock of another transaction, and for a connection of the pool."""
    connect: int
    """Limit for a new connection."""
    statement: int | None
    """Limit for one statement; None: no limit. With one, a server that does not answer is noticed within seconds (`failures`)."""
    cache: int = 64
    """Largest memory for pages of an SQLite file, MB."""


PATIENT = Patience(lock=30, connect=5, statement=None)
"""Limits for background work: it waits for an outage to end, and a statement may take long."""
LASTING = replace(PATIENT, cache=16)
"""The same for a process that lives for months. More pages would help it little: SQLite drops them all when another process writes."""
PROMPT = Patience(lock=4, connect=2, statement=30, cache=16)
"""Limits for requests, for which a client waits. They read little, and by many connections."""
QUEUE_SECONDS = 0.003
"""Pause between two looks whether another process has begun to write."""
QUEUE_KEPT_SECONDS = 0.02, 0.5
"""Time for waiting threads of a process to write one after the other, before another process does: as long as the process waited itself,
between these. A process that answers many requests would otherwise keep the dispatcher from writing."""
QUEUE_LEFT_SECONDS = 10.0
"""Time for which a process writes without the queue after it waited in vain."""

log = logging.getLogger(__name__)


class Turns:
    """Turns of drivecal's threads and processes that write to a SQLite file.

    SQLite itself lets writers try again after growing pauses. Among many writers, or during another process's constant writes, a writer
    may try in vain until its time is up.
    """

    def __init__(self, file: Path, seconds: float) -> None:
        self._queue = file.with_name(f"{file.name}.queue")
        """A process locks this file while it begins to write and while more of its threads wait: other processes begin after it."""
        self._seconds = seconds
        self._lock = threading.Lock()
        self._counting = threading.Lock()
        self._waiting = 0
        self._locked: tuple[IO[bytes], float] | None = None
        """The locked file, and the time until which this process may keep it (`time.monotonic`)."""
        self._queue_again = 0.0
        """The time of the next attempt to lock the file after a failure (`time.monotonic`)."""

    @contextmanager
    def take(self) -> Iterator[float]:
        """Yields the time of `time.monotonic` until which to wait for other processes. Raises UnavailableError if threads take too long."""
        deadline = time.monotonic() + self._seconds
        self._count(1)
        try:
            taken = self._lock.acquire(timeout=self._seconds)
        finally:
            self._count(-1)
        try:
            if not taken:
                raise UnavailableError("the database is busy with other changes; try again")
            yield deadline
        finally:
            if taken:
                self._lock.release()
            self._leave_queue()

    @contextmanager
    def begin(self, deadline: float) -> Iterator[float]:
        """Yields how many seconds are left for SQLite's lock. Until the block ends, no other process of drivecal begins to write.

        The caller has taken its turn.
        """
        if self._locked is not None and time.monotonic() > self._locked[1]:
            self._unlock()
            time.sleep(2 * QUEUE_SECONDS)  # others look meanwhile
        begun = time.monotonic()
        entered = self._locked is None and begun >= self._queue_again
        if entered:
            self._enter_queue(deadline)
        kept = sorted((time.monotonic() - begun, *QUEUE_KEPT_SECONDS))[1]
        try:
            yield max(deadline - time.monotonic(), 0.0)
        finally:
            if entered and self._locked is not None:  # the time of the writer before does not count
                self._locked = self._locked[0], time.monotonic() + kept
            if not self._waiting:
                self._unlock()

    def _enter_queue(self, deadline: float) -> None:
        """Locks the file. If that fails, or takes half of a writer's time, SQLite's own lock has to do for a while: a process that is
        stopped while it has the file locked holds up others no longer."""
        begun = time.monotonic()
        try:
            self._queue.touch(mode=0o600)
            file = self._queue.open("r+b")
        except OSError as error:
            if self._queue.exists():  # else nothing can be written here, and SQLite says so
                self._do_without(f"cannot be locked: {error.strerror}")
            return
        longest = begun + self._seconds / 2
        while not (is_locked := server_lock.try_lock(file)) and time.monotonic() < min(deadline, longest):
            time.sleep(QUEUE_SECONDS)
        if is_locked:
            self._locked = file, time.monotonic()
            return
        file.close()
        if time.monotonic() >= longest:
            self._do_without("is locked by another process that does not begin to write")

    def _do_without(self, cause: str) -> None:
        log.warning("%s %s; processes that write at a time may have to try again", self._queue, cause)
        self._queue_again = time.monotonic() + QUEUE_LEFT_SECONDS

    def _leave_queue(self) -> None:
        """Unlocks the file unless a thread has its turn or waits for it: these do so themselves."""
        if self._locked is not None and not self._waiting and self._lock.acquire(blocking=False):
            self._unlock()
            self._lock.release()

    def _unlock(self) -> None:
        if self._locked is not None:
            file, self._locked = self._locked[0], None
            file.close()

    def _count(self, change: int) -> None:
        with self._counting:
            self._waiting += change


class Database:
    """An open database. Threads share it; processes each open their own. Functions of the other modules take its connections."""

    def __init__(
        self, url: URL, engine: Engine, fence: Callable[[Connection], None] | None = None, turns: Turns | None = None
    ) -> None:
        self.url = url
        self._turns = turns
        self.name = urls.shown(url)
        """The URL in messages, without the password."""
        self._engine = engine
        self._fence = fence

    @classmethod
    def open(cls, url: str, patience: Patience = PATIENT) -> Database:
        """Prepares the pool; nothing is connected yet. Raises DatabaseError if the URL names no usable database."""
        parsed = urls.parse(url)
        if parsed.get_backend_name() == "sqlite" and sqlite3.sqlite_version_info < OLDEST_SQLITE:
            needed = ".".join(map(str, OLDEST_SQLITE))
            raise DatabaseError(f"SQLite {sqlite3.sqlite_version} is too old; drivecal needs {needed} or PostgreSQL")
        file = urls.sqlite_file(parsed)
        turns = None if file is None else Turns(file, patience.lock)
        return cls(parsed, make_engine(parsed, patience), turns=turns)

    def fenced(self, fence: Callable[[Connection], None]) -> Database:
        """Returns the same database for a process that may lose the right to write.

        Every transaction begins with `fence`, which raises once the right is lost.
        """
        return Database(self.url, self._engine, fence, self._turns)

    @contextmanager
    def read(self) -> Iterator[Connection]:
        """Yields a connection that sees one consistent state and cannot write."""
        with translated(self.name), self._engine.connect() as connection:
            if connection.dialect.name == "postgresql":
                connection = connection.execution_options(isolation_level="REPEATABLE READ", postgresql_readonly=True)
            with connection.begin():
                yield connection

    def query(
        self, query: Callable[Concatenate[Connection, Given], Answered], *given: Given.args, **named: Given.kwargs
    ) -> Answered:
        """Returns what a function returns that takes a connection, as `read` yields it, and these arguments."""
        with self.read() as connection:
            return query(connection, *given, **named)

    @contextmanager
    def transaction(self) -> Iterator[Connection]:
        """Yields a connection whose writes are committed together at the end, or not at all if the body raises.

        On SQLite it has the write lock from its start, which threads and processes get one after the other. After UnavailableError
        the writes may have been committed all the same (the answer to the commit may be what got lost): read again before writing
        once more.
        """
        turn = nullcontext(0.0) if self._turns is None else self._turns.take()
        with translated(self.name), turn as deadline, self._engine.connect() as connection:
            with nullcontext(0.0) if self._turns is None else self._turns.begin(deadline) as left:
                begun = connection.execution_options(drivecal_writes=True, drivecal_seconds=left).begin()
            with begun:
                if self._fence is not None:
                    self._fence(connection)
                yield connection

    def upgrade(self) -> None:
        """Creates the database or brings it to this drivecal's revision. Safe when several processes do it at once.

        Raises DatabaseError and UnavailableError as `check`, except for a missing or older schema.
        """
        with translated(self.name):
            schema.prepare_file(self.url)
            with self._engine.connect() as connection:
                schema.refuse_encoding(connection, self.name)
                schema.refuse_foreign(connection, self.name)
            schema.use_write_ahead_log(self.url)
            with self.transaction() as connection:
                schema.upgrade(connection, self.name)

    def check(self) -> None:
        """Raises DatabaseError with a remedy if drivecal cannot work with this database, and UnavailableError if it does not answer."""
        with translated(self.name):
            schema.refuse_missing(self.url)
            with self._engine.connect() as connection:
                schema.refuse_encoding(connection, self.name)
                schema.refuse_foreign(connection, self.name)
                schema.refuse_unmigrated(connection, self.name)

    def dispose(self) -> None:
        """Closes the pool's connections."""
        self._engine.dispose()


def make_engine(url: URL, patience: Patience = PATIENT) -> Engine:
    """Returns an engine with drivecal's settings for SQLite or PostgreSQL."""
    if url.get_backend_name() == "sqlite":
        # isolation_level None: the driver leaves transactions to us.
        arguments: dict[str, Any] = {"timeout": patience.lock, "isolation_level": None}
    else:
        arguments = {
            "connect_timeout": patience.connect,
            "application_name": "drivecal",
            "client_encoding": "utf8",
            **_KEEP_ALIVE,
        }
    engine = create_engine(
        url,
        connect_args=arguments,
        json_serializer=to_json,
        hide_parameters=True,  # messages and logs name statements, not thousands of values
        pool_size=5,
        max_overflow=35,  # as many as the API has threads; idle ones above pool_size are closed
        pool_timeout=patience.lock,
        pool_pre_ping=url.get_backend_name() == "postgresql",
    )
    if url.get_backend_name() == "sqlite":
        event.listen(engine, "connect", partial(_prepare_sqlite, patience))
        event.listen(engine, "begin", partial(_begin_sqlite, patience.lock))
        return engine
    if patience.statement is not None:
        watch = ServerLiveness(urls.shown(url))
        event.listen(engine, "do_connect", lambda _dialect, _record, given, options: watch.connect(*given, **options))
    event.listen(engine, "connect", partial(_prepare_postgresql, patience))
    return engine


_KEEP_ALIVE = {"keepalives_idle": 5, "keepalives_interval": 5, "keepalives_count": 3, "tcp_user_timeout": 20_000}
"""Settings with which a connection to a machine that is gone ends within some 20 s instead of hours."""


def _prepare_sqlite(patience: Patience, connection: Any, _record: Any) -> None:
    for pragma in ("synchronous = FULL", "foreign_keys = ON", f"cache_size = -{1024 * patience.cache}", "temp_store = MEMORY"):
        connection.execute(f"PRAGMA {pragma}")


def _begin_sqlite(seconds: float, connection: Connection) -> None:
    """Begins a transaction; writers take the lock at once: two readers that both write later would end in a deadlock.

    `seconds`: longest wait for a lock, unless the connection has another.
    """
    options = connection.get_execution_options()
    driver: Any = connection.connection.driver_connection  # SQLAlchemy takes ten times as long for such a statement
    writes = options.get("drivecal_writes", False)
    driver.execute(f"PRAGMA busy_timeout = {round(1000 * options.get('drivecal_seconds', seconds))}")
    driver.execute(f"PRAGMA query_only = {'OFF' if writes else 'ON'}")
    driver.execute("BEGIN IMMEDIATE" if writes else "BEGIN")


def _prepare_postgresql(patience: Patience, connection: Any, _record: Any) -> None:
    # Look-ups touch some thousand rows of large tables. jit compiles longer than they run, and the default cost of a random page,
    # that of a turning disk, makes the planner prefer a scan of the whole table.
    connection.execute("SET jit = off")
    connection.execute("SET random_page_cost = 1.1")
    mind_absence(connection)
    if patience.statement is not None:
        connection.execute(f"SET statement_timeout = '{patience.statement}s'")
        connection.execute(f"SET lock_timeout = '{patience.lock:.0f}s'")
    connection.commit()
    from psycopg.types.array import ListBinaryDumper  # a third of a second that SQLite does without

    # Thousands of keys as the text of an array take longer to write than to find.
    connection.adapters.register_dumper(list, ListBinaryDumper)
