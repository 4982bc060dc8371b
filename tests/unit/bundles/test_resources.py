"""Resources of a simulator and its scenarios: no part of what runs get, nor of their identity."""

from typing import Any

import pytest
from tests.support.values import faults_of

from drivecal.bundles.checks import checked
from drivecal.bundles.fingerprints import setup_document
from drivecal.bundles.manifest import Manifest


def document(simulator: Any = None, city: Any = None) -> dict[str, Any]:
    return {
        "problem": "mine",
        "parameters": {"x": {"lower": 0, "upper": 1}},
        "simulator": {"kind": "process", "command": ["mysim"]} | ({} if simulator is None else {"resources": simulator}),
        "scenarios": {"city": {"gap": 30} | ({} if city is None else {"resources": city}), "road": {}},
        "measures": {"m": "1"},
        "scores": {"s": {"formula": "m", "direction": "minimise", "range": [0, 1]}},
    }


def test_a_scenario_adds_to_the_resources_of_the_simulator_and_its_data_have_none() -> None:
    manifest = checked(document({"carmaker": 1, "vtd": 1}, {"carmaker": 0, "gpu": 2}))
    assert manifest.resources("city") == {"vtd": 1, "gpu": 2}
    assert manifest.resources("road") == {"carmaker": 1, "vtd": 1}
    assert manifest.scenarios["city"] == {"gap": 30}
    assert Manifest.model_validate(manifest.model_dump(mode="json")) == manifest


def test_resources_change_no_identity_of_a_run() -> None:
    documents = [
        setup_document(checked(document(simulator, city)), "city", "0" * 64)
        for simulator, city in ((None, None), ({"carmaker": 1}, {"vtd": 2}))
    ]
    assert documents[0] == documents[1]


@pytest.mark.parametrize("counts", [{"carmaker": -1}, {"carmaker": "two"}, {"carmaker": True}, ["carmaker"], {"a b": 1}])
def test_faulty_resources_are_named_where_they_stand(counts: Any) -> None:
    assert [problem.field for problem in faults_of(checked, document(city=counts))] == ["scenarios.city.resources"]
    assert all(problem.field.startswith("simulator") for problem in faults_of(checked, document(counts)))
