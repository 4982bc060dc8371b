"""The campaign file against the interface's example, and against everything that must not get in; what a campaign answers."""

import copy
import json
from typing import Any

import pytest
import yaml
from pydantic import BaseModel, ValidationError

from drivecal.contracts.campaign import Campaign, CellCounts, ErrorRate
from drivecal.contracts.comparison import ComparisonSpecification
from drivecal.contracts.specification import (
    CampaignSpecification,
    EvaluationSpecification,
    InfluenceMapSpecification,
    RerunSpecification,
)
from drivecal.domain.evaluations import Outcome
from drivecal.domain.scales import COMFORT

EXAMPLE = """
name: highway comfort
catalogue: highway
parameters: highway
fixed: {}
baseline: null
weights: {S1: 1, S2: 1, S3: 1, S4: 1, S5: 1, S6: 1}
driving_function: frenet
vehicle: {model: single_track}
evaluator: reference
sensitivity: {map: 0f3b}
optimizer: {kind: genetic, population: 1000, iterations: 20, selection: 0.8, recombination: 0.7, mutation: 0.5, start: lhs, seed: 1}
reduction: {mode: influence, audit: 0.02, max_error: 0.02, certified: false}
robustness: null
validation: null
"""


def example() -> dict[str, Any]:
    result: dict[str, Any] = yaml.safe_load(EXAMPLE)
    return result


def with_value(path: str, value: object) -> dict[str, Any]:
    """The example with one field, given by its dotted path, set to a value."""
    document = copy.deepcopy(example())
    *way, last = path.split(".")
    part = document
    for name in way:
        part = part[name]
    part[last] = value
    return document


@pytest.mark.parametrize(
    ("model", "field"),
    [
        (CampaignSpecification, "catalogue"),
        (InfluenceMapSpecification, "catalogue"),
        (ComparisonSpecification, "catalogue"),
        (ComparisonSpecification, "populations"),
        (ComparisonSpecification, "seeds"),
        (ComparisonSpecification, "reductions"),
    ],
)
def test_the_schema_says_which_lists_hold_everything_once(model: type[BaseModel], field: str) -> None:
    described = model.model_json_schema()["properties"][field]
    lists = [each for each in [described, *described.get("anyOf", [])] if each.get("type") == "array"]
    assert [each["uniqueItems"] for each in lists] == [True]


def test_a_posted_map_lists_each_scenario_once() -> None:
    assert refused_at(InfluenceMapSpecification, {"catalogue": ["S1", "S1"], "scenarios": {"S1": {}}}) == ["catalogue"]


def refused_at(model: type[BaseModel], document: object) -> list[str]:
    with pytest.raises(ValidationError) as refused:
        model.model_validate(document)
    return [".".join(str(step) for step in error["loc"]) for error in refused.value.errors()]


def test_the_example_of_the_interface_is_accepted_as_it_stands() -> None:
    result = CampaignSpecification.model_validate(example())
    assert CampaignSpecification.model_validate(json.loads(result.model_dump_json())) == result
    assert result.model_dump(mode="json") | {"sensitivity": None} == CampaignSpecification.model_validate(
        example() | {"sensitivity": None}
    ).model_dump(mode="json")
    assert result.optimizer is not None
    assert (result.optimizer.kind, result.optimizer.population, result.optimizer.iterations) == ("genetic", 1000, 20)
    assert result.optimizer.model_extra == {"selection": 0.8, "recombination": 0.7, "mutation": 0.5}
    assert result.weights == {f"S{number}": 1.0 for number in range(1, 7)}


def test_an_empty_file_is_the_papers_problem() -> None:
    result = CampaignSpecification.model_validate({})
    assert result.problem == "highway"
    assert {result.catalogue, result.parameters, result.driving_function, result.evaluator, result.vehicle.model} == {None}
    assert result.optimizer is not None
    assert (result.optimizer.kind, result.optimizer.model_extra, result.budget) == ("surrogate", {}, None)
    assert result.sensitivity is None
    assert (result.reduction.mode, result.reduction.tolerance_on(COMFORT), result.reduction.limit) == ("predicted", 0, 0.05)
    assert (result.reduction.certified, result.reduction.confirm) == (True, 20)
    assert (result.reduction.audit, result.reduction.max_error) == (0.02, 0.02)


