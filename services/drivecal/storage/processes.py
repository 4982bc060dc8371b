"""The processes of the server, as they report themselves, and the term of the elected one.

At most one dispatcher works on a database at a time: the holder of the lock (`server_lock`). A lock alone cannot keep out a dispatcher that
lost it without knowing, because it was stopped for a while or cut off. So each election begins a new *term*, and every transaction of a
dispatcher looks, inside itself, whether its own term is still the current one (`confirm`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, bindparam, select

from drivecal.domain.errors import SupersededError
from drivecal.storage.engine.bulk import insert
from drivecal.storage.engine.records import record
from drivecal.storage.engine.tables import processes
from drivecal.storage.engine.types import now

DISPATCHER = "dispatcher"
"""Name of the dispatcher's row, whose terms are counted."""


@dataclass(frozen=True, slots=True)
class StoredProcess:
    """A process by its `name`, the time of its last heartbeat, and its term if it was elected."""

    name: str
    pid: int
    started_at: datetime
    heartbeat_at: datetime
    detail: Mapping[str, Any]
    term: int


def elect(connection: Connection, name: str, pid: int, started_at: datetime) -> int:
    """Begins a new term, held by the process `pid`; gives its number. Waits until no transaction of the one before runs any more."""
    # FOR UPDATE: this, and nothing that heartbeats do, excludes the FOR KEY SHARE of `confirm`
    connection.execute(_TERM.with_for_update(), {"process": name})
    values = {"pid": pid, "started_at": started_at, "heartbeat_at": now(), "detail": {}}
    statement = insert(connection, processes).values(name=name, term=1, **values)
    elected = statement.on_conflict_do_update(index_elements=["name"], set_={"term": processes.c.term + 1, **values})
    term: int = connection.execute(elected.returning(processes.c.term)).scalar_one()
    return term


def confirm(connection: Connection, name: str, term: int) -> None:
    """Makes sure that a process may write: to be the first statement of each of its transactions.

    No other process is elected before the transaction has ended. Raises SupersededError if one was.
    """
    current = connection.scalar(_CONFIRM, {"process": name})
    if current != term:
        raise SupersededError(f"another {name} was elected (term {current}, this one had {term}); this one writes nothing more")


def term_in_office(connection: Connection) -> int:
    """Returns the dispatcher's current term; 0 before the first election."""
    return connection.scalar(_TERM, {"process": DISPATCHER}) or 0


_TERM = select(processes.c.term).where(processes.c.name == bindparam("process"))
_CONFIRM = _TERM.with_for_update(read=True, key_share=True)


def heartbeat(connection: Connection, name: str, pid: int, started_at: datetime, detail: Mapping[str, Any]) -> None:
    """Says that the process lives, and how it is. A new process of the same name takes the place of the one before; its term stays."""
    values = {"pid": pid, "started_at": started_at, "heartbeat_at": now(), "detail": dict(detail)}
    statement = insert(connection, processes).values(name=name, **values)
    connection.execute(statement.on_conflict_do_update(index_elements=["name"], set_=values))


def read(connection: Connection, name: str) -> StoredProcess | None:
    """Returns the last message of a process; None before the first."""
    row = connection.execute(select(processes).where(processes.c.name == name)).one_or_none()
    return None if row is None else record(StoredProcess, row)
