"""Statements over many values at once: `IN` in chunks, and inserts that leave alone what is there already."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, cast

from sqlalchemy import ARRAY, Column, ColumnElement, Connection, Table, any_, bindparam
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.dialects.sqlite import Insert

LARGEST_IN = 5_000
"""Values per `IN` on SQLite, which takes them one variable each."""
LARGEST_ARRAY = 50_000
"""Values per array on PostgreSQL; bounds the memory of one statement."""


def among(connection: Connection, column: Column[Any], values: Sequence[Any]) -> Iterator[ColumnElement[bool]]:
    """Conditions that together say that `column` is among `values`, one for each chunk; both backends answer them from an index."""
    if connection.dialect.name == "postgresql":
        for start in range(0, len(values), LARGEST_ARRAY):
            array = bindparam(None, list(values[start : start + LARGEST_ARRAY]), type_=ARRAY(column.type))
            yield column == any_(array)
    else:
        for start in range(0, len(values), LARGEST_IN):
            yield column.in_(values[start : start + LARGEST_IN])


def insert(connection: Connection, table: Table) -> Insert:
    """An INSERT with `on_conflict_do_nothing` and `on_conflict_do_update`, which both backends spell alike."""
    if connection.dialect.name == "postgresql":
        return cast("Insert", postgresql.insert(table))
    return sqlite.insert(table)
