from __future__ import annotations

import gzip
import json
import os
import pickle
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import pytest

from drivecal.contracts.work import Batch, Cell, CellResult, CertificateMemory, DriveRequest, Probe, RecordedRun
from drivecal.domain.errors import UnavailableError
from drivecal.domain.evaluations import Failure, Rating, RunResult
from drivecal.highway.certification.nodes import Nodes
from drivecal.plugins import registry
from drivecal.plugins.runners import TimeSeries
from drivecal.plugins.setups import setup_of, simulator
from drivecal.runtime.runners import RefusedError
from drivecal.runtime.worker import LONGEST_DETAIL, MOST_RUNNERS, Worker

SETUP = DriveRequest("highway", "S1", "frenet", "single_track", {}, "reference", "a fingerprint")
WALK, RECORDING = 0.001, 0.002
"""Milliseconds that the scripted runner says its certificates took."""


class ForeignError(Exception):
    """Cannot be pickled, like libsumo's."""

    def __reduce__(self) -> str:
        raise TypeError("no")


@dataclass
class ScriptedRunner:
    """Certifies what has the same `b` as a run before; disagrees with itself for a = 7, and is not deterministic for a = 8."""

    parameters: Sequence[str] = ("a", "b")
    runs: int = 0
    known: dict[float, tuple[int, RunResult]] = field(default_factory=dict)
    recording: list[RecordedRun] | None = None

    def answer(self, parameters: Sequence[float], number: int, *, check: bool) -> RunResult:
        first, second = parameters
        if second in self.known and not check:
            by, result = self.known[second]
            return replace(result, proven_by=by, certifying=WALK)
        result = replace(self.run(parameters), certifying=RECORDING)
        if first == 8.0:
            return replace(result, agrees=False)
        if second in self.known:
            return replace(result, proven_by=self.known[second][0], agrees=first != 7.0)
        self.known[second] = number, result
        if self.recording is not None:
            self.recording.append(RecordedRun(number, result, (first, second), (), b""))
        return result

    def prove(self, parameters: Sequence[float]) -> int | None:
        return self.known[parameters[1]][0] if parameters[1] in self.known else None

    def trace(self, parameters: Sequence[float]) -> TimeSeries:
        raise NotImplementedError

    def take_over(self, interrupted: ScriptedRunner) -> None:
        self.known = interrupted.known

    def learn(self, known: Sequence[RecordedRun]) -> None:
        self.recording = []
        for run in known:
            if run.parameters[0] == 4.0:
                raise ValueError(run)
            self.known[run.parameters[1]] = run.number, run.result

    def recorded(self, most_bytes: int) -> tuple[RecordedRun, ...]:
        recording, self.recording = self.recording, None
        return tuple(recording or ())[:most_bytes]

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


def run(worker: Worker, *parameters: tuple[float, float], setup: DriveRequest = SETUP) -> tuple[CellResult, ...]:
    cells = tuple(Cell(index, {"b": second, "a": first}) for index, (first, second) in enumerate(parameters))
    return worker.run(Batch(setup, cells)).results


def test_results_come_in_the_batch_s_order_with_values_by_name() -> None:
    worker = Worker("worker-1", lambda _: ScriptedRunner())
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
        Worker("w", lambda _: ScriptedRunner()), (0.0, 1.0), (1.0, 0.0), (2.0, 0.0), (3.0, 0.0), (4.0, 0.0), (0.0, 2.0)
    )
    assert [result.breakdown for result in results] == [None, "error", "memory", "error", "error", None]
    assert [result.score for result in results] == [1, None, None, None, None, 2]
    detail = results[1].detail or ""
    assert "ForeignError: one of SUMO's ? own" in detail
    assert "(test_worker.py:" in detail
    assert len(results[4].detail or "") == LONGEST_DETAIL
    pickle.loads(pickle.dumps(results))


