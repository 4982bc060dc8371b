import sqlite3

import psycopg
import pytest
from sqlalchemy.exc import DBAPIError, OperationalError

from drivecal.domain.errors import DatabaseError, UnavailableError
from drivecal.storage.engine.failures import translated


def sqlite_error(code: int) -> sqlite3.Error:
    error = sqlite3.OperationalError("it broke")
    error.sqlite_errorcode = code
    return error


def wrapped(error: Exception) -> DBAPIError:
    return OperationalError("SELECT 1", {}, error)


@pytest.mark.parametrize(
    ("error", "expected", "message"),
    [
        (sqlite_error(sqlite3.SQLITE_NOTADB), DatabaseError, "the file is not an SQLite database"),
        (sqlite_error(sqlite3.SQLITE_CORRUPT), DatabaseError, "the file is a damaged SQLite database"),
        (sqlite_error(sqlite3.SQLITE_CANTOPEN), UnavailableError, "the file cannot be opened for writing"),
        (sqlite_error(sqlite3.SQLITE_READONLY_DIRECTORY), UnavailableError, "the file cannot be opened for writing"),
        (sqlite_error(sqlite3.SQLITE_BUSY_SNAPSHOT), UnavailableError, "the file is locked"),
        (sqlite_error(sqlite3.SQLITE_FULL), UnavailableError, "cannot be used at the moment: it broke"),
        (
            psycopg.OperationalError("server closed\nthe connection"),
            UnavailableError,
            "the file does not answer: server closed; check",
        ),
        (psycopg.errors.LockNotAvailable("no"), UnavailableError, "another transaction holds"),
        (psycopg.errors.QueryCanceled("no"), UnavailableError, "took longer than a statement may"),
        (psycopg.errors.AdminShutdown("bye"), UnavailableError, "does not answer: bye"),
        (psycopg.errors.ReadOnlySqlTransaction("read-only"), UnavailableError, "ended the transaction: read-only"),
        (psycopg.errors.IdleInTransactionSessionTimeout("idle"), UnavailableError, "ended the transaction: idle"),
        (psycopg.errors.TransactionTimeout("long"), UnavailableError, "ended the transaction: long"),
        (psycopg.errors.DeadlockDetected("dead"), UnavailableError, "ended the transaction: dead"),
        (psycopg.OperationalError(), UnavailableError, "does not answer: OperationalError"),
    ],
)
def test_a_databases_state_is_one_of_drivecals_errors(error: Exception, expected: type[Exception], message: str) -> None:
    for raised in (error, wrapped(error)):
        with pytest.raises(expected, match=message) as caught, translated("the file"):
            raise raised
        assert caught.value.__cause__ is raised


@pytest.mark.parametrize(
    "error",
    [
        sqlite_error(sqlite3.SQLITE_ERROR),
        psycopg.errors.SyntaxError("SELEKT"),
        psycopg.errors.InFailedSqlTransaction("x"),
        KeyError("x"),
    ],
)
def test_mistakes_in_the_program_are_not_dressed_up(error: Exception) -> None:
    for raised in (error, wrapped(error)):
        with pytest.raises(type(raised)) as caught, translated("the file"):
            raise raised
        assert caught.value is raised
