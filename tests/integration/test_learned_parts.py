"""Hybrid vehicle and learned evaluator in whole runs, and at a worker whose files are damaged."""

from dataclasses import replace

import pytest
from tests.support.setups import driven

from drivecal.contracts.work import Batch, Cell
from drivecal.domain.evaluations import FAILED_RATING, Failure, RunResult
from drivecal.highway.comfort.learned import LEARNED
from drivecal.highway.comfort.reference import REFERENCE
from drivecal.highway.drive.tasks import TaskRunner
from drivecal.highway.planner.plugin import FRENET
from drivecal.highway.scenarios.highway import HIGHWAY
from drivecal.highway.vehicle.hybrid import HYBRID
from drivecal.plugins.ports import Evaluator, Vehicle
from drivecal.runtime.worker import Worker

CALM = [11.0, 0.04, 174, 1692, 153, 0.67, 73, 195, 5.8, 9.9, 164]
SCENARIOS = HIGHWAY.scenarios
NOMINAL = {parameter.name: parameter.nominal for parameter in HYBRID.parameters}

every_scenario = pytest.mark.parametrize("name", list(SCENARIOS))


def run(name: str, parameters: list[float], vehicle: Vehicle = HYBRID, evaluator: Evaluator = LEARNED) -> RunResult:
    return TaskRunner(SCENARIOS[name], FRENET, vehicle.create(NOMINAL), evaluator).run(parameters)


@every_scenario
def test_both_learned_parts_rate_and_drive_every_scenario(name: str) -> None:
    once, again = run(name, CALM), run(name, CALM)
    assert once == again
    assert once.failure is None
    assert 0.0 <= once.rating.rating <= 7.0
    assert abs(once.rating.score - run(name, CALM, evaluator=REFERENCE).rating.score) <= 2


def test_a_missed_task_scores_0_whatever_the_evaluator() -> None:
    missed = replace(SCENARIOS["S1"], task=replace(SCENARIOS["S1"].task, speed_tolerance=1e-9))
    result = TaskRunner(missed, FRENET, HYBRID.create(NOMINAL), LEARNED).run(CALM)
    assert result.failure is Failure.TASK_MISSED
    assert result.rating == FAILED_RATING


def test_a_worker_with_another_version_of_the_evaluator_refuses_to_rate() -> None:
    request = replace(driven(evaluator="learned"), evaluator_version="1.fromelsewhere")
    answer = Worker("w").run(Batch(request, ()))
    assert answer.refusal is None  # nothing was asked of it
    answer = Worker("w").run(Batch(request, (Cell(1, {}),)))
    assert answer.refusal is not None
    assert "1.fromelsewhere" in answer.refusal
    assert LEARNED.version in answer.refusal
