"""Messages for invalid specifications."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel
from tests.support.values import faults_of

from drivecal.contracts.input_errors import validated
from drivecal.contracts.specification import CampaignSpecification, EvaluationSpecification, InfluenceMapSpecification
from drivecal.domain.errors import InvalidInputError


def complaints(document: object, model: type[BaseModel] = CampaignSpecification) -> list[str]:
    caught = faults_of(validated, model, document)
    return [str(problem) for problem in caught]


@pytest.mark.parametrize(
    ("document", "said"),
    [
        ({"wieghts": {}}, "wieghts: there is no such field; did you mean weights?"),
        (
            {"optimizer": {"population": 1e30}},
            "optimizer.population: 1e+30 does not fit; give a whole number, without decimal point and exponent",
        ),
        ({"optimizer": {"population": 10**30}}, f"optimizer.population: {10**30} is too large; give at most 100,000"),
        ({"optimizer": {"population": 1}}, "optimizer.population: 1 is too small; give at least 2"),
        ({"weights": {"S1": -1}}, "weights.S1: -1 is too small; give at least 0"),
        ({"weights": {"S1": float("nan")}}, "weights.S1: nan does not fit; give a finite number"),
        ({"weights": {"S1": "2"}}, "weights.S1: the text 2 does not fit; give a number"),
        ({"catalogue": 5}, "catalogue: 5 does not fit; give text or a list"),
        ({"catalogue": ["S1", 5]}, "catalogue[1]: 5 does not fit; give text"),
        ({"catalogue": []}, "catalogue: a list has too few entries; give at least 1"),
        ({"catalogue": ["S1", "S1"]}, "catalogue: a scenario is listed twice; list each once"),
        (
            {"reduction": {"mode": "x"}},
            "reduction.mode: x is not one of the choices; give off, exact, influence, predicted or both",
        ),
        (
            {"parameters": [{"nmae": "P1", "lower": 0, "upper": 1}]},
            "parameters[0].nmae: there is no such field; did you mean name?",
        ),
        (
            {"name": "a\0"},
            "name: 'a\\x00' is not a valid name; leave out control characters and marks that change the direction of text",
        ),
        ({"parameters": [{"lower": 0, "upper": 1}]}, "parameters[0].name: the value is missing; give it"),
        ([], "a list does not fit; give an object"),
    ],
)
def test_each_finding_names_field_fault_and_remedy(document: object, said: str) -> None:
    assert complaints(document) == [said]


def test_everything_wrong_is_said_at_once() -> None:
    result = complaints({"parameters": [{"step": "1"}], "name": "", "problem": None})
    assert result == [
        "name: '' is too short; give at least 1 characters",
        "problem: null does not fit; give text",
        "parameters[0].step: the text 1 does not fit; give a number",
        "parameters[0].name: the value is missing; give it",
    ]


def test_a_slip_deep_in_an_influence_map_is_named_where_it_is() -> None:
    result = complaints({"scenarios": {"S1": {"P1": {"lowr": 1}, "P2": 5}}}, InfluenceMapSpecification)
    assert result == [
        "scenarios.S1.P1.lowr: there is no such field; did you mean lower?",
        "scenarios.S1.P2: 5 does not fit; give an object",
    ]


anything: st.SearchStrategy[Any] = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda children: st.lists(children, max_size=3) | st.dictionaries(st.text(max_size=5), children, max_size=3),
    max_leaves=6,
)
fields = [*CampaignSpecification.model_fields, "scenarios", "scenario", "map"]


@given(st.dictionaries(st.sampled_from(fields), anything), st.sampled_from([CampaignSpecification, EvaluationSpecification]))
def test_any_document_is_either_accepted_or_refused_with_reasons(document: object, model: type[BaseModel]) -> None:
    try:
        validated(model, document)
    except InvalidInputError as error:
        said = [problem.message for problem in error.problems]
    else:
        said = ["accepted"]
    assert said
    assert all(said)


def test_of_very_many_wrong_values_the_first_ones_are_told() -> None:
    document = {"scenarios": {f"S{item}": {f"P{other}": 1 for other in range(100)} for item in range(100)}}
    caught = faults_of(validated, InfluenceMapSpecification, document)
    assert len(caught) == 500
    assert caught[0].field == "scenarios.S0.P0"


def test_a_large_document_that_fits_is_read_whole() -> None:
    document: dict[str, object] = {"scenarios": {f"S{item}": {f"P{other}": {} for other in range(100)} for item in range(100)}}
    assert len(validated(InfluenceMapSpecification, document).scenarios["S99"]) == 100


def test_what_is_missing_from_a_large_document_is_told() -> None:
    with pytest.raises(InvalidInputError, check=lambda error: error.problems[0].field == "scenarios"):
        validated(
            InfluenceMapSpecification,
            {"parameters": [{"name": f"P{i}", "lower": 0, "upper": 1, "step": 1} for i in range(190)]},
        )
