"""The suites of optimizers, sensitivity, reduction and predictions on a problem that shares nothing with `highway`: a bundle whose cost is
minimised between 0 and 100, with continuous, integer and choice parameters, a grid and constraints."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from tests.support.computed import ComputedBackend
from tests.support.problems import store
from tests.support.runs import dispatcher, everything, get, rows_of, run

from drivecal.api import submission
from drivecal.api.dependencies import Limits
from drivecal.configuration.settings import load_settings
from drivecal.contracts.specification import CampaignSpecification
from drivecal.contracts.work import Cell, CellResult
from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import InvalidInputError
from drivecal.storage import results, studies
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database

LIMITS = Limits.of(load_settings())
MANIFEST: dict[str, Any] = {
    "problem": "synthetic",
    "parameters": {
        "speed": {"lower": 0, "upper": 100},
        "limit": {"lower": 0, "upper": 100, "step": 0.5},
        "gears": {"lower": 1, "upper": 6, "integer": True},
        "mode": {"choices": ["eco", "sport", "winter"]},
        "tyre": {"choices": ["a", "b"]},
    },
    "constraints": ["speed <= limit", "gears * 10 <= limit"],
    "baseline": {"speed": 12.123456789, "limit": 50, "gears": 2, "mode": "eco", "tyre": "a"},
    "simulator": {"kind": "process", "command": ["mysim"], "deterministic": True},
    "scenarios": {"city": {}, "road": {}},
    "measures": {"energy": "kWh"},
    "scores": {
        "cost": {"formula": "min(10*energy, 120)", "direction": "minimise", "range": [0, 100], "tolerance": 2, "failed": 100}
    },
}
ANALYSIS = {"intervals": 4, "samples": 12, "threshold": "auto"}
FAILS_FROM = 75.0
"""Speed above which the city fails."""
OPTIMIZERS = ["genetic", "swarm", "random", "cma_es", "optuna", "nsga2", "nsga3"]


def energy(scenario: str, values: dict[str, Any]) -> float:
    """The city depends on speed up to 40, gears and mode; the road on limit. The tyre matters nowhere."""
    if scenario == "city":
        mode = {"eco": 0.0, "sport": 1.4, "winter": 0.6}[values["mode"]]
        return float(8 - 4 * min(values["speed"], 40) / 40 - values["gears"] / 4 + mode)
    return float(2 + 6 * abs(values["limit"] - 80) / 100)


def computed(scenario: str, cell: Cell) -> CellResult:
    """What a worker answers: a measure, and a failure now and then."""
    values = dict(cell.parameters)
    assert values["speed"] <= values["limit"]
    assert values["gears"] * 10 <= values["limit"]
    failed = scenario == "city" and float(values["speed"]) > FAILS_FROM
    return CellResult(cell.id, None, None, {"energy": energy(scenario, values)}, "collision" if failed else None, 7.0)


@pytest.fixture(autouse=True)
def _pushed(database: Database) -> None:
    store(database, MANIFEST)


def submit(database: Database, **changes: Any) -> StoredCampaign:
    document = {"problem": "synthetic", "sensitivity": None, "reduction": {"mode": "off"}, **changes}
    return submission.submit(database, LIMITS, CampaignSpecification.model_validate(document), None)


def backend() -> ComputedBackend:
    return ComputedBackend(answer=computed)


def true_cost(row: results.StoredEvaluation) -> float:
    values = row.parameters.floats
    if row.scenario == "city" and float(values["speed"]) > FAILS_FROM:
        return 100.0
    return min(10 * energy(row.scenario, dict(values)), 100.0)


@pytest.mark.slow("swarm", "random", "cma_es", "optuna", "nsga3", "nsga2")
@pytest.mark.parametrize("kind", OPTIMIZERS)
def test_every_optimizer_minimises_keeps_constraints_and_resumes_exactly(database: Database, kind: str) -> None:
    wanted = {"optimizer": {"kind": kind, "population": 12, "iterations": 5, "seed": 3}}
    whole = run(database, submit(database, **wanted), backend())
    assert whole.best is not None
    assert whole.baseline is not None
    assert whole.baseline.objective is not None
    assert whole.best.objective <= whole.baseline.objective
    lowest = min(
        sum(true_cost(row) for row in rows_of(database, whole) if (row.iteration, row.individual) == place) / 2
        for place in {(row.iteration, row.individual) for row in rows_of(database, whole)}
    )
    assert whole.best.objective == pytest.approx(lowest)
    broken = submit(database, **wanted)
    for _ in range(200):  # every step is that of another process
        if get(database, broken).state.ended:
            break
        process = dispatcher(database, backend())
        for _ in range(7):
            process.step()
    assert everything(database, run(database, broken, backend()))[0] == everything(database, whole)[0]


@pytest.mark.slow("influence-lines", "influence-paper", "both-paper")
@pytest.mark.parametrize("design", ["lines", "paper"])
@pytest.mark.parametrize("mode", ["influence", "both"])
def test_a_map_of_either_design_answers_and_is_validated(database: Database, design: str, mode: str) -> None:
    ended = run(
        database,
        submit(
            database,
            sensitivity={**ANALYSIS, "design": design},
            optimizer={"kind": "genetic", "population": 60, "iterations": 4, "seed": 2},
            reduction={"mode": mode, "narrow": True, "audit": 0.2},
            validation={"samples": 30, "references": 4, "largest": 200},
        ),
        backend(),
    )
    assert ended.narrowed is not None
    assert "tyre" in {cut.parameter for cut in ended.narrowed}
    rows = [row for row in rows_of(database, ended) if row.stage is StageName.CALIBRATION and row.score is not None]
    reused = [row for row in rows if row.outcome == "reused"]
    assert reused or design == "paper", "whose few samples find influence nearly everywhere"
    wrong = [row.parameters.floats for row in reused if abs(true_cost(row) - (row.score or 0)) > 2]
    assert wrong == []
    with database.read() as connection:
        validated = studies.get(connection, ended.sequence, StageName.VALIDATION)
    assert validated is not None
    assert sum(row["compared"] for row in validated["items"]) > 0
    assert [row["wrong"] for row in validated["items"]] == [0, 0]


@pytest.mark.slow
def test_predictions_are_released_in_the_problem_s_units(database: Database) -> None:
    ended = run(
        database,
        submit(
            database,
            optimizer={"kind": "genetic", "population": 300, "iterations": 6, "seed": 2},
            reduction={"mode": "predicted", "tolerance": 2, "limit": 0.05},
        ),
        ComputedBackend(answer=lambda scenario, cell: replace(computed(scenario, cell), milliseconds=500.0)),
    )
    predicted = [row for row in rows_of(database, ended) if row.outcome == "predicted"]
    assert len(predicted) == ended.cells.predicted > 50
    assert ended.released is not None
    assert {each.limit for each in ended.released.values()} == {0.05}
    wrong = sum(abs(true_cost(row) - (row.score or 0)) > 2 for row in predicted)
    assert wrong <= 0.1 * len(predicted)
    assert ended.best is not None
    truth = sum(10 * energy(name, dict(ended.best.parameters)) for name in ("city", "road")) / 2
    assert ended.best.objective == pytest.approx(truth), "no optimum rests on a prediction"


def test_a_rerun_of_the_exact_reduction_simulates_nothing(database: Database) -> None:
    wanted = {"optimizer": {"kind": "genetic", "population": 30, "iterations": 4, "seed": 2}, "reduction": {"mode": "exact"}}
    first = run(database, submit(database, **wanted), backend())
    again = run(database, submit(database, **wanted), backend())
    assert (again.cells.simulated, again.cells.repeated) == (0, first.cells.requested)
    assert again.best == first.best


@pytest.mark.parametrize("named_by", ["name", "digest"])
def test_a_robustness_study_is_refused_with_a_way_out(database: Database, named_by: str) -> None:
    digest = store(database, MANIFEST)
    with pytest.raises(InvalidInputError) as caught:
        submit(database, problem=digest if named_by == "digest" else "synthetic", robustness={"samples": 5})
    [problem] = caught.value.problems
    assert problem.field == "robustness"
    assert "vehicle" in problem.message
    assert "synthetic" in problem.message
    assert "scenarios" in problem.remedy
