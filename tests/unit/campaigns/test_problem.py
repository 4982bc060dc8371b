"""A campaign is resolved against what is installed, and everything wrong with it is said at once, field by field."""

import json
from decimal import Decimal
from typing import Any

import pytest
from tests.support.values import MIDDLE, faults_of

from drivecal.campaigns.resolve.maps import map_from_document, resolve_map
from drivecal.campaigns.resolve.optimizer import UNLIMITED
from drivecal.campaigns.resolve.problem import CalibrationProblem, resolve, resolve_evaluation
from drivecal.contracts.specification import CampaignSpecification, EvaluationSpecification, Given, InfluenceMapSpecification
from drivecal.domain.influence import Influence


def _resolve(**document: Any) -> CalibrationProblem:
    return resolve(CampaignSpecification.model_validate(document))


def _problems(**document: Any) -> dict[str, str]:
    caught = faults_of(_resolve, **document)
    return {problem.field: str(problem) for problem in caught}


def test_the_default_campaign_is_the_papers_problem() -> None:
    problem = _resolve()
    assert problem.scenarios == ("S1", "S2", "S3", "S4", "S5", "S6")
    assert problem.space.names == tuple(f"P{i}" for i in range(1, 12))
    assert sum(problem.weights.values()) == pytest.approx(1.0)
    assert problem.expected_runs().calibration_at_most == 600
    assert len({setup.fingerprint for setup in problem.bench.setups.values()}) == 6


def test_a_search_without_a_limit_of_simulations_can_run() -> None:
    problem = _resolve(budget={"minutes": 30.0})
    assert problem.expected_runs().calibration_at_most == UNLIMITED


def test_weights_and_bounds_are_not_in_the_fingerprint_but_the_vehicle_is() -> None:
    bench = _resolve().bench
    plain = bench.setups["S1"].fingerprint
    narrow = [{"name": "P1", "lower": 0, "upper": 1, "step": 0.5}]
    held = {name: value for name, value in MIDDLE.items() if name != "P1"}
    assert _resolve(parameters=narrow, fixed=held, weights={"S1": 3}, sensitivity=None).bench.setups["S1"].fingerprint == plain
    heavy = {"model": "single_track", "parameters": {next(iter(bench.values)): 2100.0}}
    assert _resolve(vehicle=heavy).bench.setups["S1"].fingerprint != plain


def test_a_weight_of_zero_leaves_the_scenario_out_and_says_so() -> None:
    problem = _resolve(weights={"S2": 0, "S3": 2})
    assert problem.scenarios == ("S1", "S3", "S4", "S5", "S6")
    assert problem.weights["S3"] == pytest.approx(2 / 6)
    assert any("S2" in note for note in problem.notes)


def test_the_misses_of_the_threshold_auto_are_noted_before_an_analysis_begins() -> None:
    (note, *_) = _resolve(sensitivity={"threshold": "auto", "samples": 20}).notes
    assert "39 %" in note
    assert _resolve(sensitivity={"threshold": 0.02, "samples": 20}, optimizer=None).notes == ()
    assert len(_resolve(sensitivity={"threshold": 0.2, "samples": 20}, optimizer=None).notes) == 1, "1.4 of 7 points"
    assert _resolve(sensitivity=None).notes == ()


@pytest.mark.parametrize(("cells", "population", "notes"), [(5, None, 1), (6, None, 0), (120, 20, 1), (121, 20, 0)])
def test_a_budget_that_suffices_for_no_set_or_one_population_is_noted(cells: int, population: int, notes: int) -> None:
    optimizer = {"kind": "genetic", "population": population} if population else {"kind": "surrogate"}
    assert len(_resolve(budget={"simulations": cells}, optimizer=optimizer).notes) == notes


def test_an_analysis_that_probably_saves_less_than_it_takes_is_noted() -> None:
    def notes(cells: int, kind: str = "genetic", population: int = 200, **changes: Any) -> int:
        optimizer = {"kind": kind} | ({"population": population} if kind == "genetic" else {})
        return len(_resolve(sensitivity={}, optimizer=optimizer, budget={"simulations": cells}, **changes).notes)

    cost = _resolve(sensitivity={}, optimizer=None).expected_runs().sensitivity
    assert (notes(5 * cost), notes(6 * cost)) == (1, 0), "a quarter of 200, less the samples of lots of 50"
    assert notes(40 * cost, population=40) == 1, "a lot of ten cells is simulated nearly whole"
    assert notes(4 * cost, population=40, reduction={"max_error": 1}) == 0
    assert notes(2_000, reduction={"mode": "predicted"}) == 0, "this mode uses no map"
    assert notes(8 * cost, "surrogate") == 2, "the map answers no cell, so that its analysis saves none"
    assert notes(8 * cost, "surrogate", reduction={"max_error": 1}) == 0


