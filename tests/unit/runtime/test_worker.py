import gzip
import json
import os
import pickle
from collections.abc import Sequence
from dataclasses import replace
from math import nan
from unittest.mock import Mock

import pytest
from tests.support.plugins.misbehaving import MEMORY, KeepGoing, Misbehaving
from tests.support.setups import changed, driven, misbehaving_setup

from drivecal.bundles.highway import Scenario
from drivecal.campaigns.resolve.problem import resolve
from drivecal.contracts.specification import CampaignSpecification
from drivecal.contracts.work import Batch, Cell, CellResult, SetupRequest
from drivecal.domain.errors import LONGEST_DETAIL, UnavailableError
from drivecal.highway.drive import tasks
from drivecal.plugins import registry
from drivecal.plugins.simulators import BusyError
from drivecal.runtime import bundles
from drivecal.runtime.cache import BundleCache, cache_folder
from drivecal.runtime.worker import Worker


class ForeignError(Exception):
    """Cannot be pickled, like libsumo's."""

    def __reduce__(self) -> str:
        raise TypeError("no")


class Failing(KeepGoing):
    """Fails at its start in its own way for each of some behaviours."""

    def reset(self, parameters: Sequence[float]) -> None:
        super().reset(parameters)
        failures: dict[float, BaseException] = {
            5.0: ForeignError("one\nof SUMO's \x00 own"),
            6.0: SystemExit(0),
            7.0: ValueError("x" * 10_000),
        }
        if parameters[0] in failures:
            raise failures[parameters[0]]


class FailingFunction(Misbehaving):
    """The plug-in; `made` has the scenarios of its planners."""

    def __init__(self) -> None:
        self.made: list[str] = []

    def create(self, scenario: Scenario) -> KeepGoing:
        self.made.append(scenario.id)
        return Failing()


@pytest.fixture
def function(monkeypatch: pytest.MonkeyPatch) -> FailingFunction:
    installed = FailingFunction()
    monkeypatch.setattr(registry, "driving_function", lambda _: installed)
    return installed


def run(worker: Worker, *behaviours: float, setup: SetupRequest | None = None) -> tuple[CellResult, ...]:
    cells = tuple(Cell(index, {"value": 2.0, "behaviour": each}) for index, each in enumerate(behaviours))
    return worker.run(Batch(setup or misbehaving_setup(), cells)).results


def test_a_cell_that_raises_is_described_and_costs_no_other_cell(function: FailingFunction) -> None:
    results = run(Worker("w"), 0.0, 5.0, MEMORY, 6.0, 7.0, 0.0)
    assert [result.breakdown for result in results] == [None, "error", "memory", "error", "error", None]
    assert results[0].metrics == results[-1].metrics
    assert not any(result.contained for result in results)
    detail = results[1].detail or ""
    assert "ForeignError: one of SUMO's ? own" in detail
    assert "(test_worker.py:" in detail
    assert len(results[4].detail or "") == LONGEST_DETAIL
    pickle.loads(pickle.dumps(results))
    assert function.made == ["S1"] * 5


def test_a_setup_is_prepared_once_and_only_so_many_are_kept(function: FailingFunction, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bundles, "MOST_IN_WORKER", 2)
    worker = Worker("w")
    for name in ("S1", "S2", "S1", "S4", "S1", "S2"):
        assert run(worker, 0.0, setup=misbehaving_setup(name))[0].breakdown is None
    assert function.made == ["S1", "S2", "S4", "S2"]


