"""Turns errors of the database drivers into drivecal's own."""

from __future__ import annotations

import logging
import sqlite3
import threading
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import psycopg
from psycopg.conninfo import make_conninfo
from sqlalchemy.exc import DBAPIError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError

from drivecal.domain.errors import DatabaseError, DrivecalError, UnavailableError

_NO_DATABASE = {sqlite3.SQLITE_NOTADB: "is not an SQLite database", sqlite3.SQLITE_CORRUPT: "is a damaged SQLite database"}
_FOR_NOW = {sqlite3.SQLITE_IOERR, sqlite3.SQLITE_FULL, sqlite3.SQLITE_PROTOCOL}
_NOT_USABLE = {sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_PERM}
"""Errors that may pass, too: files cannot be opened while all descriptors are in use, nor written while the disk is mounted read-only."""
_NOT_NOW = (
    psycopg.errors.ReadOnlySqlTransaction,  # a server that takes over, or gives up, is read-only for a while
    psycopg.errors.IdleInTransactionSessionTimeout,
    psycopg.errors.TransactionTimeout,
    psycopg.errors.DeadlockDetected,
    psycopg.errors.DiskFull,
)
"""Errors of a PostgreSQL that answers, after which to try again."""


@contextmanager
def translated(database: str) -> Iterator[None]:
    """Maps the driver's errors about the state of `database`, its name in messages, to DatabaseError or UnavailableError. Errors in
    statements are programming errors and pass unchanged."""
    try:
        yield
    except PoolTimeoutError as error:
        raise UnavailableError(f"all connections to {database} are in use; try again later") from error
    except (DBAPIError, sqlite3.Error, psycopg.Error) as error:  # the latter where a driver was used directly
        known = _translate(error.orig if isinstance(error, DBAPIError) else error, database)
        if known is None:
            raise
        raise known from error


def _translate(error: BaseException | None, database: str) -> DrivecalError | None:
    if isinstance(error, sqlite3.Error):
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF  # the low byte is the class, the rest the detail
        if code in _NO_DATABASE:
            return DatabaseError(f"{database} {_NO_DATABASE[code]}; name another file or restore a backup")
        if code in _NOT_USABLE:
            return UnavailableError(f"{database} cannot be opened for writing; check that the file and its folder are writable")
        if code in {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED}:
            return UnavailableError(
                f"the database {database} is locked: drivecal stores a large iteration, or another process has it open; try again"
            )
        if code in _FOR_NOW:
            return UnavailableError(f"the database {database} cannot be used at the moment: {error}")
    if isinstance(error, psycopg.errors.LockNotAvailable):
        return UnavailableError(f"another transaction holds what is needed of the database {database}; try again")
    if isinstance(error, psycopg.errors.QueryCanceled):
        return UnavailableError(f"the database {database} took longer than a statement may; try again, or ask for less")
    if isinstance(error, _NOT_NOW):
        return UnavailableError(f"the database {database} ended the transaction: {error}")
    if isinstance(error, psycopg.OperationalError | psycopg.InterfaceError):
        lines = str(error).splitlines() or [type(error).__name__]
        return UnavailableError(f"the database {database} does not answer: {lines[0]}; check the URL and that the server runs")
    return None


SILENCE_SECONDS = 2.0
"""Silence of a statement before the server's liveness is checked."""
PROBE_SECONDS = 2
"""Longest time for a new connection."""
TRY_AGAIN_SECONDS = 1.0

Answer = TypeVar("Answer")
log = logging.getLogger(__name__)


def mind_absence(connection: psycopg.Connection[Any]) -> None:
    """Has the server end this session, with its locks, some 20 s after the client's machine is gone without a word, not hours."""
    for setting in ("tcp_keepalives_idle = 5", "tcp_keepalives_interval = 5", "tcp_keepalives_count = 3"):
        connection.execute(f"SET {setting}".encode())


class ServerLiveness:
    """State of one server: whether it answers, and if not, when the next caller may try. Threads share it."""

    def __init__(self, database: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._database = database
        self._clock = clock
        self._lock = threading.Lock()
        self._reason: str | None = None
        self._next_try = 0.0

    def connect(self, *arguments: Any, **options: Any) -> WatchedConnection:
        """A connection, as by `psycopg.connect`. Raises OperationalError, at once if the server was silent a moment ago."""
        with self._lock:
            if self._reason is not None:
                if self._clock() < self._next_try:
                    raise psycopg.OperationalError(self._reason)
                self._next_try = self._clock() + TRY_AGAIN_SECONDS + PROBE_SECONDS
        try:
            connection = WatchedConnection.connect(*arguments, **options)
        except psycopg.OperationalError as error:
            self.silent((str(error).splitlines() or ["no reason given"])[0])
            raise
        connection.watch = self
        with self._lock:
            news, self._reason = self._reason is not None, None
        if news:
            log.info("the database %s answers again", self._database)
        return connection

    def silent(self, reason: str) -> None:
        """Marks the server as not answering."""
        with self._lock:
            news, self._reason = self._reason is None, reason
            self._next_try = self._clock() + TRY_AGAIN_SECONDS
        if news:
            log.warning(
                "the database %s does not answer (%s): check that its server runs; drivecal continues by itself when it does",
                self._database,
                reason,
            )


class WatchedConnection(psycopg.Connection[Any]):
    """See the module; made by `Watch.connect`."""

    watch: ServerLiveness | None = None

    def wait(self, gen: Generator[Any, Any, Answer], *arguments: Any, **options: Any) -> Answer:
        """Carries a statement out, as psycopg does. Raises OperationalError, and closes the connection, if the server is silent."""
        return super().wait(self._watched(gen), *arguments, **options)

    def _watched(self, gen: Generator[Any, Any, Answer]) -> Generator[Any, Any, Answer]:
        """`gen`, which is resumed when the socket is ready, and several times a second with nothing while it is not."""
        patience_ends = time.monotonic() + SILENCE_SECONDS
        try:
            wanted = next(gen)
            while True:
                ready = yield wanted
                if not ready and time.monotonic() >= patience_ends:
                    self._probe()
                if ready or time.monotonic() >= patience_ends:
                    patience_ends = time.monotonic() + SILENCE_SECONDS
                wanted = gen.send(ready)
        except StopIteration as ended:
            answer: Answer = ended.value
            return answer

    def _probe(self) -> None:
        """Asks the server for another connection."""
        if self.watch is None:
            return
        place = {"host": self.info.host, "hostaddr": self.info.hostaddr or None, "port": self.info.port}
        same = make_conninfo(self.info.dsn, **place, password=self.info.password or None, connect_timeout=PROBE_SECONDS)
        try:
            psycopg.connect(same).close()
        except psycopg.OperationalError:
            reason = f"nothing came for {SILENCE_SECONDS + PROBE_SECONDS:.0f} s"
            self.watch.silent(reason)
            self.close()
            raise psycopg.OperationalError(reason) from None