def test_a_result_that_is_no_number_is_no_result() -> None:
    [result] = run(Worker("w", lambda _: ScriptedRunner()), (6.0, 0.0))
    assert (result.breakdown, result.rating) == ("error", None)
    assert "value is nan" in (result.detail or "")


def test_a_setup_is_prepared_once_and_again_after_an_exception() -> None:
    made: list[str] = []

    def make(setup: DriveRequest) -> ScriptedRunner:
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

    def make(setup: DriveRequest) -> ScriptedRunner:
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
    assert (trace["score"], trace["rating"], trace["metrics"]) == (plain.score, plain.rating, plain.metrics)
    assert len(trace["ego"]["s_m"]) == len(trace["time_s"]) > 100
    assert len(traced.trace) < 400_000, "what the server says that it keeps of a run"
    [again] = worker.run(Batch(_request(), (Cell(3, MIDDLE, trace=True),))).results
    assert again.trace == traced.trace


def test_a_cell_without_a_result_has_no_trace() -> None:
    [result] = Worker("w").run(Batch(_request(), (Cell(1, {}, trace=True),))).results
    assert result.trace is None
    assert result.detail is not None
    assert "KeyError: 'P1' (worker.py:" in result.detail


def _request(**document: object) -> DriveRequest:
    """What a coordinator would ask for that has `document` installed where it differs from here."""
    scenario = registry.catalogue("highway").scenarios["S1"]
    vehicle = registry.vehicle("single_track")
    setup = setup_of(scenario, registry.driving_function("frenet"), vehicle, {})
    theirs = replace(setup, **document)  # type: ignore[arg-type]  # its fields by name
    return DriveRequest(
        "highway", "S1", "frenet", "single_track", theirs.vehicle_parameters, "reference", theirs.fingerprint, theirs.document
    )


MIDDLE = {f"P{index}": 1.0 for index in range(1, 12)}


def test_a_worker_simulates_with_what_is_installed() -> None:
    [result] = Worker("w").run(Batch(_request(), (Cell(1, MIDDLE),))).results
    assert result.breakdown is None, result.detail
    assert result.rating is not None
    assert 0.0 <= result.rating <= 7.0
    assert result.metrics
    assert result.milliseconds > 0


def test_a_worker_with_another_version_refuses_the_whole_setup_and_names_both_versions() -> None:
    result = Worker("w").run(Batch(_request(simulator="libsumo 0.9", seed=77), (Cell(1, MIDDLE), Cell(2, MIDDLE))))
    assert result.results == ()
    refusal = result.refusal or ""
    assert "coordinator" in refusal
    assert f"simulator is libsumo 0.9 at the coordinator and {simulator()} at the worker" in refusal
    assert "seed is 77" in refusal
    pickle.loads(pickle.dumps(result))


def test_a_worker_without_the_plug_in_says_what_it_has() -> None:
    for request, named in (
        (replace(_request(), driving_function="another"), ("'another'", "frenet")),
        (replace(_request(), scenario="S77"), ("'S77'", "S1, S2")),
        (replace(_request(), run_fingerprint="0", document={}), ("fingerprint is 0",)),
    ):
        result = Worker("w").run(Batch(request, (Cell(1, MIDDLE),)))
        assert result.results == ()
        assert all(word in (result.refusal or "") for word in named)


def test_a_plug_in_that_cannot_be_imported_here_is_the_worker_s_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(name: str) -> None:
        raise OSError(f"{name}: no space left on device")

    request = _request()
    monkeypatch.setattr(registry, "driving_function", broken)
    result = Worker("w").run(Batch(request, (Cell(1, MIDDLE),)))
    assert "OSError: frenet: no space left on device" in (result.refusal or "")


def test_a_plug_in_that_cannot_be_put_together_is_the_cell_s_fault() -> None:
    def make(_: DriveRequest) -> ScriptedRunner:
        raise ValueError("the vehicle has no wheels")

    result = Worker("w", make).run(Batch(SETUP, (Cell(1, MIDDLE),)))
    assert result.refusal is None
    assert [cell.breakdown for cell in result.results] == ["error"]


