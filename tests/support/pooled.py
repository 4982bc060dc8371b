"""Work of a pool on a backend of the test's own, and all of its answers."""

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

from tests.support.fake_backend import Behaviour

from drivecal.contracts.work import Cell
from drivecal.domain.errors import UnavailableError
from drivecal.execution.pool import Leases, WorkPool
from drivecal.execution.scheduling.in_flight import Completed


def cells(behaviours: Sequence[Behaviour], first: int = 1) -> list[Cell]:
    """No two are identical: they would be simulated once."""
    return [
        Cell(first + index, {"behaviour": float(behaviour), "value": float(first + index)})
        for index, behaviour in enumerate(behaviours)
    ]


TAGS = ("a", "b", "c", "test", "others", "campaign-7")
"""All that these tests use."""


def drain(pool: WorkPool) -> list[Completed]:
    """All answers; goes on while the database does not answer."""
    completed: list[Completed] = []
    for _ in range(100_000):
        if not any(pool.held(tag) for tag in TAGS):
            return completed
        with suppress(UnavailableError):
            completed += pool.poll(1.0)
    raise AssertionError(f"never back: { ({tag: pool.held(tag) for tag in TAGS}) }; {pool.workers()}; {pool.trouble()}")


@dataclass
class MemoryLeases(Leases):
    """Leases in memory. `fails`: the next exchanges, one entry each, fail before (`before`) or after (`after`) they were done. `denied`:
    never granted."""

    fails: list[str] = field(default_factory=list)
    denied: set[int] = field(default_factory=set)
    held: dict[int, int] = field(default_factory=dict)
    """The numbers of the leases that are not given back."""
    numbers: dict[int, int] = field(default_factory=dict)
    breakdowns: dict[int, int] = field(default_factory=dict)
    exchanges: list[tuple[dict[int, int], dict[int, int]]] = field(default_factory=list)
    starts: Counter[int] = field(default_factory=Counter)
    """Starts of the simulator by cell that happened."""

    def exchange(
        self, returned: Mapping[int, int], wanted: Mapping[int, int], *, unstarted: Mapping[int, int], **_: object
    ) -> Mapping[int, int]:
        failure = self.fails.pop(0) if self.fails else ""
        if failure == "before":
            raise UnavailableError("the database does not answer")
        self.exchanges.append((dict(returned), dict(wanted)))
        self.starts.subtract(unstarted)
        for cell, count in returned.items():
            if cell in self.numbers:
                self.held.pop(cell, None)
                self.breakdowns[cell] = count
        granted = [cell for cell in wanted if cell not in self.held and cell not in self.denied]
        for cell in granted:
            self.held[cell] = self.numbers[cell] = self.numbers.get(cell, 0) + 1
            self.breakdowns[cell] = wanted[cell]
            self.starts[cell] += 1
        if failure == "after":
            raise UnavailableError("the answer to the commit was lost")
        return {cell: self.numbers[cell] for cell in granted}
