"""Promises of every backend to the work pool."""

import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.support.fake_backend import Behaviour, FakeBackend
from tests.support.pooled import MemoryLeases
from tests.support.pooled import cells as behaving
from tests.support.setups import ARCHIVES, misbehaving_setup

from drivecal.bundles import archives
from drivecal.contracts.work import Batch, Cell, SetupRequest
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.backend import LONGEST_QUEUED, Backend, Finished, Lost
from drivecal.execution.pool import WorkPool
from drivecal.execution.scheduling.in_flight import Completed, Work

WELL, CRASH, HANG, ERROR, MEMORY = Behaviour
PLENTY = 10.0
"""Expected seconds that give a first batch, which compiles, a generous deadline."""


@pytest.fixture(params=["fake", "processes", "ray"])
def backend(request: pytest.FixtureRequest) -> Iterator[Backend]:
    chosen: Backend = FakeBackend(2) if request.param == "fake" else request.getfixturevalue(f"{request.param}_backend")
    wait_for_idle(chosen)
    yield chosen
    wait_for_idle(chosen)


def wait_for_idle(backend: Backend) -> None:
    for _ in range(600):  # on a busy machine, where a worker takes long to start
        if [slot.idle for slot in backend.slots()] == [True, True]:
            return
        backend.wait(0.5)
    raise AssertionError(f"workers never became idle: {backend.workers()}; {backend.trouble()}")


def batch(*behaviours: Behaviour, first: int = 1) -> Batch:
    return Batch(misbehaving_setup(), tuple(behaving(behaviours, first)))


def send(backend: Backend, batch_id: int, batch: Batch, expected: float | None = PLENTY, *, alone: bool = False) -> str:
    """To an idle worker where there is one. Returns its name."""
    worker = backend.slots()[0].worker
    backend.submit(worker, batch_id, batch, expected, alone=alone)
    return worker


def room(backend: Backend) -> tuple[int, int]:
    """How many workers are idle, and how many busy ones take a batch behind theirs."""
    slots = backend.slots()
    idle = sum(slot.idle for slot in slots)
    assert [slot.idle for slot in slots] == [True] * idle + [False] * (len(slots) - idle)
    return idle, len(slots) - idle


def collect(backend: Backend, count: int) -> dict[int, Finished | Lost]:
    result: dict[int, Finished | Lost] = {}
    for _ in range(600):
        for event in backend.wait(0.5):
            assert event.batch_id not in result, "a batch came back twice"
            result[event.batch_id] = event
        if len(result) == count:
            return result
    raise AssertionError(f"only {sorted(result)} came back")


def test_a_batch_comes_back_with_its_results_in_order(backend: Backend) -> None:
    worker = send(backend, 1, batch(WELL, WELL, WELL, first=11))
    assert [each.scenario for each in backend.workers() if each.since is not None] == ["S1"]
    event = collect(backend, 1)[1]
    assert isinstance(event, Finished)
    assert [result.id for result in event.result.results] == [11, 12, 13]
    assert all(result.breakdown is None and result.metrics for result in event.result.results)
    assert event.result.seconds > 0
    assert event.result.worker == worker


def test_every_worker_takes_one_batch_and_one_behind_it(backend: Backend) -> None:
    assert room(backend) == (2, 0)
    send(backend, 1, batch(WELL))
    assert room(backend) == (1, 1)
    send(backend, 2, batch(WELL))
    assert room(backend) == (0, 2)
    send(backend, 3, batch(WELL))
    send(backend, 4, batch(WELL))
    assert room(backend) == (0, 0)
    events = collect(backend, 4)
    assert all(isinstance(event, Finished) for event in events.values())
    assert len({event.result.worker for event in events.values() if isinstance(event, Finished)}) == 2


def test_nothing_is_queued_behind_a_batch_that_is_alone(backend: Backend) -> None:
    send(backend, 1, batch(WELL), alone=True)
    assert room(backend) == (1, 0)
    collect(backend, 1)


def test_nothing_is_queued_behind_a_batch_that_is_expected_to_take_long(backend: Backend) -> None:
    send(backend, 1, batch(WELL), expected=2 * LONGEST_QUEUED)
    assert room(backend) == (1, 0)
    collect(backend, 1)


def test_exceptions_and_lack_of_memory_in_a_cell_cost_neither_worker_nor_neighbours(backend: Backend) -> None:
    before = [worker.id for worker in backend.workers()]
    send(backend, 1, batch(WELL, ERROR, WELL, MEMORY, WELL))
    event = collect(backend, 1)[1]
    assert isinstance(event, Finished)
    assert [result.breakdown for result in event.result.results] == [None, "error", None, "memory", None]
    assert "ValueError: as asked for" in (event.result.results[1].detail or "")
    assert [worker.id for worker in backend.workers()] == before


