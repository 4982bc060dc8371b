"""Statements over many values at once: `IN` in chunks, and inserts that keep existing rows."""

from collections.abc import Iterator, Sequence
from typing import Any, cast

from sqlalchemy import ARRAY, Column, ColumnElement, Connection, Dialect, LargeBinary, Select, Table, any_, bindparam
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.dialects.sqlite import Insert

LARGEST_IN = 5_000
"""Values per `IN` on SQLite, which takes them one variable each."""
LARGEST_ARRAY = 50_000
"""Values per array on PostgreSQL; bounds the memory of one statement."""


def among(connection: Connection, column: Column[Any], values: Sequence[Any]) -> Iterator[ColumnElement[bool]]:
    """Returns conditions, one per chunk, that together select rows with `column` among `values`; an index answers them."""
    if connection.dialect.name == "postgresql":
        for start in range(0, len(values), LARGEST_ARRAY):
            kind = _Bytes() if isinstance(column.type, LargeBinary) else column.type
            yield column == any_(bindparam(None, list(values[start : start + LARGEST_ARRAY]), type_=ARRAY(kind)))
    else:
        for start in range(0, len(values), LARGEST_IN):
            chunk = list(values[start : start + LARGEST_IN])
            yield column.in_(bindparam(None, chunk, expanding=True, type_=column.type))  # a bare list is checked value by value


def rows_among(connection: Connection, query: Select[Any], column: Column[Any], values: Sequence[Any]) -> Iterator[Any]:
    """Yields the rows of a query whose `column` is among `values`."""
    for condition in among(connection, column, values):
        yield from connection.execute(query.where(condition)).all()


class _Bytes(LargeBinary):
    """Bytes handed to psycopg as they are. In the wrapper of its DB-API they would go as text, and take half of a look-up's time."""

    def bind_processor(self, dialect: Dialect) -> None:
        del dialect


def insert(connection: Connection, table: Table) -> Insert:
    """An INSERT with `on_conflict_do_nothing` and `on_conflict_do_update`, which both backends spell alike."""
    if connection.dialect.name == "postgresql":
        return cast("Insert", postgresql.insert(table))
    return sqlite.insert(table)
