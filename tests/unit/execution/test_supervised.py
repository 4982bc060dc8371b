"""Workers whose bundle cache fails: the files of a bundle come again with a new process."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

from drivecal.adapters.children import REPLY_SECONDS
from drivecal.bundles.archives import content_digest
from drivecal.contracts.work import Batch, BundleRequest, Cell
from drivecal.execution.backend import Finished
from drivecal.execution.pool import PATIENCE_WITH_REFUSALS, WorkPool
from drivecal.execution.supervised import SupervisedBackend, WorkerLimits
from drivecal.execution.worker_process import WorkerProcess
from drivecal.plugins.simulators import PROBE_SECONDS, start_limit
from drivecal.runtime.bundles import BundleSessions
from drivecal.runtime.cache import BundleCache
from drivecal.runtime.tools import Tools
from drivecal.runtime.worker import Worker, WorkerFacts

SIMULATOR: dict[str, Any] = {"kind": "command", "command": ["mysim"], "probe": ["mysim", "--version"], "timeout": 60.0}


def archive() -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as zipped:
        zipped.writestr("problem.yaml", yaml.safe_dump({"problem": "mine"}))
    return content.getvalue()


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
    pool = WorkPool(WorkersHere(folders), clock=lambda: now)
    names = (("x",), (), ("y",), (), ())
    setup = BundleRequest(content_digest(archive()), "mine", "city", {}, SIMULATOR, *names, "fingerprint")
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
    pool.close()


@pytest.mark.parametrize("cells", [1, 7])
@pytest.mark.parametrize("timeout", [5.0, 300.0])
def test_a_batch_may_take_as_long_as_the_limits_of_its_probe_start_and_runs(tmp_path: Path, timeout: float, cells: int) -> None:
    backend = WorkersHere([tmp_path])
    backend.wait(0.0)
    names = (("x",), (), ("y",), (), ())
    simulator = SIMULATOR | {"timeout": timeout}
    setup = BundleRequest(content_digest(archive()), "mine", "city", {}, simulator, *names, "fingerprint", tools="2.1")
    backend.submit("worker-1", 1, Batch(setup, tuple(Cell(number, {"x": 1.0}) for number in range(cells))), None)
    [worker] = backend._workers
    assert worker.calls[0].seconds >= PROBE_SECONDS + REPLY_SECONDS + start_limit(timeout) + cells * timeout


def test_a_worker_that_lost_its_files_gets_them_again(tmp_path: Path) -> None:
    backend = WorkersHere([tmp_path])
    names = (("x",), (), ("y",), (), ())
    question = Batch(BundleRequest(content_digest(archive()), "mine", "city", {}, SIMULATOR, *names, "fingerprint"), ())
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