@pytest.mark.parametrize(
    ("document", "field", "says"),
    [
        ({"catalogue": "motorway"}, "catalogue", "highway"),
        ({"catalogue": ["S1", "S9"]}, "catalogue[1]", "S1"),
        ({"driving_function": "mpc"}, "driving_function", "frenet"),
        ({"vehicle": {"model": "tank"}}, "vehicle.model", "single_track"),
        ({"vehicle": {"parameters": {"wings": 2.0}}}, "vehicle.parameters.wings", "no such parameter"),
        ({"vehicle": {"parameters": {"mass": 2.06}}}, "vehicle.parameters.mass", "between 1200 and 2600 kg"),
        ({"evaluator": "taste"}, "evaluator", "reference"),
        ({"optimizer": {"kind": "annealing"}}, "optimizer.kind", "genetic"),
        ({"optimizer": {"kind": "genetic", "mutation": 1.5}}, "optimizer.mutation", "1"),
        ({"optimizer": {"kind": "genetic", "mutations": 0.5}}, "optimizer.mutations", "mutation"),
        ({"weights": {"S7": 1}}, "weights.S7", "S1"),
        ({"weights": {f"S{i}": 0 for i in range(1, 7)}}, "weights", "positive"),
        ({"parameters": "city"}, "parameters", "highway_table9"),
        ({"parameters": [{"name": "P12", "lower": 0, "upper": 1, "step": 1}]}, "parameters[0].name", "P11"),
        ({"parameters": [{"name": "P1", "lower": 1, "upper": 1, "step": 1}]}, "parameters[0].upper", "empty"),
        ({"parameters": [{"name": "P2", "lower": -1, "upper": 1, "step": 1}]}, "parameters[0].lower", "at least 0"),
        ({"fixed": {"P1": "eco"}}, "fixed.P1", "number from -15 to 14"),
        ({"sensitivity": {"intervals": 59}}, "sensitivity.intervals", "at most 58"),
        ({"sensitivity": None, "optimizer": None}, "optimizer", "nothing to do"),
        ({"fixed": {"P9": 5.05}}, "fixed.P9", "5 or 5.1"),
        ({"fixed": MIDDLE}, "fixed", "nothing to search"),
        ({"baseline": {"P1": 0.5}}, "baseline", "the value of P2, P3, "),
        ({"baseline": MIDDLE | {"P1": 99}}, "baseline.P1", "-15 to 14"),
    ],
)
def test_what_does_not_fit_is_refused_by_field_with_what_would_be_right(document: Any, field: str, says: str) -> None:
    result = _problems(**document)
    assert field in result, result
    assert says in result[field]


def test_a_list_of_parameters_needs_a_value_for_every_other_one() -> None:
    result = _problems(parameters=[{"name": "P1", "lower": 0, "upper": 1, "step": 0.5}], fixed={"P2": 1})
    assert set(result) == {"fixed"}
    assert "P3, P4, P5, P6, P7, P8, P9, P10, P11; list them" in result["fixed"]
    held = {f"P{number}": 1 for number in range(2, 11)}
    assert set(_problems(parameters=[{"name": "P1", "lower": 0, "upper": 1, "step": 0.5}], fixed=held)) >= {"fixed.P11"}


def test_a_single_evaluation_takes_values_between_the_grid_points() -> None:
    problem = resolve_evaluation(EvaluationSpecification(parameters={**MIDDLE, "P9": 5.05}, scenario="S3"))
    assert list(problem.bench.scenarios) == ["S3"]
    assert problem.parameter_set.floats["P9"] == 5.05
    (note,) = problem.notes
    assert all(part in note for part in ("P9", "5.05", "5 or 5.1"))
    assert resolve_evaluation(EvaluationSpecification(parameters={**MIDDLE})).notes == ()


def test_a_single_evaluation_names_what_is_missing_unknown_or_forbidden() -> None:
    given: dict[str, Given] = {name: value for name, value in MIDDLE.items() if name != "P4"}
    given |= {"P2": -1.0, "P12": 3.0}
    assert {
        problem.field for problem in faults_of(resolve_evaluation, EvaluationSpecification(parameters=given, scenario="S9"))
    } == {"parameters.P4", "parameters.P2", "parameters.P12", "scenario"}


def _map(**scenarios: Any) -> InfluenceMapSpecification:
    return InfluenceMapSpecification.model_validate({"scenarios": scenarios})


def test_a_posted_map_survives_storage_exactly() -> None:
    result = resolve_map(_map(S1={"P9": {"lower": 0.1, "upper": 9.9}, "P1": {"influential": False}}, S2={}))
    ranges = {"P9": Influence(influential=True, lower=Decimal("0.1"), upper=Decimal("9.9")), "P1": Influence(influential=False)}
    assert map_from_document(json.loads(json.dumps(result["scenarios"]))).scenarios == {"S1": ranges, "S2": {}}


@pytest.mark.parametrize(
    ("scenarios", "field", "says"),
    [
        ({"S9": {}}, "scenarios.S9", "S1"),
        ({"S1": {"P99": {}}}, "scenarios.S1.P99", "P11"),
        ({"S1": {"P9": {"lower": 0.05}}}, "scenarios.S1.P9.lower", "0 or 0.1"),
        ({"S1": {"P9": {"upper": 11}}}, "scenarios.S1.P9.upper", "0 to 10"),
        ({"S1": {"P9": {"lower": 3, "upper": 2}}}, "scenarios.S1.P9.lower", "exchange"),
        ({"S1": {"P9": {"influential": False, "lower": 3}}}, "scenarios.S1.P9", "leave"),
    ],
)
def test_map_bounds_off_the_grid_are_refused_by_field(scenarios: Any, field: str, says: str) -> None:
    result = {problem.field: str(problem) for problem in faults_of(resolve_map, _map(**scenarios))}
    assert field in result, result
    assert says in result[field]