@pytest.mark.parametrize("reduction", [{}, {"reduction": {}}, {"reduction": {"audit": 0.1}}])
@pytest.mark.parametrize(("sensitivity", "mode"), [(None, "predicted"), ({"map": "0f3b"}, "both"), ({"samples": 4}, "both")])
def test_a_map_in_the_file_is_used(sensitivity: dict[str, Any] | None, mode: str, reduction: dict[str, Any]) -> None:
    settled = CampaignSpecification.model_validate({"sensitivity": sensitivity} | reduction)
    assert settled.reduction.mode == mode
    stored = settled.model_dump(mode="json")
    assert stored["reduction"]["mode"] == mode
    assert CampaignSpecification.model_validate(stored) == settled
    given = CampaignSpecification.model_validate({"sensitivity": sensitivity, "reduction": {"mode": "exact"}})
    assert given.reduction.mode == "exact"


def test_a_comparison_settles_reductions_without_a_mode_as_a_campaign_does() -> None:
    document = {
        "optimizers": [{"kind": "random"}],
        "populations": [10],
        "seeds": [1, 2, 3],
        "reductions": ["exact", {"limit": 0.1}],
    }
    for sensitivity, mode in ((None, "predicted"), ({"map": "0f3b"}, "both")):
        settled = ComparisonSpecification.model_validate(document | {"sensitivity": sensitivity})
        assert settled.model_dump()["reductions"][1]["mode"] == mode
    assert ComparisonSpecification.model_validate({**document, "reductions": ["exact"]}).sensitivity is None


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("catalogue", ["S1", "S3"]),
        ("parameters", "highway_table9"),
        ("parameters", [{"name": "P1", "lower": -15, "upper": 14, "step": 0.5, "unit": "dB"}]),
        ("fixed", {"P9": 5}),
        ("baseline", {"P1": 0.5, "P2": 1}),
        ("weights", {}),
        ("weights", {"S1": 0, "S2": 1e6}),
        ("vehicle", {"model": "single_track", "parameters": {"m": 1800}}),
        ("sensitivity", None),
        ("sensitivity", {}),
        ("sensitivity", {"design": "paper", "intervals": 5, "samples": 2, "threshold": "auto"}),
        ("sensitivity", {"threshold": {"mu": 0.1, "sigma": 0.2}}),
        ("optimizer", None),
        ("optimizer", {"kind": "random", "population": 2, "iterations": 1}),
        ("optimizer", {"start": "halton", "seed": 2**63 - 1}),
        ("reduction", {"mode": "off"}),
        ("reduction", {"mode": "exact", "audit": 0}),
    ],
)
def test_the_variants_of_the_interface_are_accepted(path: str, value: object) -> None:
    CampaignSpecification.model_validate(with_value(path, value))


