"""Checks that a database is whole: its tables, files and indexes, and that its documents can be read. Only reads.

Each check returns a message per fault.
"""

import json
from collections.abc import Callable, Iterator
from typing import Any

from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import JSON, Connection, Table, Text, cast, exists, func, select, text

from drivecal.domain.parameters import ParameterSet
from drivecal.storage.engine.schema import REVISION_TABLE
from drivecal.storage.engine.tables import metadata, parameter_sets
from drivecal.storage.maintenance.transfer import last_numbers, tables_of
from drivecal.storage.references.runs import largest_id

Check = Callable[[Connection], Iterator[str]]
STREAMED = 10_000
"""Rows of documents in memory at a time."""


def check_tables(connection: Connection) -> Iterator[str]:
    """Tables, columns, indexes and constraints are those of this drivecal's revision."""
    context = MigrationContext.configure(connection, opts={"version_table": REVISION_TABLE, "compare_type": True})
    for difference in compare_metadata(context, metadata):
        step = difference[0] if isinstance(difference, list) else difference
        # Ignores tables of other applications.
        if step[0] != "remove_table" and not (step[0] == "remove_index" and step[1].table.name not in metadata.tables):
            yield f"{str(step[0]).replace('_', ' ')} {getattr(step[-1], 'name', step[-1])} is what a new database does and this one did not"


def check_storage(connection: Connection) -> Iterator[str]:
    """The backend itself finds its file, indexes and foreign keys in order."""
    if connection.dialect.name == "sqlite":
        messages = connection.exec_driver_sql("PRAGMA integrity_check(5)").scalars()
        yield from (f"SQLite reports: {message}" for message in messages if message != "ok")
        for table, row, parent, _ in connection.exec_driver_sql("PRAGMA foreign_key_check").fetchmany(5):
            yield f"row {row} of {table} points to a row of {parent} that is not there"
        return
    invalid = text(
        "SELECT c.relname FROM pg_index i JOIN pg_class c ON c.oid = i.indexrelid JOIN pg_namespace n ON n.oid = c.relnamespace"
        " WHERE n.nspname = current_schema() AND NOT (i.indisvalid AND i.indisready)"
        " UNION ALL SELECT conname FROM pg_constraint WHERE connamespace = CAST(current_schema() AS regnamespace) AND NOT convalidated"
    )
    yield from (f"PostgreSQL says that {name} is not valid; REINDEX or VALIDATE it" for name in connection.scalars(invalid))
    for table in metadata.sorted_tables:
        for key in table.foreign_key_constraints:
            yield from _dangling(connection, table, key.elements[0].parent, key.elements[0].column)


def _dangling(connection: Connection, table: Table, child: Any, parent: Any) -> Iterator[str]:
    other = parent.table.alias("other")
    query = select(func.count()).where(child.is_not(None), ~exists().where(other.c[parent.name] == child))
    count = connection.execute(query.select_from(table)).scalar_one()
    if count:
        yield f"{count:,} rows of {table.name} point by {child.name} to rows of {parent.table.name} that are not there"


def check_numbers(connection: Connection) -> Iterator[str]:
    """The numbers that new rows get are free."""
    tables = tables_of(connection)
    for name, last in last_numbers(connection, tables).items():
        if name in metadata.tables:
            [column] = metadata.tables[name].primary_key
            largest = largest_id(connection) if name == "runs" else connection.scalar(select(func.max(column))) or 0
            if largest > last:
                yield f"the next row of {name} would get number {last + 1}, but {largest} is taken"


def check_documents(connection: Connection) -> Iterator[str]:
    """Every JSON document can be read. (PostgreSQL refuses others.)"""
    if connection.dialect.name == "postgresql":
        return
    for table in metadata.sorted_tables:
        for column in table.columns:
            if isinstance(column.type, JSON):
                query = select(cast(column, Text)).where(column.is_not(None))
                unreadable = sum(not _readable(row) for row in connection.execute(query).yield_per(STREAMED).scalars())
                if unreadable:
                    yield f"{unreadable:,} documents in {table.name}.{column.name} are no JSON"


def _readable(document: str) -> bool:
    try:
        json.loads(document)
    except ValueError:
        return False
    return True


def check_parameter_sets(connection: Connection, every: int) -> Iterator[str]:
    """Each `every`-th parameter set is stored under the key of its values."""
    query = select(parameter_sets).where(parameter_sets.c.id % every == 0)
    wrong = [row.id for row in connection.execute(query).yield_per(STREAMED) if not _has_its_key(row)]
    if wrong:
        yield f"{len(wrong):,} parameter sets cannot be read or are not stored under their key, the first of them number {wrong[0]}"


def _has_its_key(row: Any) -> bool:
    try:
        return bool(ParameterSet.from_json(row.parameter_values).key == row.key)
    except (ValueError, ArithmeticError, AttributeError, TypeError):
        return False


CHECKS: dict[str, Check] = {
    "tables": check_tables,
    "storage": check_storage,
    "numbers of new rows": check_numbers,
    "documents": check_documents,
}
