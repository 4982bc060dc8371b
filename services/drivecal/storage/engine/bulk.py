"""Statements over many values at once: `IN` in chunks, inserts that keep existing rows, and statements for thousands of rows."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, cast

from sqlalchemy import (
    ARRAY,
    Column,
    ColumnElement,
    Connection,
    Dialect,
    LargeBinary,
    Select,
    Table,
    Update,
    any_,
    bindparam,
    text,
)
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.dialects.sqlite import Insert
from sqlalchemy.sql.dml import Insert as AnyInsert

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


def execute_rows(connection: Connection, statement: AnyInsert | Update, rows: Sequence[Mapping[str, Any]]) -> int:
    """Executes a statement for each row, as `Connection.execute` does; all rows have the keys of the first. Returns the number of rows
    that an UPDATE has changed.

    SQLAlchemy's own way prepares each row anew, which takes several times as long as SQLite does. PostgreSQL gets many new rows at once.
    """
    if not rows:
        return 0
    if connection.dialect.name != "sqlite":
        if isinstance(statement, AnyInsert):  # only with an answer does SQLAlchemy send many of them in a statement
            statement = statement.returning(*statement.table.primary_key)
        return connection.execute(statement, rows).rowcount
    compiled = statement.compile(dialect=connection.dialect, column_keys=list(rows[0]))
    constants = compiled.params
    places: list[tuple[str, Callable[[Any], Any] | None, Any]] = []
    for name in compiled.positiontup or ():
        convert = compiled.binds[name].type.dialect_impl(connection.dialect).bind_processor(connection.dialect)
        if name not in rows[0]:  # of the statement itself
            places.append((name, None, constants[name] if convert is None else convert(constants[name])))
        else:
            places.append((name, convert or (lambda value: value), None))
    values = [tuple(constant if convert is None else convert(row[name]) for name, convert, constant in places) for row in rows]
    return connection.exec_driver_sql(compiled.string, values).rowcount


def numbers(connection: Connection, column: Column[Any], count: int) -> Sequence[int]:
    """Returns the next numbers of the sequence that numbers a table's rows, ascending: no other row will have them."""
    name = column.table.name
    if count == 0:
        return ()
    if connection.dialect.name == "postgresql":
        query = text("SELECT nextval(pg_get_serial_sequence(:name, :column)) FROM generate_series(1, :count)")
        return sorted(connection.scalars(query, {"name": name, "column": column.name, "count": count}))
    query = text("UPDATE sqlite_sequence SET seq = seq + :count WHERE name = :name RETURNING seq")
    last = connection.scalar(query, {"name": name, "count": count})
    if last is None:  # the table never had a row
        last = connection.scalar(
            text("INSERT INTO sqlite_sequence (name, seq) VALUES (:name, :count) RETURNING seq"), {"name": name, "count": count}
        )
    return range(last - count + 1, last + 1)
