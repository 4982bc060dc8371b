"""The time in which a process is its database's dispatcher: from its election until another one is elected."""

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
    """Its number, `term`, and when it began."""

    term: int
    began_at: datetime

    @classmethod
    def begin(cls, database: Database) -> Leadership:
        """Has this process elected; to be called by who holds the lock. From now on no other one writes anything."""
        began_at = now()
        with database.transaction() as connection:
            return cls(processes.elect(connection, DISPATCHER, os.getpid(), began_at), began_at)

    def fence(self, connection: Connection) -> None:
        """Raises SupersededError where it is over; see `Database.fenced`."""
        processes.confirm(connection, DISPATCHER, self.term)
