"""The port through which the pool makes sure that a cell is at one place only, and that its breakdowns are remembered."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol


class Leases(Protocol):
    """Leases cells before they are sent. What is leased stays so until its answer is stored, or until it is given back."""

    def exchange(self, returned: Mapping[int, int], wanted: Mapping[int, int], seconds: float) -> Mapping[int, int]:
        """Gives back the leases of the cells in `returned`, then leases those in `wanted` for so many `seconds`, all or nothing.

        Both say by cell id how often the cell broke down so far. Gives the number of the lease of each cell that was granted: the others
        belong to another process or have an answer. Raises UnavailableError if the outcome is unknown: to be done again
        with what was wanted given back.
        """
