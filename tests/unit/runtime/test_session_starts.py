"""Failing starts of simulators: next to open sessions that may hold the missing resource, in an open session, or on every try.

Also failing ends of sessions.
"""

import errno
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest
from tests.unit.runtime.test_bundles import READY, ScriptedSession, ScriptedSimulator

from drivecal.adapters.environment import GRANTED
from drivecal.contracts.work import Batch, Cell, SetupRequest
from drivecal.domain.errors import UnavailableError
from drivecal.domain.values import Argument
from drivecal.plugins.simulators import MOST_SESSIONS, UnsuitableError
from drivecal.runtime.bundles import IDLE_SECONDS, BundleSessions
from drivecal.runtime.worker import Worker


@pytest.mark.parametrize("fault", [UnavailableError("no licence"), OSError(errno.ENOMEM, "no memory")])
def test_a_start_is_tried_without_sessions(worker: Callable[..., Worker], request_: SetupRequest, fault: Exception) -> None:
    def opens(_: str) -> None:
        if len(simulator.opened) - len(simulator.closed) >= most:
            raise fault

    most, simulator = 2, ScriptedSimulator(opens=opens)
    works = worker(simulator)
    for number in range(3):
        assert works.run(Batch(replace(request_, scenario=f"s{number}"), (Cell(1, {"x": 2.0}),))).refusal is None
    assert (simulator.opened, simulator.closed) == (["s0", "s1", "s2"], ["s0", "s1"])
    most = 0
    for _ in range(2):
        assert works.run(Batch(replace(request_, scenario="s3"), (Cell(1, {"x": 2.0}),))).refusal


def test_a_program_that_crashes_at_its_start_beside_idle_sessions_is_tried_without_them(
    tmp_path: Path, sessions: Callable[..., BundleSessions], request_: SetupRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(GRANTED, str(tmp_path))
    program = f"""
import atexit, os, sys; licence = {str(tmp_path / "licence")!r}
if os.path.exists(licence): sys.exit("no licence")
open(licence, "x").close()
atexit.register(os.remove, licence)
{READY.replace("request = json.loads(input())", "request = json.loads(input())" + chr(10) + "    if 'quit' in request: break")}"""
    section = {"kind": "process", "command": [sys.executable, "-c", program], "memory_mb": 500, "timeout": 10.0}
    opened = sessions()
    for scenario in ("s0", "s1"):
        setup = replace(request_, scenario=scenario, simulator=section)
        assert opened.run(setup, Cell(1, {"x": 2.0})).metrics == {"a": 2.0}


def test_sessions_are_closed_once_for_a_failing_start(sessions: Callable[..., BundleSessions], request_: SetupRequest) -> None:
    now, simulator = [0.0], ScriptedSimulator()
    opened = sessions(simulator, clock=lambda: now[0])
    broken = replace(request_, scenario="broken", data={"missing": True})
    for closed in (1, 1, 2):
        opened.run(replace(request_, scenario="good"), Cell(1, {"x": 2.0}))
        with pytest.raises(UnavailableError):
            opened.run(broken, Cell(2, {"x": 2.0}))
        assert simulator.closed == ["good"] * closed
        now[0] += 0.6 * IDLE_SECONDS


@pytest.mark.parametrize("kind", [UnavailableError, UnsuitableError])
def test_a_lost_simulator_refuses(worker: Callable[..., Worker], request_: SetupRequest, kind: type[UnavailableError]) -> None:
    def evaluates(parameters: Mapping[str, Argument]) -> None:
        if parameters["x"] == 3.0 and len(simulator.opened) == 1:
            raise kind("SUMO has another version")

    simulator = ScriptedSimulator(evaluates=evaluates)
    works = worker(simulator)
    refused = works.run(Batch(request_, tuple(Cell(number, {"x": float(number)}) for number in range(1, 5))))
    assert [(answer.id, answer.metrics) for answer in refused.results] == [(1, {"a": 1.0}), (2, {"a": 2.0})]
    assert (refused.refusal, refused.unsuitable) == ("SUMO has another version", kind is UnsuitableError)
    assert simulator.closed == ["city"]
    (answer,) = works.run(Batch(request_, (Cell(3, {"x": 3.0}),))).results
    assert (answer.metrics, len(simulator.opened)) == ({"a": 3.0}, 2)


@pytest.mark.parametrize("fault", [UnavailableError("no licence"), OSError(errno.ENOSPC, "no disk")])
def test_a_refused_check_keeps_the_outcome(worker: Callable[..., Worker], request_: SetupRequest, fault: Exception) -> None:
    def evaluates(_: object) -> None:
        if len(simulator.opened) in used:
            raise fault
        used.add(len(simulator.opened))

    used, simulator = set[int](), ScriptedSimulator(evaluates=evaluates)
    works = worker(simulator)
    answered = works.run(Batch(request_, tuple(Cell(number, {"x": float(number)}, check=True) for number in range(1, 4))))
    assert [(answer.metrics, answer.repeats) for answer in answered.results] == [({"a": float(x)}, None) for x in range(1, 4)]
    assert answered.refusal is None
    assert (len(simulator.opened), len(simulator.closed)) == (3, 3), "the next cell begins with all checks"


def test_an_impossible_scenario_closes_no_other_session(worker: Callable[..., Worker], request_: SetupRequest) -> None:
    def opens(scenario: str) -> None:
        if scenario == "broken":
            raise UnsuitableError("the network has no lane e9_0")

    simulator = ScriptedSimulator(opens=opens)
    works = worker(simulator)
    assert works.run(Batch(request_, (Cell(1, {"x": 2.0}),))).refusal is None
    refused = works.run(Batch(replace(request_, scenario="broken"), (Cell(2, {"x": 2.0}),)))
    assert (refused.refusal, refused.unsuitable, refused.results) == ("the network has no lane e9_0", True, ())
    assert simulator.closed == []


def test_a_session_that_cannot_be_closed_costs_no_run_of_others(
    worker: Callable[..., Worker], request_: SetupRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ScriptedSession, "close", Mock(side_effect=RecursionError))
    simulator = ScriptedSimulator()
    works = worker(simulator)
    for number in range(MOST_SESSIONS + 2):
        result = works.run(Batch(replace(request_, scenario=f"s{number}"), (Cell(1, {"x": 2.0}),)))
        assert [cell.metrics for cell in result.results] == [{"a": 2.0}]
    assert len(simulator.opened) == MOST_SESSIONS + 2


def test_a_machine_without_processes_refuses_cells_and_runs_them_when_there_are_some(
    worker: Callable[..., Worker], request_: SetupRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    section = {"kind": "process", "command": [sys.executable, "-c", READY], "memory_mb": 500, "timeout": 10.0}
    setup = replace(request_, simulator=section)
    works = worker()
    no_process = Mock(side_effect=BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable"))
    with monkeypatch.context() as crowded:
        crowded.setattr(subprocess, "run", no_process)
        result = works.run(Batch(setup, (Cell(1, {"x": 2.0}),)))
        assert ("Resource temporarily unavailable" in (result.refusal or ""), result.results) == (True, ())
    assert no_process.called
    (answer,) = works.run(Batch(setup, (Cell(1, {"x": 2.0}),))).results
    assert answer.metrics == {"a": 2.0}
