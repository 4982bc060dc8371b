import gzip
import json
import os
import pickle
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from tests.support.setups import bare, changed, driven

from drivecal.contracts.evaluation import SeriesAnswer
from drivecal.contracts.work import Batch, Cell, CellResult, SetupRequest
from drivecal.domain.errors import UnavailableError
from drivecal.domain.evaluations import Failure, Rating, RunResult
from drivecal.plugins import registry
from drivecal.plugins.setups import simulator
from drivecal.runtime.worker import LONGEST_DETAIL, MOST_RUNNERS, Worker

SETUP = bare(fingerprint="a fingerprint")


class ForeignError(Exception):
    """Cannot be pickled, like libsumo's."""

    def __reduce__(self) -> str:
        raise TypeError("no")


@dataclass
class ScriptedRunner:
    """Fails in its own way for each of some values of `a`, and rates others by `b`."""

    parameters: Sequence[str] = ("a", "b")
    runs: int = 0

    def trace(self, parameters: Sequence[float]) -> tuple[RunResult, SeriesAnswer]:
        raise NotImplementedError

    def run(self, parameters: Sequence[float]) -> RunResult:
        self.runs += 1
        first, second = parameters
        actions: dict[float, BaseException] = {
            1.0: ForeignError("one\nof SUMO's \x00 own"),
            2.0: MemoryError(),
            3.0: SystemExit(0),
            4.0: ValueError("x" * 10_000),
        }
        if first in actions:
            raise actions[first]
        if first == 5.0:
            return RunResult(Rating(0.0, 0), {"value": second}, Failure.COLLISION)
        if first == 6.0:
            return RunResult(Rating(5.0, 5), {"value": float("nan")})
        sum(range(20_000))
        return RunResult(Rating(second, round(second)), {"value": second, "runs": self.runs})


def run(worker: Worker, *parameters: tuple[float, float], setup: SetupRequest = SETUP) -> tuple[CellResult, ...]:
    cells = tuple(Cell(index, {"b": second, "a": first}) for index, (first, second) in enumerate(parameters))
    return worker.run(Batch(setup, cells)).results


def test_results_come_in_the_batch_s_order_with_values_by_name() -> None:
    worker = Worker("worker-1", lambda *_: ScriptedRunner())
    batch = Batch(SETUP, (Cell(7, {"b": 3.4, "a": 0.0}), Cell(5, {"a": 5.0, "b": 2.0})))
    result = worker.run(batch)
    assert result.worker == "worker-1"
    assert result.seconds > 0
    first, second = result.results
    assert (first.id, first.rating, first.score, first.failure, first.breakdown) == (7, 3.4, 3, None, None)
    assert first.milliseconds > 0
    assert (second.id, second.rating, second.failure, second.metrics) == (5, 0.0, "collision", {"value": 2.0})


def test_a_cell_that_raises_is_described_and_costs_no_other_cell() -> None:
    results = run(
        Worker("w", lambda *_: ScriptedRunner()), (0.0, 1.0), (1.0, 0.0), (2.0, 0.0), (3.0, 0.0), (4.0, 0.0), (0.0, 2.0)
    )
    assert [result.breakdown for result in results] == [None, "error", "memory", "error", "error", None]
    assert [result.score for result in results] == [1, None, None, None, None, 2]
    detail = results[1].detail or ""
    assert "ForeignError: one of SUMO's ? own" in detail
    assert "(test_worker.py:" in detail
    assert len(results[4].detail or "") == LONGEST_DETAIL
    pickle.loads(pickle.dumps(results))


def test_a_result_that_is_no_number_is_no_result() -> None:
    [result] = run(Worker("w", lambda *_: ScriptedRunner()), (6.0, 0.0))
    assert (result.breakdown, result.rating) == ("error", None)
    assert "value is nan" in (result.detail or "")


def test_a_setup_is_prepared_once_and_again_after_an_exception() -> None:
    made: list[str] = []

    def make(setup: SetupRequest, _: Path) -> ScriptedRunner:
        made.append(setup.scenario)
        return ScriptedRunner()

    worker = Worker("w", make)
    run(worker, (0.0, 1.0), (0.0, 1.0))
    run(worker, (0.0, 1.0), setup=replace(SETUP, scenario="S2"))
    run(worker, (0.0, 1.0))
    assert made == ["S1", "S2"]
    run(worker, (1.0, 1.0), (0.0, 1.0))
    assert made == ["S1", "S2", "S1"]


