"""Workers on virtual time around a bare scheduler, whose cells cost what a test says and always succeed."""

import heapq
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field

from tests.support.setups import bare as setup

from drivecal.contracts.work import BatchResult, Cell, CellResult
from drivecal.execution.backend import LONGEST_QUEUED
from drivecal.execution.scheduling.in_flight import Completed, Dispatch, Work
from drivecal.execution.scheduling.scheduler import Scheduler

W, V = "worker 1", "worker 2"


def cells(count: int, first: int = 1, values: Sequence[float] | None = None) -> list[Cell]:
    """With the numbers from `first` as ids and, where no `values` are given, as parameters: no two are identical."""
    return [Cell(first + index, {"P1": float(first + index) if values is None else values[index]}) for index in range(count)]


def send(scheduler: Scheduler, worker: str = W) -> Dispatch:
    """Takes the next batch of an idle worker, which there has to be."""
    dispatch = scheduler.next_batch(worker, idle=True)
    assert dispatch is not None
    return dispatch


def answers(dispatch: Dispatch, seconds: float = 0.1) -> BatchResult:
    """Returns what a worker makes of a batch: the parameter is the rating."""
    return BatchResult(dispatch.worker, tuple(map(answer, dispatch.batch.cells)), seconds)


def answer(cell: Cell) -> CellResult:
    return CellResult(cell.id, cell.parameters["P1"], 5, {}, None, 7.0)


def ids(dispatch: Dispatch | None) -> list[int]:
    return [] if dispatch is None else [cell.id for cell in dispatch.batch.cells]


@dataclass
class Plant:
    """`cost`: seconds per cell by scenario. Every worker holds a batch and one behind it, unless the first is expected to take long."""

    workers: int = 1
    cost: dict[str, float] = field(default_factory=dict)
    scheduler: Scheduler = field(default_factory=Scheduler)
    of_users: bool = False
    """True if the scenarios belong to user problems: the scheduler then queues nothing behind cells of unknown cost."""
    now: float = 0.0
    given: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    """Worker time by tag, what is running included."""
    order: list[tuple[str, str, int]] = field(default_factory=list)
    """(tag, scenario, cells) of each batch."""
    loads: Counter[str] = field(default_factory=Counter)
    """How often each worker was sent another setup than before."""
    completed: list[Completed] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.names = [f"worker {index}" for index in range(1, self.workers + 1)]
        self.scheduler.meet(self.names)
        self._free_at = dict.fromkeys(self.names, 0.0)
        self._held = dict.fromkeys(self.names, 0)
        self._long: dict[int, str] = {}
        self._last: dict[str, str] = {}
        self._ends: list[tuple[float, int, Dispatch]] = []
        self._owners: dict[int, str] = {}

    def add(self, tag: str, scenario: str, new: list[Cell], priority: int = 0) -> None:
        self._owners |= {cell.id: tag for cell in new}
        self.scheduler.add(Work(setup(scenario), new), tag, priority)

    def fill(self) -> None:
        """Sends what there is room for."""
        self.scheduler.meet(self.names, now=self.now)
        for room in (1, 2):
            for worker in self.names:
                while self._held[worker] < (1 if worker in self._long.values() else room) and (
                    dispatch := self.scheduler.next_batch(worker, idle=self._held[worker] == 0)
                ):
                    self._send(dispatch)

    def step(self) -> bool:
        """Until the next batch comes back; False where none does."""
        self.fill()
        if not self._ends:
            return False
        self.now, _, dispatch = heapq.heappop(self._ends)
        self._held[dispatch.worker] -= 1
        self._long.pop(dispatch.batch_id, None)
        self.completed += self.scheduler.finished(dispatch.batch_id, answers(dispatch, self._seconds(dispatch)))
        return True

    def run(self, until: float = float("inf")) -> None:
        while self.now < until and self.step():
            pass

    def _send(self, dispatch: Dispatch) -> None:
        worker, scenario = dispatch.worker, dispatch.batch.setup.scenario
        seconds = self._seconds(dispatch)
        tag = self._owners[dispatch.batch.cells[0].id]
        self.given[tag] += seconds
        self.order.append((tag, scenario, len(dispatch.batch.cells)))
        self.loads[worker] += self._last.get(worker) != scenario
        self._last[worker] = scenario
        self._held[worker] += 1
        unknown = float("inf") if self.of_users else 0.0
        if (unknown if dispatch.expected_seconds is None else dispatch.expected_seconds) > LONGEST_QUEUED:
            self._long[dispatch.batch_id] = worker
        self._free_at[worker] = max(self.now, self._free_at[worker]) + seconds
        heapq.heappush(self._ends, (self._free_at[worker], dispatch.batch_id, dispatch))

    def _seconds(self, dispatch: Dispatch) -> float:
        return len(dispatch.batch.cells) * self.cost.get(dispatch.batch.setup.scenario, 0.007)
