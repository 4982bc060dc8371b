"""Objectives and constraints against what a problem declares."""

from typing import Any

import pytest
from tests.support.values import faulty_fields

from drivecal.analysis.goals import weighted_mean
from drivecal.campaigns.resolve.problem import CalibrationProblem, resolve
from drivecal.contracts.specification import CampaignSpecification
from drivecal.domain.vehicles import CLOSED_LOOP_MEASURES
from drivecal.highway.drive.tasks import TaskRunner
from drivecal.highway.planner.plugin import FRENET
from drivecal.highway.scenarios import HIGHWAY
from drivecal.highway.vehicle.plugin import SINGLE_TRACK

JERK = {"measure": "peak_lateral_jerk_mps3", "direction": "minimise"}


def resolved(**document: Any) -> CalibrationProblem:
    return resolve(CampaignSpecification.model_validate(document))


def fields(**document: Any) -> list[str]:
    return faulty_fields(resolved, **document)


def test_no_goals_and_the_weighted_mean_are_the_default() -> None:
    for given in ({}, {"objectives": [{"score": "comfort"}]}, {"objectives": [{"score": "comfort", "direction": "maximise"}]}):
        problem = resolved(**given)
        assert problem.goals == weighted_mean(problem.bench.scale, problem.weights)


def test_goals_mean_scores_measures_and_shares_of_scenarios() -> None:
    problem = resolved(
        objectives=[
            {"score": "comfort", "scenarios": ["S2", "S1"]},
            JERK | {"weights": {"S3": 3}, "aggregate": {"quantile": 0.9}},
        ],
        constraints=[{"measure": "driven_s", "at_least": 10.0}],
        weights={"S1": 3, "S6": 0},
    )
    comfort, jerk = problem.goals.objectives
    assert (comfort.name, comfort.sign, comfort.shares) == ("comfort", 1, {"S1": 0.75, "S2": 0.25})
    assert (jerk.sign, jerk.aggregate.level) == (-1, 0.9)
    assert jerk.shares == pytest.approx({"S1": 1 / 7, "S2": 1 / 7, "S3": 3 / 7, "S4": 1 / 7, "S5": 1 / 7})
    (bound,) = problem.goals.bounds
    assert (bound.aggregate.kind, bound.sign, bound.limit, bound.span) == ("min", 1, 10.0, 10.0)


@pytest.mark.parametrize(
    ("document", "expected"),
    [
        ({"objectives": [{"score": "cost"}]}, ["objectives[0].score"]),
        ({"objectives": [{"measure": "least_gap", "direction": "maximise"}]}, ["objectives[0].measure"]),
        ({"objectives": [{"measure": "driven_s"}]}, ["objectives[0].direction"]),
        ({"objectives": [{"score": "comfort", "direction": "minimise"}]}, ["objectives[0].direction"]),
        ({"objectives": [{"score": "comfort", "scenarios": ["S9"]}]}, ["objectives[0].scenarios"]),
        ({"objectives": [{"score": "comfort", "scenarios": ["S1"], "weights": {"S2": 1}}]}, ["objectives[0].weights"]),
        ({"objectives": [{"score": "comfort"}, {"score": "comfort", "aggregate": "min"}]}, ["objectives[1].name"]),
        ({"constraints": [{"measure": "least_gap", "at_least": 1.0}]}, ["constraints[0].measure"]),
        ({"objectives": [{"score": "comfort"}, JERK], "optimizer": {"kind": "genetic"}}, ["optimizer.kind"]),
        ({"constraints": [{"score": "comfort", "at_least": 1.0}], "optimizer": {"kind": "swarm"}}, ["optimizer.kind"]),
    ],
)
def test_what_a_problem_does_not_offer_is_refused(document: dict[str, Any], expected: list[str]) -> None:
    assert fields(**document) == expected


@pytest.mark.parametrize("mode", ["influence", "predicted", "both"])
def test_reuse_that_answers_one_score_is_refused_with_another_value(mode: str) -> None:
    assert fields(objectives=[{"score": "comfort"}, JERK], reduction={"mode": mode}) == ["reduction.mode"]
    assert fields(constraints=[{"measure": "driven_s", "at_least": 1.0}], reduction={"mode": mode}) == ["reduction.mode"]
    split = [{"score": "comfort", "name": name, "scenarios": [name]} for name in ("S1", "S2")]
    assert resolved(objectives=split, reduction={"mode": mode}).specification.reduction.mode == mode


def test_reuse_that_answers_one_score_is_settled_where_nobody_asked_for_it() -> None:
    problem = resolved(objectives=[{"score": "comfort"}, JERK])
    assert problem.specification.reduction.mode == "exact"
    assert any("peak_lateral_jerk_mps3" in note for note in problem.notes)
    again = resolve(CampaignSpecification.model_validate(problem.specification.model_dump(mode="json")))
    assert again.goals == problem.goals


def test_the_measures_of_the_closed_loop_are_those_of_its_runs() -> None:
    vehicle = SINGLE_TRACK.create({parameter.name: parameter.nominal for parameter in SINGLE_TRACK.parameters})
    runner = TaskRunner(HIGHWAY.scenarios["S1"], FRENET, vehicle)
    values = [float(parameter.lower) for parameter in FRENET.spaces["highway"]]
    assert runner.run(values).measures.keys() == CLOSED_LOOP_MEASURES.keys()


def test_scenarios_that_no_variant_has_are_noted() -> None:
    variants = {"eu": {"scenarios": ["S1", "S2"]}, "us": {"scenarios": ["S1"]}}
    assert [note for note in resolved(variants=variants, weights={"S3": 2}).notes if "S3" in note and "S2" not in note]


def test_faults_of_variants_name_the_field() -> None:
    us: dict[str, Any] = {"weights": {"S9": 1.0}, "vehicle": {"parameters": {"mas": 1.0}}}
    given: dict[str, Any] = {"objectives": [{"score": "comfort", "scenarios": ["S1"]}], "robustness": {}}
    wrong = {"variants.us.vehicle.parameters.mas", "variants.eu.scenarios[1]", "variants.us.weights.S9"}
    assert fields(variants={"eu": {"scenarios": ["S9"]}}) == ["variants.eu.scenarios[0]"]
    variants = {"eu": {"scenarios": ["S1", "S9"]}, "us": us}
    assert set(fields(variants=variants, **given)) == wrong | {"objectives[0]", "robustness"}