def test_only_so_many_setups_are_kept() -> None:
    made: list[str] = []

    def make(setup: SetupRequest, _: Path) -> ScriptedRunner:
        made.append(setup.scenario)
        return ScriptedRunner()

    worker = Worker("w", make)
    for index in range(MOST_RUNNERS + 1):
        run(worker, (0.0, 1.0), setup=replace(SETUP, scenario=f"S{index}"))
    run(worker, (0.0, 1.0), setup=replace(SETUP, scenario=f"S{MOST_RUNNERS}"))
    assert len(made) == MOST_RUNNERS + 1
    run(worker, (0.0, 1.0), setup=replace(SETUP, scenario="S0"))
    assert made[-1] == "S0"


def test_a_trace_is_the_same_run_with_its_time_series() -> None:
    worker = Worker("w")
    plain, traced = worker.run(Batch(_request(), (Cell(1, MIDDLE), Cell(2, MIDDLE, trace=True)))).results
    assert plain.trace is None
    assert traced.trace is not None
    trace = json.loads(gzip.decompress(traced.trace))
    assert (traced.score, traced.rating, traced.metrics) == (plain.score, plain.rating, plain.metrics)
    assert trace["measures"] == plain.metrics
    assert len(trace["series"]["s_m"]) == len(trace["series"]["time_s"]) > 100
    assert len(traced.trace) < 400_000, "what the server says that it keeps of a run"
    [again] = worker.run(Batch(_request(), (Cell(3, MIDDLE, trace=True),))).results
    assert again.trace == traced.trace


def test_a_cell_without_a_result_has_no_trace() -> None:
    [result] = Worker("w").run(Batch(_request(), (Cell(1, {}, trace=True),))).results
    assert result.trace is None
    assert result.detail is not None
    assert "KeyError: 'P1' (worker.py:" in result.detail


def _request(**parts: object) -> SetupRequest:
    """Returns the request of a coordinator with other `parts` installed."""
    return changed(driven(), **parts)


MIDDLE = {f"P{index}": 1.0 for index in range(1, 12)}


def test_a_worker_simulates_with_what_is_installed() -> None:
    [result] = Worker("w").run(Batch(_request(), (Cell(1, MIDDLE),))).results
    assert result.breakdown is None, result.detail
    assert result.rating is not None
    assert 0.0 <= result.rating <= 7.0
    assert result.metrics
    assert result.milliseconds > 0


def test_a_worker_with_another_version_refuses_the_whole_setup_and_names_both_versions() -> None:
    result = Worker("w").run(Batch(_request(sumo="libsumo 0.9"), (Cell(1, MIDDLE), Cell(2, MIDDLE))))
    assert result.results == ()
    refusal = result.refusal or ""
    assert "coordinator" in refusal
    assert f"is libsumo 0.9 at the coordinator and {simulator()} at the worker" in refusal
    pickle.loads(pickle.dumps(result))


def test_a_worker_without_the_plug_in_says_what_it_has() -> None:
    request = _request()
    controller = {**request.simulator["controller"], "driving_function": "another"}
    unknown = replace(request, simulator={**request.simulator, "controller": controller})
    result = Worker("w").run(Batch(unknown, (Cell(1, MIDDLE),)))
    assert result.results == ()
    assert all(word in (result.refusal or "") for word in ("'another'", "frenet"))


def test_a_plug_in_that_cannot_be_imported_here_is_the_worker_s_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(name: str) -> None:
        raise OSError(f"{name}: no space left on device")

    request = _request()
    monkeypatch.setattr(registry, "driving_function", broken)
    result = Worker("w").run(Batch(request, (Cell(1, MIDDLE),)))
    assert "OSError: frenet: no space left on device" in (result.refusal or "")


def test_a_plug_in_that_cannot_be_put_together_is_the_cell_s_fault() -> None:
    def make(*_: object) -> ScriptedRunner:
        raise ValueError("the vehicle has no wheels")

    result = Worker("w", make).run(Batch(SETUP, (Cell(1, MIDDLE),)))
    assert result.refusal is None
    assert [cell.breakdown for cell in result.results] == ["error"]


def test_a_worker_is_ready_once_it_has_simulated_a_cell() -> None:
    facts = Worker("w").warm(Batch(_request(), (Cell(1, MIDDLE),)))
    assert facts.pid == os.getpid()
    for trial, named in (
        (Batch(_request(sumo="libsumo 0.9"), (Cell(1, MIDDLE),)), "libsumo 0.9"),
        (Batch(_request(), (Cell(1, {}),)), "KeyError: 'P1'"),
    ):
        with pytest.raises(UnavailableError, match=named):
            Worker("w").warm(trial)


def test_a_worker_without_the_problem_s_files_refuses_its_cells() -> None:
    result = Worker("w", lambda *_: ScriptedRunner()).run(Batch(replace(SETUP, bundle="0" * 64), (Cell(1, MIDDLE),)))
    assert "are not on this machine" in (result.refusal or "")
    assert not result.results