NAN, INFINITE = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("wieghts", {}),
        ("name", ""), ("name", "a" * 201), ("name", "tab\there"), ("name", 5),
        ("catalogue", []), ("catalogue", ["S1", "S1"]), ("catalogue", {"S1": 1}), ("parameters", []), ("parameters", "two words"),
        ("fixed", {"P9": NAN}), ("fixed", {"P9": ""}), ("fixed", {"P9": True}), ("fixed", {"P9": 1e30}), ("fixed", {"": 1}),
        ("baseline", {"P1": -INFINITE}), ("baseline", []), ("weights", {"S1": -1}), ("weights", {"S1": NAN}),
        ("weights", {"S1": 1e30}), ("weights", {"S1": "1"}), ("weights", {"S 1": 1}),
        ("vehicle", "single_track"), ("vehicle.mass", 5), ("vehicle", {"parameters": {"m": "0"}}),
        ("sensitivity", {"samples": 1}), ("sensitivity", {"intervals": 0}), ("sensitivity", {"design": "cells"}),
        ("sensitivity", {"threshold": 0}), ("sensitivity", {"threshold": {"mu": 1}}), ("sensitivity", {"map": "a", "r": 1}),
        ("optimizer.population", 10**30), ("optimizer.population", 100.0), ("optimizer.iterations", 10_001),
        ("optimizer.seed", 2**63), ("optimizer.start", "sobol"), ("optimizer.kind", ""), ("optimizer", []),
        ("reduction.mode", "on"), ("reduction.mode", False), ("reduction.audit", 1.1), ("reduction.max_error", 0),
        ("reduction.certified", 0), ("robustness", {"delta": 0}), ("robustness", {"steps": 0}), ("robustness", {"samples": 0}),
        ("robustness", {"eta": []}), ("robustness", {"eta": [1, 0]}), ("robustness", {"condition": "median"}),
        ("robustness", {"solutions": -1}), ("robustness", {"sets": [{"P1": NAN}]}), ("robustness", {"seed": -1}), ("robustness", True),
        ("validation", {"samples": 0}), ("validation", {"references": 0}), ("validation", {"largest": 10**9}),
        ("validation", {"bases": 3}),
    ],
)  # fmt: skip
def test_what_must_not_get_in_is_refused_at_its_field(path: str, value: object) -> None:
    assert all(where.startswith(path) for where in refused_at(CampaignSpecification, with_value(path, value)))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("name", "1P"), ("name", "P;1"), ("name", 1), ("lower", "0"), ("lower", NAN), ("upper", 1e7), ("upper", True),
        ("step", -0.1), ("step", "1"), ("integer", 1), ("choices", ["eco"]), ("unit", "x" * 33), ("unit", 1), ("bits", 6),
    ],
)  # fmt: skip
def test_a_listed_parameter_is_checked_field_by_field(field: str, value: object) -> None:
    listed = {"name": "P1", "lower": 0, "upper": 1, "step": 0.1} | {field: value}
    assert any(where.endswith(field) for where in refused_at(CampaignSpecification, {"parameters": [listed]}))


@pytest.mark.parametrize(
    ("model", "smallest"),
    [
        (RerunSpecification, {"weights": {"S1": 2}}),
        (EvaluationSpecification, {"parameters": {"P1": 0.5}}),
        (InfluenceMapSpecification, {"scenarios": {"S1": {"P1": {"influential": False}}}}),
    ],
)
def test_the_other_bodies_are_closed(model: type[BaseModel], smallest: dict[str, Any]) -> None:
    model.model_validate(smallest)
    assert refused_at(model, smallest | {"surprise": 1}) == ["surprise"]
    assert refused_at(model, {}) == [next(iter(smallest))]


@pytest.mark.parametrize("wrong", [{"lower": NAN}, {"upper": "1"}, {"influential": 1}, {"below": 1}, {"lower": 1e30}])
def test_posted_bounds_are_checked_field_by_field(wrong: dict[str, object]) -> None:
    result = refused_at(InfluenceMapSpecification, {"scenarios": {"S1": {"P1": wrong}}})
    assert result == [f"scenarios.S1.P1.{next(iter(wrong))}"]


def test_a_campaign_has_every_field_of_the_interface() -> None:
    promised = {
        "id", "name", "state", "degraded", "stage", "progress", "cells", "sensitivity_cells", "error_rate", "best", "seconds",
        "error", "spec", "links",
    }  # fmt: skip
    shown = Campaign(id="1", name="n", state="queued").model_dump(mode="json")
    assert promised <= set(shown)
    assert shown["progress"] == {"done": 0, "total": 0, "eta_seconds": None}
    assert shown["seconds"] == {"wall": 0.0, "simulating": 0.0}


def test_cells_are_counted_under_the_names_of_the_interface() -> None:
    assert set(CellCounts.model_fields) >= {
        "proposed", "carried_over", "pending", "requested", "repeated", "reused", "predicted", "certified", "simulated", "failed",
        "audited", "sampled",
    }  # fmt: skip
    assert CellCounts.model_fields.keys() >= {outcome.value for outcome in Outcome}
    assert set(ErrorRate.model_fields) >= {"audited", "different", "wrong", "upper_95", "stopped"}


def test_a_client_reads_answers_of_a_newer_server() -> None:
    result = Campaign.model_validate({"id": "1", "name": "n", "state": "running", "new_field": {"x": 1}})
    assert result.state == "running"
