"""The leadership of a dispatcher, from its election until the next election."""

from __future__ import annotations

import os
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import Connection

from drivecal.storage import processes
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now
from drivecal.storage.processes import DISPATCHER


@dataclass(frozen=True, slots=True)
class Leadership:
    """A dispatcher's `term` number and start time."""

    term: int
    began_at: datetime

    @classmethod
    def begin(cls, database: Database) -> Leadership:
        """Elects this process; from now on no other process writes. The caller must hold the lock."""
        began_at = now()
        with database.transaction() as connection:
            return cls(processes.elect(connection, DISPATCHER, os.getpid(), began_at), began_at)

    def fence(self, connection: Connection) -> None:
        """Raises SupersededError if the leadership is over; see `Database.fenced`."""
        processes.confirm(connection, DISPATCHER, self.term)