def test_one_session_drives_all_seeds_on_one_road_and_repeats_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    road_of = Mock(side_effect=tasks.road_of)
    monkeypatch.setattr(tasks, "road_of", road_of)
    bench = resolve(CampaignSpecification.model_validate({"problem": "highway-random"})).bench
    begun: list[int] = []

    def drive(worker: Worker, seed: int, *, check: bool) -> CellResult:
        return worker.run(Batch(bench.seeded(seed).requests["S1r"], (Cell(seed, MIDDLE, check=check),))).results[0]

    worker = Worker("w", bundles.BundleSessions(BundleCache(cache_folder()), begins=begun.append))
    first, second, again = (drive(worker, seed, check=True) for seed in (1, 2, 1))
    assert road_of.call_count == 1
    assert begun == [1, 1, 2, 2, 1, 1]
    assert (first.repeats, first.starts, first.breakdown) == (True, 2, None)
    assert first.metrics == again.metrics != second.metrics
    with monkeypatch.context() as taken:
        taken.setattr(tasks, "PlannerControl", Mock(side_effect=BusyError("the licence is in use")))
        assert worker.run(Batch(bench.seeded(2).requests["S1r"], (Cell(2, MIDDLE),))).busy
    assert second.metrics == drive(worker, 2, check=False).metrics
    assert second.metrics == drive(Worker("w"), 2, check=False).metrics


def test_a_trace_is_the_same_run_with_its_time_series() -> None:
    worker = Worker("w")
    plain, traced = worker.run(Batch(_request(), (Cell(1, MIDDLE), Cell(2, MIDDLE, trace=True)))).results
    assert plain.trace is None
    assert traced.trace is not None
    trace = json.loads(gzip.decompress(traced.trace))
    assert traced.metrics == plain.metrics
    assert trace["measures"] == plain.metrics
    assert len(trace["series"]["s_m"]) == len(trace["series"]["time_s"]) > 100
    assert len(traced.trace) < 400_000, "what the server says that it keeps of a run"
    [again] = worker.run(Batch(_request(), (Cell(3, MIDDLE, trace=True),))).results
    assert again.trace == traced.trace


def _request(**parts: object) -> SetupRequest:
    """Returns the request of a coordinator with other `parts` installed."""
    return changed(driven(), **parts)


MIDDLE = {f"P{index}": 1.0 for index in range(1, 12)}


def test_a_worker_simulates_with_what_is_installed() -> None:
    [result] = Worker("w").run(Batch(_request(), (Cell(1, MIDDLE),))).results
    assert result.breakdown is None, result.detail
    assert result.rating is None, "the coordinator rates"
    assert result.metrics
    assert result.milliseconds > 0


def test_a_worker_without_the_plug_in_says_what_it_has() -> None:
    request = _request()
    controller = {**request.simulator["controller"], "driving_function": "another"}
    unknown = replace(request, simulator={**request.simulator, "controller": controller})
    result = Worker("w").run(Batch(unknown, (Cell(1, MIDDLE),)))
    assert result.results == ()
    assert all(word in (result.refusal or "") for word in ("'another'", "frenet"))


@pytest.mark.parametrize(("part", "name"), [("driving_function", "frenet"), ("simulator", "highway")])
def test_a_plug_in_that_cannot_be_imported_here_is_the_worker_s_fault(
    monkeypatch: pytest.MonkeyPatch, part: str, name: str
) -> None:
    def broken(name: str) -> None:
        raise OSError(f"{name}: no space left on device")

    request = _request()
    monkeypatch.setattr(registry, part, broken)
    result = Worker("w").run(Batch(request, (Cell(1, MIDDLE),)))
    assert f"OSError: {name}: no space left on device" in (result.refusal or "")


def test_a_plug_in_that_cannot_be_built_is_the_cells_fault(function: FailingFunction, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(function, "create", lambda _: 1 / 0)
    result = Worker("w").run(Batch(misbehaving_setup(), (Cell(1, {"value": 2.0, "behaviour": 0.0}),)))
    assert result.refusal is None
    assert [cell.breakdown for cell in result.results] == ["error"]


def test_a_worker_is_ready_once_it_has_simulated_a_cell() -> None:
    facts = Worker("w").warm(Batch(_request(), (Cell(1, MIDDLE),)))
    assert facts.pid == os.getpid()
    for trial, named in (
        (Batch(_request(sumo="libsumo 0.9"), (Cell(1, MIDDLE),)), "libsumo 0.9"),
        (Batch(_request(), (Cell(1, MIDDLE | {"P1": nan}),)), "ValueError"),
    ):
        with pytest.raises(UnavailableError, match=named):
            Worker("w").warm(trial)
