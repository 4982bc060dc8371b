"""Copies all rows of one database into another of the same revision, SQLite or PostgreSQL, in bounded memory.

Tables are looked up in the databases and not in `tables`, so that databases of earlier revisions can be copied too. Between the two,
values are as SQLite stores them: JSON as its text, moments as text in UTC, truth as 0 and 1. So what was copied there and back is
the same, bit by bit.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from typing import Any

from sqlalchemy import (
    JSON,
    Boolean,
    Column,
    Connection,
    DateTime,
    LargeBinary,
    MetaData,
    String,
    Table,
    func,
    inspect,
    select,
    text,
)

from drivecal.domain.errors import DatabaseError
from drivecal.storage.engine import urls
from drivecal.storage.engine.failures import translated
from drivecal.storage.engine.schema import REVISION_TABLE

CHUNK = 20_000
"""Most rows of a portion, and in one COPY of PostgreSQL, which remembers each row until its foreign keys are checked. Two portions are
in memory at a time."""
CHUNK_BYTES = 64 * 2**20
"""Most bytes of archives and characters of documents in a portion, unless a single row has more."""
Row = tuple[Any, ...]

Progress = Callable[[str, int, int], None]
"""Told every now and then: the table, how many of its rows are copied, and how many it has."""


def tables_of(connection: Connection) -> list[Table]:
    """The tables of a database but that of its revision, in an order in which they can be filled."""
    return _reflected(connection, [name for name in inspect(connection).get_table_names() if name != REVISION_TABLE])


def _reflected(connection: Connection, names: Sequence[str]) -> list[Table]:
    metadata = MetaData()
    metadata.reflect(connection, only=names)
    return metadata.sorted_tables


def count_rows(connection: Connection, tables: Sequence[Table]) -> dict[str, int]:
    """Returns the number of rows by table."""
    return {table.name: connection.execute(select(func.count()).select_from(table)).scalar_one() for table in tables}


def copy_rows(source: Connection, target: Connection, progress: Progress) -> dict[str, int]:
    """Copies all rows and the numbers that the next rows get; says how many rows there were by table. The target has its tables, and no
    rows yet. Raises DatabaseError if the source lacks one of the target's tables."""
    names = [table.name for table in tables_of(target)]
    missing = sorted(set(names) - set(inspect(source).get_table_names()))
    if missing:
        raise DatabaseError(f"{urls.shown(source.engine.url)} lacks tables of its revision: {', '.join(missing)}")
    tables = _reflected(source, names)
    counts = count_rows(source, tables)
    with ThreadPoolExecutor(1) as reader:  # it reads the next rows while the last ones are written
        for table in tables:
            done = 0
            portions = _portions(source, table)
            following: Future[list[Row]] = reader.submit(next, portions, [])
            while rows := _result(following, source):
                following = reader.submit(next, portions, [])
                with translated(urls.shown(target.engine.url)):
                    _write(target, table, rows)
                done += len(rows)
                progress(table.name, done, counts[table.name])
    _set_sequences(target, last_numbers(source, tables))
    return counts


def _result(rows: Future[list[Row]], source: Connection) -> list[Row]:
    with translated(urls.shown(source.engine.url)):  # here, or what is wrong with one database would be said of the other
        return rows.result()


