"""Databases of earlier revisions, with the rows that their release wrote."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, LargeBinary, column, insert, inspect, table, text

from drivecal.storage.engine import schema
from drivecal.storage.engine.database import Database

FOLDER = Path(__file__).parent
Rows = dict[str, list[list[Any]]]
"""Of each table the names of its columns and then its rows, as `make.py` wrote them."""


def rows_of(revision: str) -> Rows:
    """The rows of a revision's database."""
    found: Rows = json.loads((FOLDER / f"{revision}.json").read_text())
    return found


COUNTS = {"sensitivity_cells": 1, "cells": 2, "robustness_cells": 3, "validation_cells": 4}
"""Columns of campaigns before revision 0006, by which `campaign_stages` has the stage."""


def newest(rows: Rows) -> Rows:
    """Rows of an earlier revision as the newest tables have them."""
    columns, *campaigns = rows["campaigns"]
    kept = [position for position, name in enumerate(columns) if name not in COUNTS]
    stages: list[list[Any]] = [["campaign_sequence", "stage", "cells"]]
    for row in campaigns:
        record = dict(zip(columns, row, strict=True))
        stages += [[record["sequence"], number, record[name]] for name, number in COUNTS.items() if record.get(name)]
    moved = [[row[position] for position in kept] for row in (columns, *campaigns)]
    return {name: moved if name == "campaigns" else listed for name, listed in rows.items()} | {"campaign_stages": stages}


def create(database: Database, revision: str) -> None:
    """Makes a database as the release of a revision left it."""
    schema.prepare_file(database.url)
    schema.use_write_ahead_log(database.url)
    with database.transaction() as connection:
        schema.upgrade(connection, database.name, revision)
        fill(connection, rows_of(revision))


def fill(connection: Connection, rows: Rows) -> None:
    """Inserts rows, and has the numbers of the next ones follow them."""
    for name, (columns, *listed) in rows.items():
        binary = {one["name"] for one in inspect(connection).get_columns(name) if isinstance(one["type"], LargeBinary)}
        records = [
            {
                one: bytes.fromhex(value) if one in binary and value is not None else value
                for one, value in zip(columns, row, strict=True)
            }
            for row in listed
        ]
        if records:  # texts go in as they are, and the backend reads them
            connection.execute(insert(table(name, *map(column, columns))), records)
        if connection.dialect.name == "postgresql":
            query = text("SELECT setval(pg_get_serial_sequence(:table, :column), :last)")
            for position, number in enumerate(columns):
                if number in {"id", "sequence"} and listed and isinstance(listed[0][position], int):
                    last = max(row[position] for row in listed)
                    connection.execute(query, {"table": name, "column": number, "last": last})
