"""Campaigns as a dispatcher leaves them, without one: what the API has to show."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from sqlalchemy import Connection
from tests.support.storage import new_evaluation, simulate
from tests.support.values import numbers, present

from drivecal.campaigns.resolve.bench import Bench
from drivecal.campaigns.resolve.maps import analysis_to_document, smallest_s_rel
from drivecal.campaigns.resolve.problem import CalibrationProblem, resolve, resolve_evaluation
from drivecal.campaigns.resolve.spaces import fixed_to_document, space_to_document
from drivecal.contracts.campaign import Best, CellCounts, ErrorRate, Progress
from drivecal.contracts.input_errors import validated
from drivecal.contracts.specification import CampaignSpecification, EvaluationSpecification
from drivecal.contracts.tables import Generation
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.evaluations import Outcome
from drivecal.domain.parameters import ParameterSet
from drivecal.storage import campaigns, generations
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import influence_maps, parameter_sets, setups

METRICS = {"peak_lateral_acceleration_mps2": 1.25, "peak_lateral_jerk_mps3": 0.1}


@dataclass(frozen=True)
class Carried:
    """A campaign whose first generation is answered: every cell simulated."""

    campaign: StoredCampaign
    problem: CalibrationProblem
    sets: list[ParameterSet]


def carry_out(database: Database, campaign_id: str, individuals: int = 5) -> Carried:
    """Answers a first generation of `individuals` sets: individual i scores i % 8 in the first scenario and 3 in the others."""
    with database.transaction() as connection:
        campaign = campaigns.get(connection, campaign_id)
        problem = resolve(validated(CampaignSpecification, campaign.spec))
        campaigns.start(connection, campaign.sequence)
        campaigns.set_resolution(connection, campaign.sequence, problem.resolution())
        population = [[i, *([0] * (len(problem.space.searched) - 1))] for i in range(individuals)]
        sets = [problem.space.parameter_set(row) for row in population]
        _simulate(connection, campaign, problem.bench, sets)
        cells = len(sets) * len(problem.scenarios)
        figures = Generation(iteration=0, proposed=cells, requested=cells, simulated=cells, best=3.5, mean=3.0, minimum=2.5)
        generations.insert(
            connection, campaign.sequence, figures, population=population, changed=[True] * individuals, optimizer_state={}
        )
        generations.finish(connection, campaign.sequence, figures, [3.0] * individuals)
        best = Best(objective=3.5, parameters=numbers(sets[-1]), scores=dict.fromkeys(problem.scenarios, 3), alternatives=1)
        answered = replace(
            campaign,
            stage=StageName.CALIBRATION,
            iteration=0,
            progress=Progress(done=cells, total=cells, eta_seconds=0.0),
            error_rate={name: ErrorRate() for name in problem.scenarios},
            best=best,
            simulating_seconds=1.5,
            notes=problem.notes,
        )
        counts = CellCounts(proposed=cells, requested=cells, simulated=cells)
        campaigns.save_progress(connection, answered, {StageName.CALIBRATION: counts})
        campaigns.end(connection, campaign.sequence, CampaignState.SUCCEEDED)
        return Carried(campaigns.get(connection, campaign_id), problem, sets)


def _simulate(connection: Connection, campaign: StoredCampaign, bench: Bench, sets: list[ParameterSet]) -> None:
    """Stores the cells of a population in all scenarios of a bench, with their runs."""
    names = list(bench.setups)
    setup_ids = setups.ensure(connection, list(bench.setups.values()))
    for individual, parameter_set in enumerate(parameter_sets.ensure(connection, sets)):
        for name, setup in zip(names, setup_ids, strict=True):
            score = individual % 8 if name == names[0] else 3
            new = new_evaluation(StageName.CALIBRATION, 0, individual, name, setup, parameter_set, Outcome.SIMULATED)
            rated: dict[str, Any] = {"score": score, "rating": score + 0.125, "evaluator": bench.evaluator_id}
            simulate(connection, campaign.sequence, [new], **rated, metrics=METRICS)


def carry_out_evaluation(database: Database, evaluation_id: str) -> None:
    """Answers a single evaluation: score 3 everywhere but 0 in its first scenario."""
    with database.transaction() as connection:
        campaign = campaigns.get(connection, evaluation_id)
        problem = resolve_evaluation(validated(EvaluationSpecification, campaign.spec))
        campaigns.start(connection, campaign.sequence)
        campaigns.set_resolution(connection, campaign.sequence, problem.resolution())
        _simulate(connection, campaign, problem.bench, [problem.parameter_set])
        campaigns.end(connection, campaign.sequence, CampaignState.SUCCEEDED)


ANALYSIS: dict[str, Any] = {
    "catalogue": ["S1", "S2"],
    "parameters": [{"name": f"P{i}", "lower": 0, "upper": 1, "step": 0.05, "unit": "s"} for i in range(1, 4)],
    "fixed": {f"P{i}": 0.5 for i in range(4, 12)},
    "sensitivity": {"intervals": 5, "samples": 6, "threshold": 0.02},
    "optimizer": None,
}
"""A small analysis of its own, of three parameters in two scenarios, to be given to `analyse`."""


def analyse(database: Database, campaign_id: str, score: Callable[[str, Mapping[str, float]], int]) -> None:
    """Gives a campaign the map that its analysis finds where a run scores `score(scenario, parameters)`; stores no runs."""
    with database.transaction() as connection:
        campaign = campaigns.get(connection, campaign_id)
        problem = resolve(validated(CampaignSpecification, campaign.spec))
        analysis = present(problem.analysis())
        while phase := analysis.ask():
            told = {
                scenario: np.array(
                    [score(scenario, numbers(parameter_set)) for parameter_set in problem.space.parameter_sets(points)],
                    dtype=float,
                )
                for scenario, points in phase.points.items()
            }
            analysis.tell(told)
        stored = influence_maps.insert(
            connection,
            name=campaign.name,
            source=campaign.id,
            driving_function=problem.bench.function,
            parameters=space_to_document(problem.space.searched),
            scenarios=analysis_to_document(analysis.result()),
            basis={
                "sensitivity": campaign.spec["sensitivity"],
                "smallest_s_rel": smallest_s_rel(analysis.result()),
                "fixed": fixed_to_document(problem.space.fixed),
                "setups": {scenario: setup.fingerprint for scenario, setup in problem.bench.setups.items()},
                "evaluator": problem.bench.evaluator_id,
                "runs": 0,
                "simulated": 0,
            },
        )
        campaigns.set_influence_map(connection, campaign.sequence, stored.id)
