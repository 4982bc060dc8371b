"""Leases in memory that fail when they are told to."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from drivecal.domain.errors import UnavailableError
from drivecal.execution.pool import Leases


@dataclass
class MemoryLeases(Leases):
    """`fails`: the next exchanges, one entry each, fail before (`before`) or after (`after`) they were done. `denied`: never granted."""

    fails: list[str] = field(default_factory=list)
    denied: set[int] = field(default_factory=set)
    held: dict[int, int] = field(default_factory=dict)
    """The numbers of the leases that are not given back."""
    numbers: dict[int, int] = field(default_factory=dict)
    breakdowns: dict[int, int] = field(default_factory=dict)
    exchanges: list[tuple[dict[int, int], dict[int, int], float]] = field(default_factory=list)

    def exchange(
        self, returned: Mapping[int, int], wanted: Mapping[int, int], seconds: float, **_: object
    ) -> Mapping[int, int]:
        failure = self.fails.pop(0) if self.fails else ""
        if failure == "before":
            raise UnavailableError("the database does not answer")
        self.exchanges.append((dict(returned), dict(wanted), seconds))
        for cell, count in returned.items():
            if cell in self.numbers:
                self.held.pop(cell, None)
                self.breakdowns[cell] = count
        granted = [cell for cell in wanted if cell not in self.held and cell not in self.denied]
        for cell in granted:
            self.held[cell] = self.numbers[cell] = self.numbers.get(cell, 0) + 1
            self.breakdowns[cell] = wanted[cell]
        if failure == "after":
            raise UnavailableError("the answer to the commit was lost")
        return {cell: self.numbers[cell] for cell in granted}
