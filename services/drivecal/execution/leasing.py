"""Leases: a cell is at one place only, and its breakdowns are remembered."""

from collections.abc import Mapping
from typing import Protocol

from drivecal.execution.measures import MEASURES
from drivecal.storage import leases
from drivecal.storage.engine.database import Database


class Leases(Protocol):
    """Leases cells before they are sent. A lease holds until the cell's answer is stored, or until it is given back."""

    def exchange(self, returned: Mapping[int, int], wanted: Mapping[int, int], seconds: float) -> Mapping[int, int]:
        """Gives back the leases of the cells in `returned`, then leases those in `wanted` for `seconds`, all or nothing.

        Both map cell ids to the number of breakdowns so far. Returns the lease number of each granted cell; the others belong to another
        process or have an answer. Raises UnavailableError if the outcome is unknown: call it again with the wanted cells given back.
        """


class StoredLeases:
    """Leases in the database."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def exchange(self, returned: Mapping[int, int], wanted: Mapping[int, int], seconds: float) -> Mapping[int, int]:
        """Updates leases in one transaction. Raises UnavailableError, and SupersededError if another dispatcher was elected."""
        with MEASURES.timed("lease"), self._database.transaction() as connection:
            leases.give_back(connection, returned)
            return leases.take(connection, wanted, seconds)
