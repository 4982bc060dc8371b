"""Turns errors of the database drivers into drivecal's own."""

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager

import psycopg
from sqlalchemy.exc import DBAPIError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError

from drivecal.domain.errors import DatabaseError, DrivecalError, UnavailableError

_NO_DATABASE = {sqlite3.SQLITE_NOTADB: "is not an SQLite database", sqlite3.SQLITE_CORRUPT: "is a damaged SQLite database"}
_NOT_USABLE = {sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_PERM}
_FOR_NOW = {sqlite3.SQLITE_IOERR, sqlite3.SQLITE_FULL, sqlite3.SQLITE_PROTOCOL}
_NOT_NOW = (
    psycopg.errors.ReadOnlySqlTransaction,  # a server that takes over, or gives up, is read-only for a while
    psycopg.errors.IdleInTransactionSessionTimeout,
    psycopg.errors.TransactionTimeout,
)
"""Errors of PostgreSQL's class 25 that waiting mends; the driver calls all of that class internal errors."""


@contextmanager
def translated(database: str) -> Iterator[None]:
    """Maps the driver's errors about the state of `database`, its name in messages, to DatabaseError or UnavailableError. Errors in
    statements are programming errors and pass unchanged."""
    try:
        yield
    except PoolTimeoutError as error:
        raise UnavailableError(f"all connections to {database} are in use; try again later") from error
    except DBAPIError as error:
        known = _translate(error.orig, database)
        if known is None:
            raise
        raise known from error
    except (sqlite3.Error, psycopg.Error) as error:  # where a driver was used directly
        known = _translate(error, database)
        if known is None:
            raise
        raise known from error


def _translate(error: BaseException | None, database: str) -> DrivecalError | None:
    if isinstance(error, sqlite3.Error):
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF  # the low byte is the class, the rest the detail
        if code in _NO_DATABASE:
            return DatabaseError(f"{database} {_NO_DATABASE[code]}; name another file or restore a backup")
        if code in _NOT_USABLE:
            return DatabaseError(f"{database} cannot be opened for writing; check that the file and its folder are writable")
        if code in {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED}:
            return UnavailableError(
                f"the database {database} is locked by another process that writes to it; try again, and end whatever else has it open"
            )
        if code in _FOR_NOW:
            return UnavailableError(f"the database {database} cannot be used at the moment: {error}")
    if isinstance(error, psycopg.errors.LockNotAvailable):
        return UnavailableError(f"another transaction holds what is needed of the database {database}; try again")
    if isinstance(error, psycopg.errors.QueryCanceled):
        return UnavailableError(
            f"the database {database} took longer than it may for one statement; try again, or ask for less"
        )
    if isinstance(error, _NOT_NOW):
        return UnavailableError(f"the database {database} ended the transaction: {error}")
    if isinstance(error, psycopg.OperationalError | psycopg.InterfaceError):
        lines = str(error).splitlines() or [type(error).__name__]
        return UnavailableError(f"the database {database} does not answer: {lines[0]}")
    return None
