"""Hybrid vehicle and learned evaluator in whole runs, and at a worker whose files are damaged."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivecal.contracts.work import Batch, Cell, DriveRequest
from drivecal.domain.evaluations import FAILED_RATING, Failure, RunResult
from drivecal.highway.comfort import learned
from drivecal.highway.comfort.learned import LEARNED
from drivecal.highway.comfort.reference import REFERENCE
from drivecal.highway.episode.runner import EpisodeRunner
from drivecal.highway.planner.frenet import FRENET
from drivecal.highway.scenarios.highway import HIGHWAY
from drivecal.highway.vehicle import hybrid
from drivecal.highway.vehicle.hybrid import HYBRID
from drivecal.highway.vehicle.single_track import SINGLE_TRACK
from drivecal.plugins.arrays import DamagedArraysError
from drivecal.plugins.ports import Evaluator, Vehicle
from drivecal.plugins.setups import setup_of
from drivecal.runtime.worker import Worker

CALM = [11.0, 0.04, 174, 1692, 153, 0.67, 73, 195, 5.8, 9.9, 164]
HASTY = [-14.5, 0.06, 182, 235, 132, 0.77, 124, 1486, 5.9, 8.3, 87]
SCENARIOS = HIGHWAY.scenarios
NOMINAL = {parameter.name: parameter.nominal for parameter in HYBRID.parameters}

every_scenario = pytest.mark.parametrize("name", list(SCENARIOS))


def run(name: str, parameters: list[float], vehicle: Vehicle = HYBRID, evaluator: Evaluator = LEARNED) -> RunResult:
    return EpisodeRunner(SCENARIOS[name], FRENET, vehicle.create(NOMINAL), evaluator).run(parameters)


@every_scenario
def test_both_learned_parts_rate_and_drive_every_scenario(name: str) -> None:
    once, again = run(name, CALM), run(name, CALM)
    assert once == again
    assert once.failure is None
    assert 0.0 <= once.rating.rating <= 7.0
    assert abs(once.rating.score - run(name, CALM, evaluator=REFERENCE).rating.score) <= 2


@every_scenario
def test_the_hybrid_vehicle_stays_inside_its_training_range_when_driven_calmly(name: str) -> None:
    result, plain = run(name, CALM), run(name, CALM, SINGLE_TRACK)
    assert result.metrics["outside_training_range_s"] == 0.0
    assert "outside_training_range_s" not in plain.metrics
    assert result.metrics["peak_lateral_acceleration_mps2"] != plain.metrics["peak_lateral_acceleration_mps2"] or name == "S5"


@pytest.mark.parametrize("name", ["S1", "S2"])
def test_the_learned_evaluator_prefers_the_calm_lane_change(name: str) -> None:
    assert run(name, CALM, SINGLE_TRACK).rating.rating > run(name, HASTY, SINGLE_TRACK).rating.rating + 2.0


def test_a_missed_task_scores_0_whatever_the_evaluator() -> None:
    missed = replace(SCENARIOS["S1"], task=replace(SCENARIOS["S1"].task, speed_tolerance=1e-9))
    result = EpisodeRunner(missed, FRENET, HYBRID.create(NOMINAL), LEARNED).run(CALM)
    assert result.failure is Failure.TASK_MISSED
    assert result.rating == FAILED_RATING


@pytest.fixture(params=["hybrid.npz", "learned.npz"])
def damaged(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> tuple[str, DriveRequest]:
    """A setup that was asked for before the worker's file was damaged, and the file."""
    setup = setup_of(SCENARIOS["S1"], FRENET, HYBRID, {})
    version, name = LEARNED.version, str(request.param)

    def shipped() -> None:
        raise DamagedArraysError(name, "it cannot be read")

    monkeypatch.setattr(hybrid if name == "hybrid.npz" else learned, "shipped", shipped)
    monkeypatch.delitem(vars(LEARNED), "version")
    document = setup.document
    return name, DriveRequest("highway", "S1", "frenet", "hybrid", NOMINAL, "learned", setup.fingerprint, document, version)


def test_a_worker_with_another_version_of_the_evaluator_refuses_to_rate() -> None:
    setup = setup_of(SCENARIOS["S1"], FRENET, SINGLE_TRACK, {})
    request = DriveRequest(
        "highway", "S1", "frenet", "single_track", NOMINAL, "learned", setup.fingerprint, setup.document, "1.fromelsewhere"
    )
    answer = Worker("w").run(Batch(request, ()))
    assert answer.refusal is None  # nothing was asked of it
    answer = Worker("w").run(Batch(request, (Cell(1, {}),)))
    assert answer.refusal is not None
    assert "1.fromelsewhere" in answer.refusal
    assert LEARNED.version in answer.refusal


def test_a_worker_whose_files_are_damaged_refuses_the_setup_and_blames_no_cell(damaged: tuple[str, DriveRequest]) -> None:
    file, request = damaged
    names = [parameter.name for parameter in FRENET.spaces["highway"]]
    answer = Worker("w").run(Batch(request, (Cell(1, dict(zip(names, CALM, strict=True))),)))
    assert answer.results == ()
    assert answer.refusal is not None
    assert str(file) in answer.refusal
