"""Cells of problem bundles on a worker: sessions, declared measures, time series and the cache of files."""

import errno
import gzip
import json
import math
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from tests.support.problems import REPLAY
from tests.support.serve import until
from tests.support.simulators import running
from tests.support.values import present

from drivecal.adapters import children, process
from drivecal.contracts.evaluation import ReplayAnswer
from drivecal.contracts.work import Batch, Cell, SetupRequest
from drivecal.domain.errors import UnavailableError
from drivecal.domain.evaluations import Breakdown
from drivecal.domain.values import Argument
from drivecal.plugins import simulators
from drivecal.plugins.simulators import MOST_SESSIONS, Declared, NoMeasuresError, RunOutcome, SimulatorSession
from drivecal.runtime import bundles
from drivecal.runtime.bundles import IDLE_SECONDS, BundleSessions
from drivecal.runtime.cache import BundleCache
from drivecal.runtime.worker import Worker

TRACE = {"measures": {"a": 2.0}, "failure": None, "series": {"v": [1.0, 2.0]}}
SECONDS = 0.25
READY = """
import json
input()
print('{"ready": true}', flush=True)
while True:
    request = json.loads(input())
    print(json.dumps({"id": request["id"], "measures": {"a": request["parameters"]["x"]}}), flush=True)
"""
"""A simulator whose measure is its parameter."""


@dataclass
class ScriptedSimulator:
    """Answers with the measure `a` unless `answers` has another outcome for this value of x. `opens` and `evaluates` are asked before, and
    may raise an error; `evaluates` may have an outcome as well."""

    answers: Mapping[float, RunOutcome | NoMeasuresError] = field(default_factory=dict)
    opens: Callable[[str], object] = lambda _: None
    evaluates: Callable[[Mapping[str, Argument]], RunOutcome | None] = lambda _: None
    opened: list[str] = field(default_factory=list)
    closed: list[str] = field(default_factory=list)
    seeds: list[int] = field(default_factory=list)
    version: str = "1"

    def open(
        self, section: Mapping[str, Any], scenario: str, data: Mapping[str, Any], folder: Path, declared: Declared
    ) -> SimulatorSession:
        assert section["kind"] in {"process", "highway"}
        assert declared.measures == ("a",)
        if data.get("missing"):
            raise UnavailableError("there is no such program")
        assert (folder / "problem.yaml").is_file()
        self.opens(scenario)
        self.opened.append(scenario)
        return ScriptedSession(self, scenario)


@dataclass
class ScriptedSession:
    simulator: ScriptedSimulator
    scenario: str

    def evaluate(self, parameters: Mapping[str, Argument], *, series: bool = False, seed: int = 1) -> RunOutcome:
        x = parameters["x"]
        assert isinstance(x, float)
        self.simulator.seeds.append(seed)
        if (given := self.simulator.evaluates(parameters)) is not None:
            return given
        outcome = self.simulator.answers.get(x, RunOutcome({"a": x}, None, {"v": (1.0, 2.0)} if series else {}, SECONDS))
        if isinstance(outcome, NoMeasuresError):
            raise outcome
        return outcome

    def close(self) -> None:
        self.simulator.closed.append(self.scenario)


def test_measures_come_back_with_the_childrens_cpu_time(worker: Callable[..., Worker], request_: SetupRequest) -> None:
    works = worker(ScriptedSimulator())
    (result,) = works.run(Batch(request_, (Cell(7, {"x": 2.0, "other": 1.0}),))).results
    assert (result.id, result.metrics, result.score, result.rating, result.breakdown) == (7, {"a": 2.0}, None, None, None)
    assert result.milliseconds >= 1000 * SECONDS


def test_one_session_serves_all_seeds_and_closes_for_any(worker: Callable[..., Worker], request_: SetupRequest) -> None:
    simulator = ScriptedSimulator()
    works = worker(simulator)
    for seed in (1, 2, 7):
        fingerprint = f"fingerprint of {seed}"
        works.run(Batch(replace(request_, seed=seed, session="s", run_fingerprint=fingerprint), (Cell(1, {"x": 2.0}),)))
    assert (simulator.seeds, simulator.opened) == ([1, 2, 7], ["city"])
    works.run(Batch(replace(request_, seed=1, session="s", run_fingerprint="fingerprint of 1"), (), closes=True))
    assert simulator.closed == ["city"]