def _portions(connection: Connection, table: Table) -> Iterator[list[Row]]:
    """Reads all rows in the order of their keys, as many at a time as fit into memory."""
    columns = [column.name if connection.dialect.name != "postgresql" else _neutral(column) for column in table.columns]
    long = [f"coalesce(length({name}), 0)" for name, column in zip(columns, table.columns, strict=True) if _is_long(column)]
    longest = connection.scalar(text(f"SELECT max({' + '.join(long) or 0}) FROM {table.name}"))  # noqa: S608  # the database's own names
    size = min(max(CHUNK_BYTES // max(longest or 0, 1), 1), CHUNK)
    order = ", ".join(column.name for column in table.primary_key)
    query = f"SELECT {', '.join(columns)} FROM {table.name} ORDER BY {order}"  # noqa: S608  # the same
    driver: Any = connection.connection.driver_connection
    if connection.dialect.name == "postgresql":
        cursor = driver.cursor("copied", binary=True)  # at the server, which sends a portion when it is fetched
        cursor.execute(query)
    else:
        cursor = driver.execute(query)
    with closing(cursor):
        while rows := cursor.fetchmany(size):
            yield rows


def _is_long(column: Column[Any]) -> bool:
    return isinstance(column.type, JSON | LargeBinary | String)


def _neutral(column: Column[Any]) -> str:
    """Returns PostgreSQL's expression of the value that SQLite would store."""
    if isinstance(column.type, JSON):
        return f"{column.name}::text"
    if isinstance(column.type, DateTime):
        return f"to_char({column.name} AT TIME ZONE 'UTC', 'YYYY-MM-DD HH24:MI:SS.US')"
    if isinstance(column.type, Boolean):
        return f"{column.name}::int"
    return str(column.name)


def _write(connection: Connection, table: Table, rows: Sequence[Row]) -> None:
    names = ", ".join(column.name for column in table.columns)
    driver: Any = connection.connection.driver_connection
    if connection.dialect.name == "postgresql":
        connection.execute(text("SET LOCAL TIME ZONE 'UTC'"))  # in which it reads moments that name none
        with driver.cursor() as cursor, cursor.copy(f"COPY {table.name} ({names}) FROM STDIN") as copy:
            for row in rows:
                copy.write_row(row)
    else:
        marks = ", ".join("?" for _ in table.columns)
        driver.executemany(f"INSERT INTO {table.name} ({names}) VALUES ({marks})", rows)  # noqa: S608  # the database's own names


def last_numbers(connection: Connection, tables: Sequence[Table]) -> dict[str, int]:
    """The last number that was given out, by table. Numbers of rows that are gone (events) must not come again."""
    numbers: dict[str, int] = {}
    for table in tables:
        if connection.dialect.name == "postgresql":
            sequence = _postgresql_sequence(connection, table.name)
            if sequence is not None:
                last, called = connection.execute(text(f"SELECT last_value, is_called FROM {sequence}")).one()  # noqa: S608  # its own
                numbers[table.name] = last if called else 0
        elif _counts(connection):
            query = text("SELECT seq FROM sqlite_sequence WHERE name = :name")
            numbers[table.name] = connection.scalar(query, {"name": table.name}) or 0
    return {name: last for name, last in numbers.items() if last}


def _set_sequences(connection: Connection, last: dict[str, int]) -> None:
    for table, value in last.items():
        values = {"name": table, "value": value}
        if connection.dialect.name == "postgresql":
            sequence = _postgresql_sequence(connection, table)
            connection.execute(text("SELECT setval(CAST(:name AS regclass), :value)"), values | {"name": sequence})
        else:  # it counted the rows that were just inserted
            changed = connection.execute(text("UPDATE sqlite_sequence SET seq = :value WHERE name = :name"), values)
            if not changed.rowcount:
                connection.execute(text("INSERT INTO sqlite_sequence (name, seq) VALUES (:name, :value)"), values)


def _postgresql_sequence(connection: Connection, table: str) -> str | None:
    """The sequence that numbers a table's rows; None if nothing does."""
    query = text(
        "SELECT pg_get_serial_sequence(:table, attname) FROM pg_attribute WHERE attrelid = CAST(:table AS regclass) AND attnum > 0"
        " AND NOT attisdropped AND pg_get_serial_sequence(:table, attname) IS NOT NULL"
    )
    sequence: str | None = connection.scalar(query, {"table": table})
    return sequence


def _counts(connection: Connection) -> bool:
    """Whether SQLite has its table of sequences: it comes with the first table that is numbered without gaps."""
    return bool(connection.scalar(text("SELECT count(*) FROM sqlite_master WHERE name = 'sqlite_sequence'")))
