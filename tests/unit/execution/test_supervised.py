"""Workers whose bundle cache fails get the files of a bundle again with a new process; workers that start slowly get more time."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
import yaml
from tests.support.pooled import MemoryLeases
from tests.support.setups import bare
from tests.support.values import present
from tests.support.zips import zipped

from drivecal.adapters.children import REPLY_SECONDS
from drivecal.bundles.archives import content_digest
from drivecal.contracts.work import Batch, BatchResult, Cell, CellResult, SetupRequest
from drivecal.execution import supervised, worker_process
from drivecal.execution.backend import Finished
from drivecal.execution.pool import WorkPool
from drivecal.execution.scheduling.refusals import PATIENCE_WITH_REFUSALS
from drivecal.execution.supervised import SupervisedBackend, WorkerLimits
from drivecal.execution.worker_process import WorkerProcess
from drivecal.plugins.simulators import PROBE_SECONDS, start_limit
from drivecal.runtime.bundles import BundleSessions, Tools
from drivecal.runtime.cache import BundleCache
from drivecal.runtime.worker import Worker, WorkerFacts

SIMULATOR: dict[str, Any] = {"kind": "command", "command": ["mysim"], "probe": ["mysim", "--version"], "timeout": 60.0}


def archive() -> bytes:
    return zipped(("problem.yaml", yaml.safe_dump({"problem": "mine"})))


@dataclass(frozen=True, slots=True, eq=False)
class Answered:
    """A call with its answer."""

    value: Any


class WorkersHere(SupervisedBackend):
    """Workers in this process, with a cache of bundles each. Their calls are answered at once."""

    def __init__(self, folders: Sequence[Path]) -> None:
        super().__init__(WorkerLimits(archive=lambda _: archive()))
        self._folders = folders
        for _ in folders:
            self._hire(None)

    def _launch(self, worker: WorkerProcess) -> None:
        cache = BundleCache(self._folders[worker.index - 1])
        worker.handle = Worker(worker.name, bundles=BundleSessions(cache, tools=Tools(lambda *_: "2.1")))
        worker.warming = Answered(WorkerFacts("here", 1))

    def _send(self, worker: WorkerProcess, batch: Batch) -> Any:
        return Answered(worker.handle.run(batch))

    def _store(self, worker: WorkerProcess, bundle: str, archive: bytes) -> None:
        worker.handle.store(bundle, archive)

    def _end(self, worker: WorkerProcess) -> None:
        del worker

    def _answered(self, references: Sequence[Any], timeout: float) -> Collection[Any]:
        del timeout
        return references

    def _value(self, worker: WorkerProcess) -> Any:
        return worker.waited_for.value


def test_a_repaired_cache_gets_the_files_again(tmp_path: Path) -> None:
    folders = [tmp_path / "first", tmp_path / "second"]
    for folder in folders:
        folder.mkdir()
        folder.chmod(0o777)  # others could change it
    now = 0.0
    pool = WorkPool(workers := WorkersHere(folders), MemoryLeases(), clock=lambda: now)
    names = (("x",), (), ("y",), (), ())
    setup = SetupRequest(content_digest(archive()), "mine", "city", {}, SIMULATOR, *names, "fingerprint")
    while now < PATIENCE_WITH_REFUSALS / 2:
        assert pool.probe(setup, "a") is None
        pool.poll(0.0)
        now += 1.0
    assert pool.trouble() is not None
    for folder in folders:
        folder.chmod(0o700)
    while (answer := pool.probe(setup, "a")) is None:
        assert now < 3 * PATIENCE_WITH_REFUSALS
        pool.poll(0.0)
        now += 1.0
    assert answer == "2.1"
    assert pool.trouble() is None
    workers.close()


@pytest.mark.parametrize("cells", [0, 1, 7])
@pytest.mark.parametrize("timeout", [5.0, 300.0])
def test_a_batch_may_take_as_long_as_the_limits_of_its_probe_start_and_runs(tmp_path: Path, timeout: float, cells: int) -> None:
    backend = WorkersHere([tmp_path])
    backend.wait(0.0)
    names = (("x",), (), ("y",), (), ())
    simulator = SIMULATOR | {"timeout": timeout, "inputs": ["/opt/maps", ["mysim", "--patches"], ["mysim", "--maps"]]}
    setup = SetupRequest(content_digest(archive()), "mine", "city", {}, simulator, *names, "fingerprint", tools="2.1")
    backend.submit("worker-1", 1, Batch(setup, tuple(Cell(number, {"x": 1.0}) for number in range(cells))), None)
    [worker] = backend._workers
    runs = REPLY_SECONDS + start_limit(timeout) + cells * timeout if cells else 0.0
    assert worker.calls[0].seconds > 4 * PROBE_SECONDS + runs, "probe, digest and two commands"


def test_a_worker_that_lost_its_files_gets_them_again(tmp_path: Path) -> None:
    backend = WorkersHere([tmp_path])
    names = (("x",), (), ("y",), (), ())
    question = Batch(SetupRequest(content_digest(archive()), "mine", "city", {}, SIMULATOR, *names, "fingerprint"), ())
    refusals: list[bool] = []
    backend.wait(0.0)
    for number in range(1, 4):
        backend.submit("worker-1", number, question, None)
        [event] = backend.wait(0.0)
        assert isinstance(event, Finished)
        refusals.append(event.result.refusal is not None)
        if number == 1:
            (tmp_path / content_digest(archive())).rename(tmp_path / "gone")
    assert refusals == [False, True, False]


class Clock:
    """A clock that only `sleep` moves on."""

    def __init__(self) -> None:
        self.now = 0.0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


class WorkersThatCompile(WorkersHere):
    """Workers that are ready after `compiling` seconds of one start."""

    waits_for_workers = True

    def __init__(self, folders: Sequence[Path], clock: Clock, compiling: float) -> None:
        self.clock, self.compiling = clock, compiling
        self.begun: list[float] = []
        self.starts: list[float] = []
        super().__init__(folders)

    def _launch(self, worker: WorkerProcess) -> None:
        super()._launch(worker)
        self.begun.append(self.clock.now)

    def _end(self, worker: WorkerProcess) -> None:
        if worker.warming is not None:
            self.starts.append(self.clock.now - self.begun[-1])

    def _answered(self, references: Sequence[Any], timeout: float) -> Collection[Any]:
        left = self.begun[-1] + self.compiling - self.clock.now
        self.clock.sleep(min(timeout, left))
        return references if left <= timeout else []


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    for module in (supervised, worker_process):
        monkeypatch.setattr(module, "time", clock)
    return clock


def test_a_worker_that_compiles_for_long_gets_twice_as_long(tmp_path: Path, clock: Clock) -> None:
    backend = WorkersThatCompile([tmp_path], clock, compiling=1500.0)
    backend.wait(700.0)
    assert backend.trouble() == "1 of 1 workers do not start: worker-1 was not ready after 600 s"
    backend.wait(1300.0)
    assert backend.trouble() == "1 of 1 workers do not start: worker-1.2 was not ready after 1200 s"
    backend.wait(2000.0)
    assert backend.starts == [600.0, 1200.0]
    assert backend.trouble() is None
    assert [worker.state for worker in backend.workers()] == ["idle"]


def test_a_worker_that_never_gets_ready_is_given_up_at_last(tmp_path: Path, clock: Clock) -> None:
    backend = WorkersThatCompile([tmp_path], clock, compiling=math.inf)
    backend.wait(100_000.0)
    assert backend.starts[:5] == [600.0, 1200.0, 2400.0, 4800.0, 4800.0]
    assert set(backend.starts[3:]) == {8 * 600.0}


@pytest.mark.usefixtures("clock")
def test_workers_wait_while_the_machine_has_no_room_for_a_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as crowded:
        crowded.setattr(WorkersHere, "_launch", Mock(side_effect=OSError("no room")))
        backend = WorkersHere([tmp_path])
        assert backend.wait(100.0) == []
        assert backend.trouble() == f"1 of 1 workers do not start: {backend.workers()[0].id} cannot be started: no room"
    backend.wait(10.0)
    assert (backend.trouble(), backend.workers()[0].state) == (None, "idle")


def test_a_worker_runs_its_first_batch_since_the_one_before_came_back(
    tmp_path: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = CellResult(1, None, None, {}, None, 1.0)
    monkeypatch.setattr(WorkersHere, "_send", lambda *_: Answered(BatchResult("worker-1", (result,) * 30, 15.0)))
    backend = WorkersHere([tmp_path])
    backend.wait(0.0)
    backend.submit("worker-1", 1, Batch(bare("S1"), (Cell(1, {}),)), None)
    clock.sleep(60.0)
    backend.submit("worker-1", 2, Batch(bare("S2"), (Cell(2, {}),)), None)
    [first] = backend.workers()
    assert (first.scenario, first.cells_per_second) == ("S1", None)
    assert (datetime.now(UTC) - present(first.since)).total_seconds() == pytest.approx(60.0, abs=5.0)
    backend.wait(0.0)
    [second] = backend.workers()
    assert (second.scenario, second.cells_per_second) == ("S2", 2.0)
    assert (datetime.now(UTC) - present(second.since)).total_seconds() == pytest.approx(0.0, abs=5.0)
    backend.wait(0.0)
    [idle] = backend.workers()
    assert (idle.scenario, idle.since, idle.cells_per_second) == (None, None, 2.0)
