"""Rows as records: found by their identifiers, and read into dataclasses."""

from __future__ import annotations

import re
from dataclasses import fields
from typing import TYPE_CHECKING, Any, TypeVar

from sqlalchemy import Connection, Row, Select

from drivecal.domain.errors import NotFoundError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Record = TypeVar("Record", bound="DataclassInstance")
_IDENTIFIER = re.compile(r"[0-9a-f]{32}")


def identified(connection: Connection, query: Select[Any], kind: str, identifier: str) -> Row[Any]:
    """Returns the row of a query that compares a column with the parameter `identifier`. Raises NotFoundError without one.

    Anything may come in a URL, also text that a database cannot even compare: PostgreSQL refuses a NUL.
    """
    row = connection.execute(query, {"identifier": identifier}).one_or_none() if _IDENTIFIER.fullmatch(identifier) else None
    if row is None:
        raise NotFoundError(kind, identifier)
    return row


def record(kind: type[Record], row: Row[Any], **parsed: Any) -> Record:
    """Returns a record with the row's columns of the same names, and the fields that were `parsed` already."""
    return kind(**{field.name: getattr(row, field.name) for field in fields(kind) if field.name not in parsed}, **parsed)
