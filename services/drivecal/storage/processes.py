"""The processes of the server, as they report themselves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, select

from drivecal.storage.membership import insert
from drivecal.storage.tables import processes
from drivecal.storage.types import now


@dataclass(frozen=True, slots=True)
class StoredProcess:
    """A process by its `name`, and when it was last heard of."""

    name: str
    pid: int
    started_at: datetime
    heartbeat_at: datetime
    detail: Mapping[str, Any]


def heartbeat(connection: Connection, name: str, pid: int, started_at: datetime, detail: Mapping[str, Any]) -> None:
    """Says that the process lives, and how it is. A new process of the same name takes the place of the one before."""
    values = {"pid": pid, "started_at": started_at, "heartbeat_at": now(), "detail": dict(detail)}
    statement = insert(connection, processes).values(name=name, **values)
    connection.execute(statement.on_conflict_do_update(index_elements=["name"], set_=values))


def read(connection: Connection, name: str) -> StoredProcess | None:
    """What a process last said; None where it never did."""
    row = connection.execute(select(processes).where(processes.c.name == name)).one_or_none()
    if row is None:
        return None
    return StoredProcess(row.name, row.pid, row.started_at, row.heartbeat_at, row.detail)
