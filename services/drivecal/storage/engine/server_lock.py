"""Lock of a database's only server; it ends with its process, even after a kill."""

import fcntl
import os
import socket
from pathlib import Path
from typing import IO, Any, Self

from sqlalchemy import URL, Connection, create_engine, event, text
from sqlalchemy.exc import DBAPIError
from sqlalchemy.pool import NullPool

from drivecal.domain.errors import DatabaseError
from drivecal.storage.engine import urls
from drivecal.storage.engine.failures import ServerLiveness, mind_absence, translated

KEY = 0x64726331
"""First key of the advisory lock on PostgreSQL; the second is a hash of the schema, so that schemas of one database do not collide."""


_OWNER = "drivecal server: "


class ServerLock:
    """The right to be the server of a database, held from `hold` until `release`, the end of a block or that of the process."""

    def renew(self) -> None:
        """Raises DatabaseError if another server took the lock after the connection to PostgreSQL was lost, and UnavailableError if
        PostgreSQL does not answer. Call it with every heartbeat. A file lock cannot be lost.
        """

    def release(self) -> None:
        """Releases the lock."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()


def hold(url: str, otherwise: str = "name another database by DRIVECAL_DATABASE_URL", server: int | None = None) -> ServerLock:
    """Takes the lock. Raises DatabaseError naming the holder if another server has it; `otherwise`: another remedy than to stop it.

    `server`: the process that a user stops, if it is not this one: a supervisor restarts its dispatcher.
    """
    parsed, named = urls.parse(url), os.getpid() if server is None else server
    file = urls.sqlite_file(parsed)
    return _PostgresLock(parsed, otherwise, named) if file is None else _FileLock(file, otherwise, named)


class _FileLock(ServerLock):
    """A lock on `<database>.lock`, whose text is the process id of the server. The file stays after the release."""

    def __init__(self, database: Path, otherwise: str, server: int) -> None:
        path = database.with_name(database.name + ".lock")
        try:
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            path.touch(mode=0o600)
            self._file: IO[str] = path.open("a+", encoding="ascii")
        except OSError as error:
            raise DatabaseError(f"{path} cannot be written: {error.strerror}; name a database in another folder") from error
        if not try_lock(self._file):
            self._file.seek(0)
            holder = self._file.read().strip() or "unknown"
            self._file.close()
            raise DatabaseError(f"another drivecal server (process {holder}) uses {database}; stop it, or {otherwise}")
        self._file.truncate(0)
        self._file.write(str(server))
        self._file.flush()

    def release(self) -> None:
        self._file.close()


def try_lock(file: IO[Any]) -> bool:
    """Locks an open file if no other process has it locked. Returns whether it did; closing the file releases it."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


class _PostgresLock(ServerLock):
    """An advisory lock of a session of its own, which the server ends when the process is gone."""

    def __init__(self, url: URL, otherwise: str, server: int) -> None:
        self._name = urls.shown(url)
        self._otherwise = otherwise
        self._owner = f"{_OWNER}process {server} on {socket.gethostname()}"[:63]
        arguments = {"connect_timeout": 5, "application_name": self._owner, "keepalives_idle": 5, "keepalives_interval": 5}
        self._engine = create_engine(url, poolclass=NullPool, isolation_level="AUTOCOMMIT", connect_args=arguments)
        watch = ServerLiveness(self._name)
        event.listen(self._engine, "do_connect", lambda _dialect, _record, given, options: watch.connect(*given, **options))
        self._session = 0
        self._connection = self._acquire()

    def renew(self) -> None:
        if not self._alive():
            self._disconnect()
            self._connection = self._acquire()

    def release(self) -> None:
        if self._alive():  # when the session only ends, the server notices it a moment later
            self._connection.execute(text("SELECT pg_advisory_unlock_all()"))
        self._disconnect()

    def _disconnect(self) -> None:
        if not self._connection.closed:
            self._connection.invalidate()  # ends the session, even a broken one
            self._connection.close()

    def _alive(self) -> bool:
        try:
            return not self._connection.closed and self._connection.scalar(text("SELECT 1")) == 1
        except DBAPIError:
            return False

    def _acquire(self) -> Connection:
        with translated(self._name):
            connection = self._engine.connect()
            mind_absence(connection.connection.dbapi_connection)  # type: ignore[arg-type]  # it is psycopg's own
            connection.execute(_END_SESSION, {"session": self._session, "owner": self._owner})
            if connection.scalar(text("SELECT pg_try_advisory_lock(:key, hashtext(current_schema()))"), {"key": KEY}):
                self._session = connection.scalar(text("SELECT pg_backend_pid()"))
                return connection
            holder = (connection.scalar(_HOLDER, {"key": KEY}) or "unknown").removeprefix(_OWNER)
            connection.close()
        raise DatabaseError(f"another drivecal server ({holder}) uses {self._name}; stop it, or {self._otherwise}")


_END_SESSION = text(
    "SELECT pg_terminate_backend(pid, 2000) FROM pg_stat_activity WHERE pid = :session AND application_name = :owner"
)
"""Ends this lock's last session, which PostgreSQL may not have noticed to be broken, and which still holds the lock then."""
_HOLDER = text(
    "SELECT application_name || coalesce(', from ' || host(client_addr), '') FROM pg_locks JOIN pg_stat_activity USING (pid)"
    " WHERE locktype = 'advisory' AND granted AND classid = :key AND objid::bigint = hashtext(current_schema())::bigint & 4294967295"
    " AND pg_locks.database = (SELECT oid FROM pg_database WHERE datname = current_database())"
)
