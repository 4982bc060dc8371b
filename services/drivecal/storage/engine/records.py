"""Rows as records, found by their identifiers and read into dataclasses; cursors, which say where the next page of a list begins."""

from __future__ import annotations

import base64
import binascii
import json
import re
from collections.abc import Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any, TypeVar

from sqlalchemy import Column, Connection, Row, Select

from drivecal.domain.errors import InvalidInputError, NotFoundError, Problem

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Record = TypeVar("Record", bound="DataclassInstance")
_IDENTIFIER = re.compile(r"[0-9a-f]{32}")
_ABBREVIATION = re.compile(r"[0-9a-f]{1,31}")
SHORTEST = 4
"""Characters of an id that are enough."""


def identified(connection: Connection, query: Select[Any], kind: str, identifier: str, ids: Select[Any]) -> Row[Any]:
    """Returns the row of a query that compares a column with the parameter `identifier`, which may abbreviate one of the `ids`.

    Raises NotFoundError without such a row, and if several ids begin so. Anything may come in a URL, also text that a database cannot even
    compare: PostgreSQL refuses a NUL.
    """
    if _ABBREVIATION.fullmatch(identifier):
        if len(identifier) < SHORTEST:
            raise NotFoundError(kind, identifier, "give at least four characters of its id")
        (column,) = ids.selected_columns
        beginning_so = connection.scalars(ids.where(column >= identifier, column < identifier + "g").limit(2)).all()
        if len(beginning_so) > 1:
            raise NotFoundError(kind, identifier, "several ids begin so; give more characters")
        identifier = next(iter(beginning_so), identifier)
    row = connection.execute(query, {"identifier": identifier}).one_or_none() if _IDENTIFIER.fullmatch(identifier) else None
    if row is None:
        raise NotFoundError(kind, identifier)
    return row


def record(kind: type[Record], row: Row[Any], /, **parsed: Any) -> Record:
    """Returns a record with the row's columns of the same names, and the fields that were `parsed` already."""
    return kind(**{field.name: getattr(row, field.name) for field in fields(kind) if field.name not in parsed}, **parsed)


def page_by(
    connection: Connection,
    query: Select[Any],
    column: Column[int],
    limit: int,
    cursor: str | None,
    *,
    newest_first: bool = True,
) -> tuple[Sequence[Row[Any]], str | None]:
    """Returns at most `limit` rows of a query, sorted by a number that it has as a column, and the cursor of the next page (None on the
    last). Raises InvalidInputError for a foreign cursor."""
    if cursor is not None:
        (last,) = decode_cursor(cursor, int)
        query = query.where(column < last if newest_first else column > last)
    rows = connection.execute(query.order_by(column.desc() if newest_first else column).limit(limit + 1)).all()
    return rows[:limit], encode_cursor(getattr(rows[limit - 1], column.name)) if len(rows) > limit else None


def encode_cursor(*position: int | str) -> str:
    """Returns the opaque cursor that names the last row of a page by the values that the list is sorted by."""
    return base64.urlsafe_b64encode(json.dumps(position, separators=(",", ":")).encode()).decode().rstrip("=")


def decode_cursor(cursor: str, *kinds: type[int | str]) -> tuple[Any, ...]:
    """Inverts `encode_cursor` for values of these `kinds`. Raises InvalidInputError for a foreign cursor."""
    try:
        position = json.loads(base64.b64decode(cursor + "=" * (-len(cursor) % 4), altchars=b"-_", validate=True))
    except (binascii.Error, ValueError, RecursionError):
        position = None
    if isinstance(position, list) and len(position) == len(kinds):
        fits = all(type(value) is kind for value, kind in zip(position, kinds, strict=True))
        if fits and all(0 <= value < 2**31 if isinstance(value, int) else value.isprintable() for value in position):
            return tuple(position)
    raise InvalidInputError(Problem("cursor", "it does not come from this list", "give `next_cursor` of the page before"))
