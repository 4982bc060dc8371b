"""Rows to test the storage with."""

import multiprocessing
from collections.abc import Mapping, Sequence
from dataclasses import replace
from decimal import Decimal
from typing import Any

from sqlalchemy import Connection

from drivecal.domain.campaigns import StageName
from drivecal.domain.evaluations import Outcome, RequestedCell
from drivecal.domain.parameters import ParameterSet
from drivecal.domain.setups import Setup
from drivecal.storage import campaigns, evaluations
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.evaluations import AnsweredCell
from drivecal.storage.references import parameter_sets, runs, setups
from drivecal.storage.references.runs import NewRun

PROCESSES = multiprocessing.get_context("forkserver")
"""Starts processes as forks of a server process with all imports, which take longer than most tests."""
PROCESSES.set_forkserver_preload(["pytest", "tests.support.runs", "drivecal.storage.maintenance.backup"])
EVALUATOR = "reference 1"
METRICS = {"peak_lateral_acceleration_mps2": 0.1 + 0.2, "offset_m": 1e-300}
SETUP = Setup("S1", {"simulator": {"kind": "highway"}, "adapter": "1", "scenario": "S1", "data": {}, "files": "0"})


def setup_id(connection: Connection, scenario: str = "S1") -> int:
    """A stored setup of a scenario."""
    return setups.ensure(connection, [Setup(scenario, {**SETUP.document, "scenario": scenario})])[0]


def sample_sets(count: int) -> list[ParameterSet]:
    """Different parameter sets: P1 = 0, 0.01, 0.02, ... and P2 = 5."""
    return [ParameterSet.of({"P1": Decimal(number) / 100, "P2": Decimal(5)}) for number in range(count)]


def sample_set_ids(connection: Connection, count: int) -> list[int]:
    """The ids of `sample_sets`."""
    return parameter_sets.ensure(connection, sample_sets(count))


def campaign(connection: Connection, name: str = "campaign") -> StoredCampaign:
    """A queued campaign."""
    return campaigns.insert(connection, name=name, spec={"name": name})


def begun(connection: Connection, count: int) -> tuple[int, int, list[int]]:
    """A queued campaign, a setup of S1 and as many parameter sets: their numbers."""
    return campaign(connection).sequence, setup_id(connection), sample_set_ids(connection, count)


def new_evaluation(
    stage: StageName,
    iteration: int,
    individual: int,
    scenario: str,
    setup: int,
    parameter_set: int,
    plan: Outcome,
    **further: Any,
) -> RequestedCell:
    """A planned cell with the ids of its setup and parameter set; nothing reads its values."""
    places: dict[str, Any] = {
        "stage": stage,
        "iteration": iteration,
        "setup_id": setup,
        "parameter_set_id": parameter_set,
        "plan": plan,
    }
    return RequestedCell(individual, scenario, ParameterSet((), ()), **places, **further)


def cell(individual: Any, setup: int, parameter_set: int, **changes: Any) -> RequestedCell:
    """A cell of S1 in the first iteration of a calibration, to be simulated, but for `changes`."""
    new = new_evaluation(StageName.CALIBRATION, 0, individual, "S1", setup, parameter_set, Outcome.SIMULATED)
    return replace(new, **changes)


def new_run(
    setup: int,
    parameter_set: int,
    *,
    evaluation: int = 1,
    campaign_sequence: int = 1,
    stage: StageName = StageName.CALIBRATION,
    iteration: int = 0,
    individual: int = 0,
    score: float = 5,
    rating: float = 5.25,
    failure: str | None = None,
    evaluator: str = EVALUATOR,
    metrics: Mapping[str, float] = METRICS,
) -> NewRun:
    """A simulated result."""
    return NewRun(
        setup_id=setup,
        parameter_set_id=parameter_set,
        metrics=metrics,
        failure=failure,
        milliseconds=7.0,
        worker="worker 1",
        evaluator=evaluator,
        score=score,
        rating=rating,
        evaluation_id=evaluation,
        campaign_sequence=campaign_sequence,
        stage=stage,
        iteration=iteration,
        individual=individual,
    )


def simulate(
    connection: Connection, sequence: int, cells: Sequence[RequestedCell], *, score: float = 5, rating: float = 5.25, **run: Any
) -> list[int]:
    """Stores cells of a campaign, and results for the simulated ones as if from a worker. Returns the ids of the cells."""
    ids = evaluations.insert(connection, sequence, cells)
    simulated = [(one, cell) for one, cell in zip(ids, cells, strict=True) if cell.plan is Outcome.SIMULATED]
    results = [
        new_run(
            cell.setup_id,
            cell.parameter_set_id,
            evaluation=one,
            campaign_sequence=sequence,
            stage=cell.stage,
            iteration=cell.iteration,
            individual=cell.individual,
            score=score,
            rating=rating,
            **run,
        )
        for one, cell in simulated
    ]
    stored = runs.insert_results(connection, results)
    answers = [
        AnsweredCell(one, Outcome.SIMULATED, score, rating, at.id, worker="worker 1", milliseconds=7.0, attempts=1)
        for (one, _), at in zip(simulated, stored, strict=True)
    ]
    evaluations.answer(connection, answers)
    return ids
