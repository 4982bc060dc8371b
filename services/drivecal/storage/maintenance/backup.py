"""Backups: one SQLite file that drivecal can open, from any database, and its restore into an empty database.

A backup holds one moment of the database, however long it takes and whatever is written meanwhile, and appears under its name only when
it is complete, checked and on the disk. A restored database on PostgreSQL is complete or as empty as before. On SQLite the rows are there
at once, and an upgrade that was killed after that is completed by the next one.
"""

import os
import sqlite3
import tempfile
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import (
    JSON,
    URL,
    Boolean,
    Column,
    Connection,
    DateTime,
    LargeBinary,
    MetaData,
    String,
    Table,
    event,
    func,
    inspect,
    select,
    text,
)

from drivecal.domain.errors import DatabaseError
from drivecal.storage.engine import schema, urls
from drivecal.storage.engine.database import Database, make_engine
from drivecal.storage.engine.failures import translated
from drivecal.storage.engine.schema import REVISION_TABLE
from drivecal.storage.engine.tables import metadata
from drivecal.storage.engine.urls import sqlite_file

CHUNK = 20_000
"""Most rows of a portion, and in one COPY of PostgreSQL, which remembers each row until its foreign keys are checked."""
CHUNK_BYTES = 64 * 2**20
"""Most bytes of archives and characters of documents in a portion, unless a single row has more."""
Row = tuple[Any, ...]

Progress = Callable[[str, int, int], None]
"""Told every now and then: the table, how many of its rows are copied, and how many it has."""


def tables_of(connection: Connection) -> list[Table]:
    """The tables of a database, without its revision, in an order that allows to fill them."""
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
    for table in tables:
        done = 0
        with closing(_portions(source, table)) as portions:
            while rows := _next(portions, source):
                with translated(urls.shown(target.engine.url)):
                    _write(target, table, rows)
                done += len(rows)
                progress(table.name, done, counts[table.name])
    _set_sequences(target, last_numbers(source, tables))
    return counts


def _next(portions: Iterator[list[Row]], source: Connection) -> list[Row]:
    with translated(urls.shown(source.engine.url)):  # here, or what is wrong with one database would be said of the other
        return next(portions, [])


def _portions(connection: Connection, table: Table) -> Generator[list[Row]]:
    """Reads all rows in the order of their keys, as many at a time as fit into memory."""
    columns = [column.name if connection.dialect.name != "postgresql" else _neutral(column) for column in table.columns]
    named = zip(columns, table.columns, strict=True)
    long = [f"coalesce(length({name}), 0)" for name, column in named if isinstance(column.type, JSON | LargeBinary | String)]
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
        connection.execute(text("SET LOCAL TIME ZONE 'UTC'"))  # the zone of moments that name none
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
        else:
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


PAGES = 4_096
"""Pages of an SQLite database that are copied at a time, 16 MB."""
BESIDE = ("-journal", "-wal", "-shm")
"""Suffixes of the companion files of an SQLite database that SQLite applies to it when it is opened."""
PASSING = ("processes",)
"""Tables of the processes that served a database: a database with rows only there counts as empty."""


@dataclass(frozen=True, slots=True)
class Copied:
    """Contents of a backup or a restored database."""

    revision: str
    rows: dict[str, int]
    """Number of rows by table."""


def write(database: Database, file: Path, progress: Progress) -> Copied:
    """Backs the database up into a new `file`, while others use it. Raises DatabaseError, if `file` exists too, and UnavailableError."""
    _refuse_target(file)
    schema.refuse_missing(database.url)
    with database.read() as connection:
        schema.refuse_foreign(connection, database.name)
        revision = schema.revision_of(connection)
        if revision is None:
            raise DatabaseError(f"{database.name} is empty; there is nothing to back up")
        with _partial(file) as partial:
            if connection.dialect.name == "sqlite":
                rows = count_rows(connection, tables_of(connection))
                _copy_pages(connection, partial, progress)
            else:
                with _opened(partial, trusts=True) as opened, opened.transaction() as target:
                    schema.upgrade(target, opened.name, revision)
                    rows = copy_rows(connection, target, progress)
            _check_file(partial, rows)
            _refuse_target(file)
            _publish(partial, file)
    return Copied(revision, rows)


def restore(file: Path, database: Database, progress: Progress) -> Copied:
    """Fills an empty database from a backup and brings it to this drivecal's revision. The caller holds the server's lock.

    Raises DatabaseError if the file is not a backup, or if the database has rows or tables of another program, and UnavailableError; the
    database is then as it was.
    """
    if not file.is_file():
        raise DatabaseError(f"there is no file {file}; name a backup that `drivecal db backup` made")
    with _opened(file) as backup, backup.read() as source:
        schema.refuse_foreign(source, backup.name)
        revision = schema.revision_of(source)
        if revision is None:
            raise DatabaseError(f"{file} holds no database of drivecal; name a backup that `drivecal db backup` made")
        _refuse_damaged(source, file)
        schema.prepare_file(database.url)
        rows = count_rows(source, tables_of(source))
        target = sqlite_file(database.url)
        if target is None:
            with database.transaction() as connection:
                _refuse_rows(connection, database.name)
                _make_anew(connection, database.name, revision)
                copy_rows(source, connection, progress)
                _compare(connection, rows, database.name)
                schema.upgrade(connection, database.name)
                connection.exec_driver_sql("ANALYZE")
        else:
            if target.exists() and target.samefile(file):
                raise DatabaseError(f"{file} is the database itself; name another file or another database")
            with database.read() as connection:
                _refuse_rows(connection, database.name)
            _copy_pages(source, target, progress)
            with database.read() as connection:
                _compare(connection, rows, database.name)
    database.upgrade()
    return Copied(revision, rows)


