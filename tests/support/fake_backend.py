"""A backend in memory, on virtual time, whose cells misbehave as their parameters say."""

import heapq
from dataclasses import dataclass, field, replace
from enum import IntEnum

from drivecal.contracts.work import Batch, BatchResult, Cell, CellResult, SetupKey
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.backend import Finished, Lost, Slot, WorkerInfo
from drivecal.execution.worker_process import Call, WorkerProcess


class Behaviour(IntEnum):
    """Behaviour of a cell, given as its parameter `behaviour`; the plug-in of the Ray tests uses the same numbers."""

    WELL = 0
    CRASH = 1
    HANG = 2
    ERROR = 3
    MEMORY = 4


def behaviour_of(cell: Cell) -> Behaviour:
    return Behaviour(int(cell.parameters.get("behaviour", 0)))


@dataclass(slots=True)
class _Worker(WorkerProcess):
    """A worker; each of its calls refers to its batch."""

    ready_at: float = 0.0
    begun_at: float = 0.0
    refusal: str | None = None
    tools: str | None = None
    busy: str | None = None
    bad: bool = False
    """Its cells fail in the running batch."""


@dataclass
class FakeBackend:
    """`workers` of one simulated machine; `seconds_per_cell` by scenario; a hang is noticed `deadline` seconds later."""

    n_workers: int = 2
    seconds_per_cell: dict[str, float] = field(default_factory=dict)
    deadline: float = 60.0
    restart_seconds: float = 1.6
    overhead_seconds: float = 0.001
    now: float = 0.0
    busy_seconds: float = 0.0
    attempts: dict[int, int] = field(default_factory=dict)
    """How often each cell was begun."""
    sizes: list[tuple[float, str, int]] = field(default_factory=list)
    """(when, scenario, cells) of each batch sent."""
    bad: set[int] = field(default_factory=set)
    """Places (from 1) whose workers answer every cell with an error, at once."""
    refusing: dict[int, str] = field(default_factory=dict)
    """Places whose workers refuse every setup, and why."""
    blaming: set[int] = field(default_factory=set)
    """Refusing workers that blame the problem's files."""
    nodes: dict[int, str] = field(default_factory=dict)
    """Nodes of places; "here" elsewhere."""
    replaced: list[tuple[str, str | None]] = field(default_factory=list)
    """Worker and fault of each replacement that was asked for."""
    tools: dict[int, str] = field(default_factory=dict)
    """Answers of probes by place, "1.0" by default."""
    busy_until: dict[str, float] = field(default_factory=dict)
    """Time until which the simulators of a scenario are busy."""
    linger_seconds: float = 0.0
    """How long runs go on after their worker is killed."""
    held: list[tuple[float, int]] = field(default_factory=list)
    """Licences in use, as the license server counts them, at each change."""
    running: list[tuple[float, float]] = field(default_factory=list)
    """Begin and end of each batch that ran with a licence."""
    closed: bool = False

    def __post_init__(self) -> None:
        places = range(1, self.n_workers + 1)
        self._workers = [
            _Worker(place, incarnation=1, handle="a process", node=self.nodes.get(place, "here")) for place in places
        ]
        self._events: list[tuple[float, int, _Worker]] = []
        self._late: list[Finished | Lost] = []
        self._ended: list[Call] = []
        self._sequence = 0
        self._open: dict[str, dict[SetupKey, int]] = {}
        """Licences of open sessions by worker."""
        self._lingering: list[tuple[float, int]] = []

    def _count(self) -> None:
        self._lingering = [(until, count) for until, count in self._lingering if until > self.now]
        sessions = sum(count for held in self._open.values() for count in held.values())
        self.held.append((self.now, sessions + sum(count for _, count in self._lingering)))

    def submit(self, worker: str, batch_id: int, batch: Batch, expected_seconds: float | None, *, alone: bool = False) -> None:
        chosen = self._named(worker)
        assert self._room(chosen, alone=alone), f"{worker} has no slot"
        chosen.take(Call(batch_id, len(batch.cells), batch.setup.scenario, batch, 0.0, expected_seconds or 0.0), alone=alone)
        self.sizes.append((self.now, batch.setup.scenario, len(batch.cells)))
        if len(chosen.calls) == 1:
            self._begin(chosen)

    def wait(self, timeout: float) -> list[Finished | Lost]:
        until = self.now + timeout
        result, self._late = self._late, []
        if not result and self._events and self._events[0][0] <= until:
            self.now = self._events[0][0]
            while self._events and self._events[0][0] <= self.now:
                result += self._end(heapq.heappop(self._events)[2])
        elif not result:
            self.now = until
        return result

    def slots(self) -> list[Slot]:
        result = [Slot(worker.name, not worker.calls) for worker in self._workers if self._room(worker, alone=False)]
        return sorted(result, key=lambda slot: not slot.idle)

    def workers(self) -> list[WorkerInfo]:
        starting = {worker.index: {"state": "starting"} for worker in self._workers if worker.ready_at > self.now}
        return [WorkerInfo.of(worker, id=worker.name, **starting.get(worker.index, {})) for worker in self._workers]

    def replace(self, worker: str, fault: str | None) -> None:
        chosen = self._named(worker)
        assert self._room(chosen, alone=True), f"{worker} is not idle"
        self.replaced.append((worker, fault))
        chosen.reason = fault or ""
        self._restart(chosen)

    def trouble(self) -> str | None:
        return next((f"{worker.name}: {worker.reason}" for worker in self._workers if worker.reason), None)

    def close(self) -> None:
        self.closed = True

    def kill(self, index: int) -> None:
        """Ends a worker, as a kill from outside does."""
        worker = self._workers[index % len(self._workers)]
        self._events = [event for event in self._events if event[2] is not worker]
        heapq.heapify(self._events)
        self._lingering += [(self.now + self.linger_seconds, count) for count in self._open.get(worker.name, {}).values()]
        self._late += self._lose(worker, Breakdown.CRASH, departed=True)

    def repeat(self, index: int) -> None:
        """The result of a batch that was given up, or came back already, arrives late."""
        if self._ended:
            call = self._ended[index % len(self._ended)]
            answers = tuple(map(_answer, call.reference.cells))
            self._late.append(Finished(call.batch_id, BatchResult("ghost", answers, 0.1)))

    def _named(self, name: str) -> _Worker:
        return next(worker for worker in self._workers if worker.name == name)

    def _restart(self, worker: _Worker) -> None:
        worker.incarnation += 1
        worker.ready_at = self.now + self.restart_seconds

    def _room(self, worker: _Worker, *, alone: bool) -> bool:
        return worker.ready_at <= self.now and worker.room(alone=alone)

    def _begin(self, worker: _Worker) -> None:
        batch: Batch = worker.calls[0].reference
        seconds = self.overhead_seconds
        if batch.cells and batch.setup.resources and self.busy_until.get(batch.setup.scenario, 0.0) <= self.now:
            self._open.setdefault(worker.name, {})[batch.setup.key] = sum(batch.setup.resources.values())
            self._count()
        worker.begun_at = self.now
        worker.refusal, worker.bad = self.refusing.get(worker.index), worker.index in self.bad
        wanted = None if batch.setup.bundle is None else batch.setup.tools
        worker.tools = self.tools.get(worker.index, "1.0") if batch.cells == () or wanted is not None else None
        if worker.refusal is None and wanted not in {None, worker.tools}:
            worker.refusal = f"the probe answers {worker.tools} and {wanted}"
        worker.busy = "no licence" if self.busy_until.get(batch.setup.scenario, 0.0) > self.now else None
        for cell in batch.cells if worker.refusal is None and worker.busy is None else ():
            self.attempts[cell.id] = self.attempts.get(cell.id, 0) + 1
            behaviour = behaviour_of(cell)
            if worker.bad:
                continue
            seconds += self.deadline if behaviour is Behaviour.HANG else self.seconds_per_cell.get(batch.setup.scenario, 0.007)
            if behaviour in {Behaviour.HANG, Behaviour.CRASH}:
                break
        self._sequence += 1
        heapq.heappush(self._events, (self.now + seconds, self._sequence, worker))

    def _end(self, worker: _Worker) -> list[Finished | Lost]:
        batch: Batch = worker.calls[0].reference
        refusal, bad, busy = worker.refusal, worker.bad, worker.busy
        sessions = self._open.get(worker.name, {})
        if batch.cells and batch.setup.key in sessions:
            self.running.append((worker.begun_at, self.now))
        if batch.closes or not batch.setup.keeps_resources:
            sessions.pop(batch.setup.key, None)
            self._count()
        behaviours = [] if bad or refusal is not None or busy is not None else [behaviour_of(cell) for cell in batch.cells]
        for behaviour, breakdown in ((Behaviour.CRASH, Breakdown.CRASH), (Behaviour.HANG, Breakdown.HANG)):
            if behaviour in behaviours:
                return self._lose(worker, breakdown)
        call = worker.next_call()
        self._ended.append(call)
        worker.cells += call.cells
        seconds = self.now - worker.begun_at
        self.busy_seconds += seconds
        if worker.calls:
            self._begin(worker)
        if refusal is not None:
            tools = worker.tools if worker.index not in self.refusing else None
            blames = worker.index in self.blaming
            return [Finished(call.batch_id, BatchResult(worker.name, (), seconds, refusal, tools=tools, unsuitable=blames))]
        if busy is not None:
            return [Finished(call.batch_id, BatchResult(worker.name, (), seconds, busy=busy))]
        if not batch.cells:
            return [Finished(call.batch_id, BatchResult(worker.name, (), seconds, tools=worker.tools))]
        answers = tuple(_error(cell, "SUMO is gone") if bad else _answer(cell) for cell in batch.cells)
        if any(answer.breakdown is None for answer in answers):
            worker.reason = ""
        return [Finished(call.batch_id, BatchResult(worker.name, answers, seconds))]

    def _lose(self, worker: _Worker, breakdown: Breakdown, *, departed: bool = False) -> list[Finished | Lost]:
        self._open.pop(worker.name, None)
        begun: dict[int, int] = {}
        for cell in worker.calls[0].reference.cells if worker.calls else ():
            begun[cell.id] = 1
            if behaviour_of(cell) in {Behaviour.CRASH, Behaviour.HANG}:
                break
        self._ended += worker.calls
        lost = worker.lose(breakdown, "it died", departed=departed)
        self._restart(worker)
        self._sequence += 1
        return [replace(each, seconds=None, starts=begun if each.begun else None) for each in lost]


def _error(cell: Cell, detail: str) -> CellResult:
    return CellResult(cell.id, None, None, {}, None, 1.0, Breakdown.ERROR.value, detail)


def _answer(cell: Cell) -> CellResult:
    behaviour = behaviour_of(cell)
    if behaviour in {Behaviour.ERROR, Behaviour.MEMORY}:
        breakdown = Breakdown.ERROR if behaviour is Behaviour.ERROR else Breakdown.MEMORY
        return CellResult(cell.id, None, None, {}, None, 1.0, breakdown.value, "ValueError: as asked for")
    value = float(cell.parameters.get("value", 0.0))
    return CellResult(cell.id, value, round(value), {"value": value}, None, 7.0)