def test_a_worker_is_ready_once_it_has_simulated_a_cell() -> None:
    facts = Worker("w").warm(Batch(_request(), (Cell(1, MIDDLE),)))
    assert facts.pid == os.getpid()
    for trial, named in (
        (Batch(_request(simulator="libsumo 0.9"), (Cell(1, MIDDLE),)), "libsumo 0.9"),
        (Batch(_request(), (Cell(1, {}),)), "KeyError: 'P1'"),
    ):
        with pytest.raises(UnavailableError, match=named):
            Worker("w").warm(trial)


def certified(worker: Worker, *cells: Cell, setup: DriveRequest = SETUP) -> tuple[CellResult, ...]:
    return worker.run(Batch(setup, tuple(replace(cell, certify=True) for cell in cells))).results


def test_a_certified_cell_names_the_cell_whose_run_it_repeats() -> None:
    worker = Worker("w", lambda _: ScriptedRunner())
    first, again, other = certified(
        worker, Cell(7, {"a": 0.0, "b": 3.0}), Cell(8, {"a": 0.5, "b": 3.0}), Cell(9, {"a": 0.0, "b": 4.0})
    )
    assert [(cell.proven_by, cell.agrees) for cell in (first, again, other)] == [(None, None), (7, None), (None, None)]
    assert (again.rating, again.score, again.metrics) == (first.rating, first.score, first.metrics)
    assert again.breakdown is None


def test_a_certified_cell_that_is_checked_is_simulated_and_says_whether_both_agree() -> None:
    worker = Worker("w", lambda _: ScriptedRunner())
    certified(worker, Cell(1, {"a": 0.0, "b": 3.0}))
    good, bad, chaotic = certified(
        worker,
        Cell(2, {"a": 0.0, "b": 3.0}, check=True),
        Cell(3, {"a": 7.0, "b": 3.0}, check=True),
        Cell(4, {"a": 8.0, "b": 5.0}),
    )
    assert [(cell.proven_by, cell.agrees) for cell in (good, bad, chaotic)] == [(1, True), (1, False), (None, False)]
    assert good.metrics["runs"] == 2


def test_an_exception_of_a_cell_costs_no_certificate() -> None:
    worker = Worker("w", lambda _: ScriptedRunner())
    _, broken, again = certified(
        worker, Cell(1, {"a": 0.0, "b": 3.0}), Cell(2, {"a": 4.0, "b": 9.0}), Cell(3, {"a": 0.5, "b": 3.0})
    )
    assert broken.breakdown == "error"
    assert again.proven_by == 1


def test_an_exception_of_the_evaluator_leaves_the_recorded_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    worker = Worker("w")
    request = _request()
    certified(worker, Cell(1, MIDDLE), setup=request)
    states = worker.run(Batch(request, ())).remembered
    evaluator = type(registry.evaluator("reference"))
    rate = evaluator.rate
    monkeypatch.setattr(evaluator, "rate", lambda *_: 1 / 0)
    [broken] = certified(worker, Cell(2, MIDDLE | {"P1": -20.0}), setup=request)
    assert broken.breakdown == "error"
    monkeypatch.setattr(evaluator, "rate", rate)
    [again] = certified(worker, Cell(3, MIDDLE), setup=request)
    assert again.proven_by == 1
    assert worker.run(Batch(request, ())).remembered == states


def test_an_exception_in_the_trie_itself_costs_its_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    worker = Worker("w")
    request = _request()
    certified(worker, Cell(1, MIDDLE), setup=request)
    extend = Nodes.extend

    def interrupted(nodes: Nodes, *arguments: Any) -> Any:
        extend(nodes, *arguments)
        raise MemoryError

    monkeypatch.setattr(Nodes, "extend", interrupted)
    [broken] = certified(worker, Cell(2, MIDDLE | {"P1": -20.0}), setup=request)
    assert broken.breakdown == "memory"
    monkeypatch.setattr(Nodes, "extend", extend)
    [again] = certified(worker, Cell(3, MIDDLE), setup=request)
    assert again.proven_by is None