BUSY = {
    "command": """[ -e {free} ] || {{ echo no licence >&2; exit 75; }}; echo '{{"measures": {{"y": 1}}}}' > "$1" """,
    "process": """import json, os, sys
print('{{"ready": true}}', flush=True)
for line in sys.stdin:
    request = json.loads(line)
    if "id" in request:
        answer = {{"measures": {{"y": 1.0}}}} if os.path.exists("{free}") else {{"busy": "no licence"}}
        print(json.dumps(answer | {{"id": request["id"]}}), flush=True)
""",
}
COMMANDS = {"command": ["sh", "./sim", "{results}"], "process": [sys.executable, "-S", "./sim"]}


@pytest.mark.slow("ray")
@pytest.mark.parametrize("kind", BUSY)
@pytest.mark.parametrize("real", ["processes", "ray"])
def test_a_busy_simulator_costs_no_attempt(real: str, kind: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    backend = request.getfixturevalue(f"{real}_backend")
    wait_for_idle(backend)
    folder, free = tmp_path / "bundle", tmp_path / "free"
    folder.mkdir()
    (folder / "problem.yaml").write_text("problem: busy\n")
    (folder / "sim").write_text(BUSY[kind].format(free=free))
    archive = archives.pack(folder)
    bundle = archives.content_digest(archive)
    ARCHIVES[bundle] = archive
    section = {"kind": kind, "command": COMMANDS[kind], "timeout": 60.0, "memory_mb": 1000}
    setup = SetupRequest(bundle, "busy", "city", {}, section, ("x",), (), ("y",), (), (), "f")
    pool = WorkPool(backend, MemoryLeases())
    pool.submit(Work(setup, tuple(Cell(number, {"x": float(number)}) for number in range(1, 5))), tag="a")
    completed: list[Completed] = []
    for _ in range(600):
        completed += pool.poll(0.5)
        if (reason := pool.waits("a")) is not None and not free.exists():
            assert "no licence" in reason
            assert not completed
            free.touch()
        if len(completed) == 4:
            break
    assert free.exists(), "the reason was never said"
    assert [(each.result.breakdown, each.attempts) for each in completed] == [(None, 1)] * 4


@pytest.mark.slow("ray")
def test_a_crash_loses_what_the_worker_had_and_nothing_else(backend: Backend) -> None:
    send(backend, 1, batch(WELL, CRASH, WELL))
    send(backend, 2, batch(WELL, WELL))
    send(backend, 3, batch(WELL))
    send(backend, 4, batch(WELL))
    events = collect(backend, 4)
    lost = {number: event for number, event in events.items() if isinstance(event, Lost)}
    assert 1 in lost
    assert len(lost) == 2  # the one behind it went along
    assert {event.breakdown for event in lost.values()} == {Breakdown.CRASH}
    assert lost[1].detail
    wait_for_idle(backend)  # it was replaced
    send(backend, 5, batch(WELL))
    send(backend, 6, batch(WELL))
    assert all(isinstance(event, Finished) for event in collect(backend, 2).values())


@pytest.mark.slow
def test_a_hanging_worker_is_ended_at_the_deadline_and_replaced(backend: Backend) -> None:
    send(backend, 1, batch(WELL))
    send(backend, 2, batch(WELL))
    collect(backend, 2)
    send(backend, 3, batch(HANG), 0.01)
    event = collect(backend, 1)[3]
    assert isinstance(event, Lost)
    assert event.breakdown is Breakdown.HANG
    wait_for_idle(backend)
    assert backend.trouble() is None


@pytest.mark.slow
def test_a_replaced_worker_is_another_process_and_its_fault_is_told_until_there_is_a_result(backend: Backend) -> None:
    one, other = (worker.id for worker in backend.workers())
    backend.replace(one, "it sees ghosts")
    assert other in {slot.worker for slot in backend.slots()}
    assert one not in {slot.worker for slot in backend.slots()}
    wait_for_idle(backend)
    [new] = {slot.worker for slot in backend.slots()} - {other}
    assert new != one
    assert "it sees ghosts" in (backend.trouble() or "")
    backend.submit(new, 1, batch(WELL), PLENTY)
    assert isinstance(collect(backend, 1)[1], Finished)
    assert backend.trouble() is None
    backend.replace(new, None)
    wait_for_idle(backend)
    assert {slot.worker for slot in backend.slots()} & {one, new} == set()
    assert backend.trouble() is None


def test_waiting_for_nothing_takes_the_time_it_was_given(backend: Backend) -> None:
    start = time.monotonic()
    assert backend.wait(0.05) == []
    assert isinstance(backend, FakeBackend) or time.monotonic() - start >= 0.05