def _refuse_target(file: Path) -> None:
    if file.is_dir() or not file.name:
        raise DatabaseError(f"{file} is a folder; name a file in it")
    there = [each.name for each in (file, *_beside(file)) if each.exists()]
    if there:  # SQLite would apply a companion file to the backup
        raise DatabaseError(f"{', '.join(there)} in {file.parent} is there already; name another file")


def _beside(file: Path) -> list[Path]:
    return [file.with_name(file.name + suffix) for suffix in BESIDE]


@contextmanager
def _partial(file: Path) -> Iterator[Path]:
    """Yields a temporary file in the folder of `file`, and removes it unless it was published."""
    try:
        handle, name = tempfile.mkstemp(prefix=f"{file.name}.", suffix=".partial", dir=file.parent)
    except OSError as error:
        raise DatabaseError(f"{file.parent} cannot be written: {error.strerror}; name a file in another folder") from error
    os.close(handle)
    try:
        yield Path(name)
    finally:
        for remains in (Path(name), *_beside(Path(name))):
            remains.unlink(missing_ok=True)


def _publish(partial: Path, file: Path) -> None:
    """Gives a complete backup its name, durably."""
    with partial.open("rb+") as written:
        os.fsync(written.fileno())
    partial.replace(file)
    folder = os.open(file.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def _copy_pages(source: Connection, target: Path, progress: Progress) -> None:
    """Copies an SQLite database in the source's transaction, so that others may write meanwhile and the copy does not see it. The target
    is changed in one transaction of its own."""
    source.exec_driver_sql("SELECT count(*) FROM sqlite_master")  # a transaction sees the moment of its first statement
    driver: Any = source.connection.driver_connection
    with translated(str(target)), closing(sqlite3.connect(target, timeout=30)) as copy:
        driver.backup(copy, pages=PAGES, progress=lambda _, left, total: progress("pages", total - left, total))


@contextmanager
def _opened(file: Path, *, trusts: bool = False) -> Iterator[Database]:
    """`trusts` leaves foreign keys to the check of the whole file: a look at each row takes a quarter of the copy's time."""
    url = URL.create("sqlite+pysqlite", database=str(file))
    engine = make_engine(url)
    if trusts:
        event.listen(engine, "connect", lambda connection, _: connection.execute("PRAGMA foreign_keys = OFF"))
    database = Database(url, engine)
    try:
        yield database
    finally:
        database.dispose()


def _check_file(partial: Path, rows: dict[str, int]) -> None:
    with translated(str(partial)), closing(sqlite3.connect(partial)) as plain:
        plain.execute("PRAGMA journal_mode = DELETE")  # one file, which can be read from read-only media too
    with _opened(partial) as opened, opened.read() as connection:
        _refuse_damaged(connection, partial)
        _compare(connection, rows, "the backup")


def _refuse_damaged(connection: Connection, file: Path) -> None:
    problems = [str(row[0]) for row in connection.exec_driver_sql("PRAGMA integrity_check(3)") if row[0] != "ok"]
    dangling = connection.exec_driver_sql("PRAGMA foreign_key_check").fetchmany(3)
    problems += [f"a row of {row[0]} points to one of {row[2]} that is not there" for row in dangling]
    if problems:
        raise DatabaseError(f"{file} is damaged ({'; '.join(problems)}); use another backup")


def _refuse_rows(connection: Connection, name: str) -> None:
    schema.refuse_encoding(connection, name)
    schema.refuse_foreign(connection, name)
    tables = tables_of(connection)
    foreign = sorted(table.name for table in tables if not _is_own(table))
    if foreign:  # a restore replaces what is there
        listed = ", ".join(foreign[:3])
        raise DatabaseError(f"{name} holds another program's tables ({listed}); name a database of drivecal's own")
    counts = count_rows(connection, tables)
    there = [f"{count:,} in {table}" for table, count in counts.items() if count and table not in PASSING]
    if there:
        raise DatabaseError(f"{name} has rows already ({', '.join(there)}); name an empty database")


def _is_own(table: Table) -> bool:
    return table.name in metadata.tables  # which has the tables of every revision: a table is never renamed or removed


def _make_anew(connection: Connection, name: str, revision: str) -> None:
    """Replaces drivecal's empty tables of any revision by empty tables at a backup's revision."""
    if schema.revision_of(connection) is not None:
        for table in reversed(tables_of(connection)):
            if _is_own(table):
                table.drop(connection)
        connection.exec_driver_sql(f"DROP TABLE {schema.REVISION_TABLE}")
    schema.upgrade(connection, name, revision)


def _compare(connection: Connection, rows: dict[str, int], name: str) -> None:
    counts = count_rows(connection, tables_of(connection))
    different = [f"{counts.get(table)} and not {n} in {table}" for table, n in rows.items() if counts.get(table) != n]
    if different:
        raise DatabaseError(f"{name}: row counts differ after copying ({'; '.join(different)}); check the disk and try again")
