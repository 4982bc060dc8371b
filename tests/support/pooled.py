"""Work of a pool on a backend of the test's own, and all of its answers."""

from collections.abc import Sequence

from tests.support.fake_backend import Behaviour

from drivecal.contracts.work import Cell
from drivecal.execution.pool import WorkPool
from drivecal.execution.scheduling.in_flight import Completed


def cells(behaviours: Sequence[Behaviour], first: int = 1) -> list[Cell]:
    """No two are identical: they would be simulated once."""
    return [
        Cell(first + index, {"behaviour": float(behaviour), "number": float(first + index)})
        for index, behaviour in enumerate(behaviours)
    ]


TAGS = ("a", "b", "c", "others", "campaign-7")
"""All that these tests use."""


def drain(pool: WorkPool, patience: int = 100_000) -> list[Completed]:
    completed: list[Completed] = []
    for _ in range(patience):
        if not any(pool.held(tag) for tag in TAGS):
            return completed
        completed += pool.poll(1.0)
    raise AssertionError(f"cells never came back: { ({tag: pool.held(tag) for tag in TAGS}) }")
