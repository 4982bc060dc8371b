"""Hybrid vehicle and learned evaluator in whole runs, and at a worker whose files are damaged."""

from dataclasses import replace

import pytest
from tests.support.setups import driven

from drivecal.contracts.work import Batch, Cell
from drivecal.domain.evaluations import Failure
from drivecal.domain.scenarios import Scenario
from drivecal.highway.comfort.learned import LEARNED
from drivecal.highway.comfort.reference import REFERENCE
from drivecal.highway.drive.tasks import TaskRunner
from drivecal.highway.planner.plugin import FRENET
from drivecal.highway.scenarios.highway import HIGHWAY
from drivecal.highway.vehicle.hybrid import HYBRID
from drivecal.plugins.ports import SeriesEvaluator
from drivecal.plugins.simulators import RunOutcome
from drivecal.runtime.worker import Worker

CALM = [11.0, 0.04, 174, 1692, 153, 0.67, 73, 195, 5.8, 9.9, 164]
SCENARIOS = HIGHWAY.scenarios
NOMINAL = {parameter.name: parameter.nominal for parameter in HYBRID.parameters}

every_scenario = pytest.mark.parametrize("name", list(SCENARIOS))


def run(scenario: Scenario) -> RunOutcome:
    assert isinstance(LEARNED, SeriesEvaluator)
    return TaskRunner(scenario, FRENET, HYBRID.create(NOMINAL), LEARNED).run(CALM)


@every_scenario
def test_both_learned_parts_rate_and_drive_every_scenario(name: str) -> None:
    once, again = run(SCENARIOS[name]), run(SCENARIOS[name])
    assert once == again
    assert once.failure is None
    assert once.rating is not None
    assert 0.0 <= once.rating.rating <= 7.0
    assert abs(once.rating.score - REFERENCE.rate(SCENARIOS[name].rated_as, once.measures).score) <= 2


def test_a_missed_task_is_not_rated() -> None:
    missed = replace(SCENARIOS["S1"], task=replace(SCENARIOS["S1"].task, speed_tolerance=1e-9))
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
