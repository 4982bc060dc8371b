"""A backend whose simulation is a formula, so that whole campaigns run in a second; it answers in whatever order its seed says."""

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from drivecal.contracts.work import Batch, BatchResult, Cell, CellResult, SetupRequest
from drivecal.execution.backend import Finished, Lost, Slot, WorkerInfo

IGNORED = {"S1": "P9", "S2": "P10"}
"""Parameters that the formula does not look at, by scenario."""


def rating_of(scenario: str, cell: Cell) -> float:
    """0..7 with plateaus, different in every scenario."""
    number = int(scenario.removeprefix("S"))
    spread: float = sum(
        ((index * number) % 5 + 1) * ((value * (1 + index / 7)) % 1.7)
        for index, (name, value) in enumerate(cell.parameters.items())
        if IGNORED.get(scenario) != name
    )
    return float(7.0 * ((spread * 0.37) % 1.0))


def computed(scenario: str, cell: Cell) -> CellResult:
    """The result of one cell."""
    rating = rating_of(scenario, cell)
    failure = "collision" if rating < 0.7 else None
    score = 0 if failure else round(rating)
    return CellResult(cell.id, 0.0 if failure else rating, score, {"rating": rating}, failure, 7.0)


@dataclass
class ComputedBackend:
    """`answer` computes a cell; `sent` lists every cell that was asked for, again and again where it was asked for again."""

    seed: int = 0
    answer: Callable[[str, Cell], CellResult] = computed
    driven: Callable[[Any, Cell], CellResult] | None = None
    """In its place where the answer depends on the vehicle."""
    count: int = 1
    """Number of workers, which have eight places in all if there is one, and one each if there are several."""
    held: bool = False
    """True while it gives nothing back."""
    sent: list[tuple[str, tuple[float, ...]]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)
        self._outstanding: list[tuple[int, Batch]] = []
        self._incarnation = 1

    def submit(self, worker: str, batch_id: int, batch: Batch, expected_seconds: float | None, *, alone: bool = False) -> None:
        del worker, expected_seconds, alone
        self._outstanding.append((batch_id, batch))
        self.sent += [(batch.setup.scenario, tuple(cell.parameters.values())) for cell in batch.cells]

    def wait(self, timeout: float) -> list[Finished | Lost]:
        del timeout
        if self.held:
            return []
        self._random.shuffle(self._outstanding)
        share = self._random.randint(0, len(self._outstanding))
        done, self._outstanding = self._outstanding[:share], self._outstanding[share:]
        return [
            Finished(batch_id, BatchResult(self._name, tuple(self._answer(batch.setup, cell) for cell in batch.cells), 0.01))
            for batch_id, batch in done
        ]

    def _answer(self, setup: SetupRequest, cell: Cell) -> CellResult:
        return self.driven(setup, cell) if self.driven else self.answer(setup.scenario, cell)

    def slots(self) -> list[Slot]:
        names = [self._name] * 8 if self.count == 1 else self._names
        return [Slot(name, idle=True) for name in names[len(self._outstanding) :]]

    def workers(self) -> list[WorkerInfo]:
        return [WorkerInfo(id=name, node="here", state="idle", cells=len(self.sent)) for name in self._names]

    def replace(self, worker: str, fault: str | None) -> None:
        del worker, fault
        self._incarnation += 1

    @property
    def _names(self) -> list[str]:
        return [self._name, *(f"worker-{number}-more" for number in range(2, self.count + 1))]

    @property
    def _name(self) -> str:
        return f"worker-{self._incarnation}"

    def trouble(self) -> str | None:
        return None

    def close(self) -> None:
        self._outstanding.clear()
