"""Parts of tests: what the state machine of `tests.support.turmoil` plays with: cells in a database, workers, and their answers."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field

from tests.support.fake_backend import Behaviour

from drivecal.contracts.work import Cell, CellResult
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.scheduling.in_flight import Dispatch

DEADLINE, RESTART = 60.0, 1.6
"""Seconds that a batch may take, and that a new worker needs to start."""
POISON = {7: Behaviour.CRASH, 8: Behaviour.HANG, 9: Behaviour.ERROR, 10: Behaviour.MEMORY}
"""Behaviour by value of a parameter; cells with other values succeed."""


@dataclass
class Row:
    """A cell in the database."""

    id: int
    tag: str
    scenario: str
    value: int
    priority: int
    exclusive: bool
    breakdowns: int = 0
    """As written down."""
    withdrawn: bool = False

    @property
    def identity(self) -> Hashable:
        return self.id if self.exclusive else (self.scenario, self.value)


@dataclass
class Place:
    """A worker and its replacements."""

    number: int
    incarnation: int = 1
    ready_at: float = 0.0
    batches: list[Dispatch] = field(default_factory=list)
    deadline: float = 0.0
    """Deadline of the first batch."""

    @property
    def name(self) -> str:
        return f"worker-{self.number}.{self.incarnation}"


def broken_result(cell: Cell, breakdown: Breakdown) -> CellResult:
    return CellResult(cell.id, None, None, {}, None, 1.0, breakdown.value, "as asked for")


def assert_batch(sent: Dispatch, rows: Sequence[Row]) -> None:
    """AssertionError if a batch does not consist of what these rows ask for, each once and none in vain."""
    assert {row.id: row.value for row in rows} == {cell.id: cell.parameters["P1"] for cell in sent.batch.cells}
    assert not any(row.withdrawn for row in rows)
    assert {(row.tag, row.scenario, row.priority) for row in rows} == {
        (rows[0].tag, sent.batch.setup.scenario, rows[0].priority)
    }
    assert len({row.identity for row in rows}) == len(rows)
    if any(sent.breakdowns.values()):
        assert sent.alone
    if sent.alone:
        assert len(rows) == 1
