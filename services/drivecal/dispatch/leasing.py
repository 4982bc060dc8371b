"""The pool's leases, in the database."""

from __future__ import annotations

from collections.abc import Mapping

from drivecal.execution.measures import MEASURES
from drivecal.storage import leases
from drivecal.storage.engine.database import Database


class StoredLeases:
    """Implements `drivecal.execution.leasing.Leases`."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def exchange(self, returned: Mapping[int, int], wanted: Mapping[int, int], seconds: float) -> Mapping[int, int]:
        """Updates leases in one transaction. Raises UnavailableError, and SupersededError if another dispatcher was elected."""
        with MEASURES.timed("lease"), self._database.transaction() as connection:
            leases.give_back(connection, returned)
            return leases.take(connection, wanted, seconds)