def test_a_batch_without_its_files_is_refused(tmp_path: Path, request_: SetupRequest) -> None:
    works = Worker("w", bundles=BundleSessions(BundleCache(tmp_path)))
    result = works.run(Batch(request_, (Cell(1, {"x": 2.0}),)))
    assert request_.bundle in (result.refusal or "")
    assert result.results == ()


def test_a_worker_with_another_sumo_refuses_the_cells(
    worker: Callable[..., Worker], request_: SetupRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    section = {"kind": "highway", "controller": {"kind": "python"}, "timeout": 10.0}
    works = worker(ScriptedSimulator())
    batch = Batch(
        replace(request_, simulator=section, document={"adapter": "1", "sumo": simulators.sumo()}), (Cell(1, {"x": 2.0}),)
    )
    for other in (Mock(return_value="0.0.1"), Mock(side_effect=PackageNotFoundError)):
        with monkeypatch.context() as patch:
            patch.setattr(simulators, "version", other)
            refused = works.run(batch)
            here = simulators.sumo()
        assert refused.results == ()
        assert here != simulators.sumo()
        assert f"is {simulators.sumo()} at the coordinator and {here} at the worker" in (refused.refusal or "")
    assert works.run(batch).refusal is None


def test_a_worker_with_another_adapter_refuses_the_cells_and_closes_nothing(
    worker: Callable[..., Worker], request_: SetupRequest
) -> None:
    simulator = ScriptedSimulator(version="7")
    works = worker(simulator)
    setups = {adapter: replace(request_, scenario=adapter, document={"adapter": adapter}) for adapter in ("8", "7")}
    assert works.run(Batch(setups["7"], (Cell(1, {"x": 2.0}),))).refusal is None
    refused = works.run(Batch(setups["8"], (Cell(1, {"x": 2.0}),)))
    assert refused.results == ()
    assert "is 8 at the coordinator and 7 at the worker" in (refused.refusal or "")
    assert (simulator.opened, simulator.closed) == (["7"], [])


def test_a_simulator_that_this_machine_lacks_is_refused(worker: Callable[..., Worker], request_: SetupRequest) -> None:
    works = worker(ScriptedSimulator())
    result = works.run(Batch(replace(request_, data={"missing": True}), (Cell(1, {"x": 2.0}),)))
    assert result.refusal == "there is no such program"


def test_a_machine_without_disk_refuses_cells_and_runs_them_when_there_is_some(
    tmp_path: Path, worker: Callable[..., Worker], request_: SetupRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    section = {"kind": "process", "command": [sys.executable, "-c", READY], "memory_mb": 500, "timeout": 10.0}
    setup = replace(request_, simulator={**section, "probe": [sys.executable, "--version"]})
    works = worker()
    with monkeypatch.context() as full:
        full.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
        for cells in ((Cell(1, {"x": 2.0}),), ()):
            result = works.run(Batch(setup, cells))
            assert str(tmp_path / "missing") in (result.refusal or "")
            assert result.results == ()
    (answer,) = works.run(Batch(setup, (Cell(1, {"x": 2.0}),))).results
    assert answer.metrics == {"a": 2.0}


@pytest.mark.parametrize(("fault", "starts"), [(OSError, 2), (ChildProcessError, 1)])
def test_a_session_whose_folder_is_spoilt_is_opened_again(
    worker: Callable[..., Worker], request_: SetupRequest, fault: type[OSError], starts: int
) -> None:
    def evaluates(_: object) -> None:
        if len(simulator.opened) in faulty:
            raise fault(errno.ENOSPC, "No space left on device")

    faulty = {1}
    simulator = ScriptedSimulator(evaluates=evaluates)
    works = worker(simulator)
    (answer,) = works.run(Batch(request_, (Cell(1, {"x": 2.0}),))).results
    assert (answer.metrics, answer.starts, len(simulator.opened), len(simulator.closed)) == ({"a": 2.0}, starts, 2, 1)
    faulty |= {2, 3}
    result = works.run(Batch(request_, (Cell(1, {"x": 3.0}),)))
    assert ("No space left" in (result.refusal or ""), result.results) == (True, ())
    assert len(simulator.opened) == len(simulator.closed) == 3


def test_a_program_that_removes_its_folder_costs_its_cell_only(worker: Callable[..., Worker], request_: SetupRequest) -> None:
    leaving = READY.replace("    print(json", "    if request['parameters']['x'] == 1.0: leave()\n    print(json")
    program = f"import os, shutil\ndef leave():\n    shutil.rmtree(os.getcwd())\n    os._exit(1)\n{leaving}"
    setup = replace(
        request_, simulator={"kind": "process", "command": [sys.executable, "-c", program], "memory_mb": 500, "timeout": 10.0}
    )
    works = worker()
    answers = works.run(Batch(setup, tuple(Cell(number, {"x": float(number)}) for number in range(3)))).results
    assert [(answer.breakdown, answer.metrics) for answer in answers] == [(None, {"a": 0.0}), ("crash", {}), (None, {"a": 2.0})]


def test_a_run_without_measures_costs_its_cell_only(worker: Callable[..., Worker], request_: SetupRequest) -> None:
    works = worker(ScriptedSimulator({2.0: NoMeasuresError(Breakdown.HANG, "too long", cpu_seconds=SECONDS)}))
    first, second = works.run(Batch(request_, (Cell(1, {"x": 2.0}), Cell(2, {"x": 3.0})))).results
    assert (first.breakdown, first.detail) == ("hang", "too long")
    assert first.milliseconds >= 1000 * SECONDS
    assert (second.breakdown, second.metrics) == (None, {"a": 3.0})


@pytest.mark.parametrize("noise", [0.0, 1e-9])
def test_a_checked_cell_runs_twice_to_find_noise(worker: Callable[..., Worker], request_: SetupRequest, noise: float) -> None:
    outcomes = iter([RunOutcome({"a": 2.0}, cpu_seconds=SECONDS), RunOutcome({"a": 2.0 + noise}, cpu_seconds=SECONDS)] * 2)
    begun: list[int] = []
    works = worker(ScriptedSimulator(evaluates=lambda _: next(outcomes)), begins=begun.append)
    (result,) = works.run(Batch(request_, (Cell(1, {"x": 2.0}, check=True),))).results
    assert (result.metrics, result.repeats) == ({"a": 2.0}, noise == 0)
    assert result.run_milliseconds < result.milliseconds - 900 * SECONDS
    assert begun == [1, 1]


def test_whole_numbers_are_sent_as_such(worker: Callable[..., Worker], request_: SetupRequest) -> None:
    sent: list[Mapping[str, Argument]] = []
    works = worker(ScriptedSimulator(evaluates=sent.append))
    works.run(Batch(replace(request_, parameters=("x", "n"), integers=("n",)), (Cell(1, {"x": 2.0, "n": 3.0}),)))
    assert [json.dumps(dict(parameters)) for parameters in sent] == ['{"x": 2.0, "n": 3}']


def test_a_crash_of_a_repeated_run_is_no_noise(worker: Callable[..., Worker], request_: SetupRequest) -> None:
    def evaluates(_: object) -> None:
        runs.append(1)
        if len(runs) == 2:
            raise NoMeasuresError(Breakdown.CRASH, "killed")

    runs: list[int] = []
    works = worker(ScriptedSimulator(evaluates=evaluates))
    (result,) = works.run(Batch(request_, (Cell(1, {"x": 2.0}, check=True),))).results
    assert (result.metrics, result.repeats, result.starts) == ({"a": 2.0}, None, 2)


def test_a_declared_failure_needs_no_measures(worker: Callable[..., Worker], request_: SetupRequest) -> None:
    works = worker(ScriptedSimulator({2.0: RunOutcome({}, failure="collision")}))
    (result,) = works.run(Batch(request_, (Cell(1, {"x": 2.0}),))).results
    assert (result.failure, result.breakdown) == ("collision", None)


def test_a_replay_comes_back_beside_the_time_series(worker: Callable[..., Worker], request_: SetupRequest) -> None:
    replayed = RunOutcome({"a": 2.0}, None, {"v": (1.0, 2.0)}, replay=ReplayAnswer.model_validate(REPLAY))
    works = worker(ScriptedSimulator({2.0: replayed}))
    (result,) = works.run(Batch(request_, (Cell(1, {"x": 2.0}, trace=True),))).results
    assert json.loads(gzip.decompress(present(result.trace)))["replay"] == REPLAY


@pytest.mark.parametrize("cause", ["too large", "not finite"])
def test_a_replay_that_cannot_be_kept_leaves_the_time_series(
    cause: str, worker: Callable[..., Worker], request_: SetupRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    replay = ReplayAnswer.model_validate(REPLAY | ({"time_s": [math.nan]} if cause == "not finite" else {}))
    if cause == "too large":
        monkeypatch.setattr(bundles, "LARGEST_SERIES", 150)
    works = worker(ScriptedSimulator({2.0: RunOutcome({"a": 2.0}, None, {"v": (1.0, 2.0)}, replay=replay)}))
    (result,) = works.run(Batch(request_, (Cell(1, {"x": 2.0}, trace=True),))).results
    assert json.loads(gzip.decompress(present(result.trace))) == TRACE


def test_time_series_that_are_not_finite_cost_their_cell(worker: Callable[..., Worker], request_: SetupRequest) -> None:
    works = worker(ScriptedSimulator({2.0: RunOutcome({"a": 2.0}, None, {"v": (float("nan"),)})}))
    first, second = works.run(Batch(request_, (Cell(1, {"x": 2.0}, trace=True), Cell(2, {"x": 3.0})))).results
    assert (first.breakdown, second.breakdown) == ("error", None)


def test_the_sessions_used_last_stay_open(worker: Callable[..., Worker], request_: SetupRequest) -> None:
    simulator = ScriptedSimulator()
    works = worker(simulator)
    scenarios = [f"s{number}" for number in range(MOST_SESSIONS + 1)]
    for name in (*scenarios, scenarios[-1]):
        works.run(Batch(replace(request_, scenario=name), (Cell(1, {"x": 2.0}),)))
    assert simulator.opened == scenarios
    assert simulator.closed == scenarios[:1]


def test_sessions_unused_for_long_are_closed(sessions: Callable[..., BundleSessions], request_: SetupRequest) -> None:
    now = [0.0]
    simulator = ScriptedSimulator()
    opened = sessions(simulator, clock=lambda: now[0])
    opened.run(replace(request_, scenario="old"), Cell(1, {"x": 2.0}))
    now[0] += IDLE_SECONDS / 2
    opened.run(replace(request_, scenario="new"), Cell(2, {"x": 2.0}))
    opened.watch()
    assert simulator.closed == []
    now[0] += IDLE_SECONDS / 2
    opened.watch()
    assert simulator.closed == ["old"]
    now[0] += IDLE_SECONDS
    opened.run(replace(request_, scenario="other"), Cell(3, {"x": 2.0}))
    assert simulator.closed == ["old", "new"]


def test_a_simulator_that_multiplies_after_its_answer_is_ended(
    tmp_path: Path, sessions: Callable[..., BundleSessions], request_: SetupRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (process, bundles):
        monkeypatch.setattr(module, "WATCH_SECONDS", 0.05)
    monkeypatch.setattr(process, "WATCH_SHARE", 1.0)
    monkeypatch.setattr(children, "MOST_PROCESSES", 3)
    mark, go = f"mark-of-{'-'.join(tmp_path.parts[-3:])}", tmp_path / "go"
    program = f"""
import os, subprocess, sys, threading, time
def multiply():
    while not os.path.exists({str(go)!r}): time.sleep(0.05)
    for _ in range(5):
        subprocess.Popen([sys.executable, "-S", "-c", "import time; time.sleep(600)", {mark!r}])
threading.Thread(target=multiply, daemon=True).start()
{READY}"""
    section = {"kind": "process", "command": [sys.executable, "-c", program], "memory_mb": 500, "timeout": 10.0}
    setup = replace(request_, simulator=section)
    opened = sessions()
    assert opened.run(setup, Cell(1, {"x": 2.0})).metrics == {"a": 2.0}
    assert running(mark)
    go.touch()
    until(lambda: not running(mark))
    go.unlink()
    assert opened.run(setup, Cell(2, {"x": 3.0})).metrics == {"a": 3.0}


def test_a_waiting_run_reports_its_wall_clock_time(worker: Callable[..., Worker], request_: SetupRequest) -> None:
    def sleeps(_: object) -> RunOutcome:
        time.sleep(0.5)
        return RunOutcome({"a": 1.0}, start_seconds=1000.0 if is_start else 0.0)

    works = worker(ScriptedSimulator(evaluates=sleeps))
    for is_start in (False, True):
        (result,) = works.run(Batch(request_, (Cell(1, {"x": 2.0}),))).results
        assert result.wall_milliseconds is not None
        assert result.milliseconds < 500
        assert (result.wall_milliseconds >= 500) != is_start
