"""Texts of users: characters that steer a terminal or reverse what is read are refused."""

from typing import Any

import pytest
from pydantic import BaseModel
from tests.support.values import faults_of

from drivecal.bundles.manifest import Manifest
from drivecal.contracts.comparison import ComparisonSpecification
from drivecal.contracts.input_errors import validated
from drivecal.contracts.outside.imported import ImportedResults
from drivecal.contracts.specification import (
    CampaignChanges,
    CampaignSpecification,
    InfluenceMapSpecification,
    RerunSpecification,
)

STEERING = ["\x7f", "\x80", "\x9b", "\x9f", "\u2028", "\u2029", "\u202a", "\u202e", "\u2066", "\u2069"]
CHOICES = {"parameters": [{"name": "x", "choices": ["one", "two *"]}]}
PROBLEM = {
    "problem": "p",
    "simulator": {"kind": "python", "file": "p.py"},
    "parameters": {"x": {"choices": ["one", "two *"]}},
    "scenarios": {"s": {}},
    "measures": {"y": "m"},
    "scores": {"c": {"formula": "y", "direction": "minimise", "range": [0, 1]}},
}
ROW = {"parameters": {"x": 1}, "scenario": "S1", "scores": {"cost": 1}}
DOCUMENTS: list[tuple[type[BaseModel], dict[str, Any], str]] = [
    (CampaignSpecification, {"name": "a * b"}, "name"),
    (CampaignSpecification, CHOICES, "parameters[0].choices[1]"),
    (CampaignSpecification, {"fixed": {"x": "*"}}, "fixed.x"),
    (CampaignSpecification, {"baseline": {"x": "a*"}}, "baseline.x"),
    (
        ComparisonSpecification,
        {"name": "*", "optimizers": [{"kind": "random"}], "populations": [4], "seeds": [1, 2, 3]},
        "name",
    ),
    (InfluenceMapSpecification, {"name": "*", "scenarios": {"S1": {}}}, "name"),
    (RerunSpecification, {"name": "*", "weights": {}}, "name"),
    (CampaignChanges, {"name": "*"}, "name"),
    (CampaignChanges, {"tags": ["a", "b*"]}, "tags[1]"),
    (CampaignChanges, {"add_tags": ["*"]}, "add_tags[0]"),
    (ImportedResults, {"problem": "p", "source": "a*b", "date": "2026-11-20", "rows": [ROW]}, "source"),
    (Manifest, PROBLEM, "parameters.x.choices[1]"),
]


def with_character(value: Any, character: str) -> Any:
    """The document with a character in place of each asterisk."""
    if isinstance(value, dict):
        return {key: with_character(inner, character) for key, inner in value.items()}
    if isinstance(value, list):
        return [with_character(inner, character) for inner in value]
    return value.replace("*", character) if isinstance(value, str) else value


@pytest.mark.parametrize(("model", "document", "field"), DOCUMENTS)
def test_what_steers_a_terminal_is_refused_at_its_field(model: type[BaseModel], document: dict[str, Any], field: str) -> None:
    for character in STEERING:
        caught = faults_of(validated, model, with_character(document, character))
        assert [problem.field for problem in caught] == [field]
        assert all(str(problem).isprintable() for problem in caught)


@pytest.mark.parametrize(("model", "document", "field"), DOCUMENTS)
def test_letters_of_any_script_are_taken(model: type[BaseModel], document: dict[str, Any], field: str) -> None:
    for character in ("ä", "ש", "ع", "👩\u200d🚒", "🚗", "'", "₂"):
        assert validated(model, with_character(document, character)), field


@pytest.mark.parametrize(
    "text", ["\u200b", "\ufeff", "\u200b\ufeff\u00ad", "\u00a0", " ", "\u3000 ", "\u3164", "\u2800", "\u0301"]
)
@pytest.mark.parametrize(
    ("model", "document", "field"),
    [
        (CampaignSpecification, {"name": "*"}, "name"),
        (CampaignSpecification, {"parameters": [{"name": "x", "choices": ["one", "*"]}]}, "parameters[0].choices[1]"),
        (CampaignChanges, {"name": "*"}, "name"),
        (InfluenceMapSpecification, {"name": "*", "scenarios": {"S1": {}}}, "name"),
        (RerunSpecification, {"name": "*", "weights": {}}, "name"),
    ],
)
def test_an_invisible_name_is_refused(model: type[BaseModel], document: dict[str, Any], field: str, text: str) -> None:
    caught = faults_of(validated, model, with_character(document, text))
    assert [problem.field for problem in caught] == [field]
    assert all(str(problem).isprintable() for problem in caught)


def test_the_schema_shows_what_is_refused() -> None:
    assert r"\u2028-\u202e" in CampaignSpecification.model_json_schema()["properties"]["name"]["pattern"]