def test_a_worker_certifies_by_the_runs_of_others_and_returns_its_own() -> None:
    sender, reader = (Worker(name, lambda _: ScriptedRunner()) for name in ("w", "v"))
    cells = (Cell(1, {"a": 0.0, "b": 3.0}, certify=True), Cell(2, {"a": 5.0, "b": 3.0}, certify=True))
    sent = sender.run(Batch(SETUP, cells, share=1000))
    assert [run.number for run in sent.learned] == [1]
    assert sender.run(Batch(SETUP, (Cell(3, {"a": 0.0, "b": 9.0}, certify=True),))).learned == ()
    [answered] = reader.run(Batch(SETUP, (replace(cells[0], id=4),), known=sent.learned, share=1000)).results
    assert (answered.proven_by, answered.rating) == (1, sent.results[0].rating)


def test_a_run_of_another_worker_that_raises_costs_no_cell() -> None:
    worker = Worker("w", lambda _: ScriptedRunner())
    bad = RecordedRun(9, RunResult(Rating(1.0, 1), {}), (4.0, 0.0), (), b"")
    result = worker.run(Batch(SETUP, (Cell(1, {"a": 0.0, "b": 3.0}, certify=True),), known=(bad,), share=1000))
    assert [cell.breakdown for cell in result.results] == [None]


def test_a_setup_that_is_refused_learns_nothing() -> None:
    def refuse(_: DriveRequest) -> ScriptedRunner:
        raise RefusedError("another version")

    result = Worker("w", refuse).run(Batch(SETUP, (Cell(1, {"a": 0.0, "b": 3.0}, certify=True),), share=1000))
    assert (result.refusal, result.results, result.learned) == ("another version", (), ())


def test_without_leave_nothing_is_certified() -> None:
    worker = Worker("w", lambda _: ScriptedRunner())
    assert [cell.metrics["runs"] for cell in run(worker, (0.0, 3.0), (0.0, 3.0))] == [1, 2]


def test_a_worker_reports_the_use_and_limit_of_its_certificate_memory() -> None:
    worker = Worker("w", lambda _: ScriptedRunner(), certificates_mb=7)
    assert worker.run(Batch(SETUP, ())).remembered == CertificateMemory(0, 0, 7 * 2**20)


def test_a_worker_reports_certificates_of_probes_without_a_simulation() -> None:
    worker = Worker("w", lambda _: ScriptedRunner())
    probes = (Probe(7, {"a": 9.0, "b": 3.0}), Probe(8, {"a": 0.0, "b": 4.0}))
    (first,) = certified(worker, Cell(1, {"a": 0.0, "b": 3.0}, probes=probes))
    assert first.probed == ((7, 1),)
    assert first.metrics["runs"] == 1


def test_what_certificates_took_is_reported_apart_from_the_run() -> None:
    worker = Worker("w", lambda _: ScriptedRunner())
    simulated, proved = certified(worker, Cell(1, {"a": 0.0, "b": 3.0}), Cell(2, {"a": 0.0, "b": 3.0}))
    [plain] = run(worker, (0.0, 3.0))
    assert (simulated.certifying, proved.certifying, plain.certifying) == (RECORDING, WALK, 0.0)
    assert simulated.run_milliseconds == simulated.milliseconds - RECORDING
    assert plain.run_milliseconds == plain.milliseconds


def test_probes_are_part_of_the_time_and_of_what_certificates_took() -> None:
    class Slow(ScriptedRunner):
        def prove(self, parameters: Sequence[float]) -> int | None:
            sum(range(20_000))
            return super().prove(parameters)

    probe = Probe(7, {"a": 9.0, "b": 3.0})
    [cell] = certified(Worker("w", lambda _: Slow()), Cell(1, {"a": 0.0, "b": 3.0}, probes=(probe,)))
    assert cell.certifying > RECORDING
    assert cell.milliseconds > cell.certifying
