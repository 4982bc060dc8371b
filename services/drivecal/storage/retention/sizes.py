"""Sizes of what goes, from the sizes of whole tables."""

from __future__ import annotations

from sqlalchemy import Connection, func, select, text

from drivecal.storage.engine.tables import evaluations, ratings, reference_keys, runs
from drivecal.storage.retention.marking import Doomed

_TABLES = (evaluations, runs, ratings, reference_keys)


def bytes_of(connection: Connection, doomed: Doomed) -> int:
    """Returns about how many bytes the doomed rows take, indexes included: their share of the cells and runs of the database."""
    cells = connection.scalar(select(func.count()).select_from(evaluations)) or 0
    made = connection.scalar(select(func.count()).select_from(runs)) or 0
    share = (doomed.cells + doomed.runs) / max(1, cells + made)
    return round(share * _total(connection))


def _total(connection: Connection) -> int:
    if connection.dialect.name == "sqlite":
        pages, free, size = (connection.exec_driver_sql(f"PRAGMA {name}").scalar_one() for name in _PRAGMAS)
        return int((pages - free) * size)
    names = [table.name for table in _TABLES]
    query = text("SELECT sum(pg_total_relation_size(CAST(name AS regclass))) FROM unnest(CAST(:names AS text[])) AS name")
    return int(connection.scalar(query, {"names": names}) or 0)


_PRAGMAS = ("page_count", "freelist_count", "page_size")
