"""Hybrid vehicle and learned evaluator in whole runs, at a worker with other ones, and with damaged files, which a message names."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.support.runs import SMALL
from tests.support.server import serving
from tests.support.setups import driven
from tests.support.values import MIDDLE

from drivecal.bundles.highway import Scenario
from drivecal.contracts.work import Batch, Cell
from drivecal.domain.evaluations import Failure
from drivecal.highway.comfort import learned, regressions
from drivecal.highway.comfort.learned import LEARNED
from drivecal.highway.comfort.reference import REFERENCE
from drivecal.highway.drive.tasks import TaskRunner
from drivecal.highway.planner.plugin import FRENET
from drivecal.highway.scenarios import HIGHWAY
from drivecal.highway.vehicle import residual
from drivecal.highway.vehicle.plugin import HYBRID
from drivecal.plugins.ports import SeriesEvaluator
from drivecal.plugins.simulators import RunOutcome
from drivecal.runtime.worker import Worker

CALM = [11.0, 0.04, 174, 1692, 153, 0.67, 73, 195, 5.8, 9.9, 164]
SCENARIOS = HIGHWAY.scenarios
CHOICES: dict[str, dict[str, Any]] = {"hybrid.npz": {"vehicle": {"model": "hybrid"}}, "learned.npz": {"evaluator": "learned"}}
NOMINAL = {parameter.name: parameter.nominal for parameter in HYBRID.parameters}


def run(scenario: Scenario) -> RunOutcome:
    assert isinstance(LEARNED, SeriesEvaluator)
    return TaskRunner(scenario, FRENET, HYBRID.create(NOMINAL), LEARNED).run(CALM)


@pytest.mark.parametrize("name", list(SCENARIOS))
def test_both_learned_parts_rate_and_drive_every_scenario(name: str) -> None:
    once, again = run(SCENARIOS[name]), run(SCENARIOS[name])
    assert once == again
    assert once.failure is None
    assert once.rating is not None
    assert 0.0 <= once.rating.rating <= 7.0
    assert abs(once.rating.score - REFERENCE.rate(SCENARIOS[name].rated_as, once.measures).score) <= 2


def test_a_missed_task_is_not_rated() -> None:
    missed = replace(SCENARIOS["S1"], task=SCENARIOS["S1"].task.model_copy(update={"speed_tolerance": 1e-9}))
    result = run(missed)
    assert (result.failure, result.rating) == (Failure.TASK_MISSED, None)


def test_a_worker_with_another_version_of_the_evaluator_refuses_to_rate() -> None:
    request = replace(driven(evaluator="learned"), evaluator="learned 1.fromelsewhere")
    answer = Worker("w").run(Batch(request, ()))
    assert answer.refusal is None  # nothing was asked of it
    answer = Worker("w").run(Batch(request, (Cell(1, {}),)))
    assert answer.refusal is not None
    assert "1.fromelsewhere" in answer.refusal
    assert LEARNED.version in answer.refusal


def damage(folder: Path, patch: pytest.MonkeyPatch) -> None:
    """Truncates both files, before the process has read them."""
    copies = [folder / residual.FILE.name, folder / regressions.FILE.name]
    for file, copy in zip((residual.FILE, regressions.FILE), copies, strict=True):
        copy.write_bytes(file.read_bytes()[:-40])
    patch.setattr("drivecal.highway.vehicle.plugin.shipped", lambda: residual.shipped(copies[0]))
    patch.setattr(learned, "shipped", lambda: regressions.shipped(copies[1]))
    for plugin in (HYBRID, LEARNED):
        patch.delitem(vars(plugin), "version", raising=False)


def test_a_damaged_learned_part_is_refused_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    damage(tmp_path, monkeypatch)
    with serving(f"sqlite:///{tmp_path / 'drivecal.db'}") as api:
        for name, choice in CHOICES.items():
            small = SMALL | choice
            for path, body in (
                ("campaigns", small),
                ("campaigns?validate_only=true", small),
                ("evaluations", {"parameters": MIDDLE} | choice),
            ):
                answer = api.http.post(f"/api/v1/{path}", json=body)
                assert answer.status_code == 503, answer.text
                assert name in answer.json()["detail"]
        assert api.http.get("/api/v1/campaigns").json()["items"] == []
        assert api.http.post("/api/v1/campaigns?validate_only=true", json=SMALL).status_code == 200
