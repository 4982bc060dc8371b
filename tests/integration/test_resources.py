"""A campaign that needs more of a resource than the server has is refused where it stands."""

from typing import Any

import pytest
from tests.support.problems import store
from tests.support.values import faults_of

from drivecal.api import expectation, submission
from drivecal.api.dependencies import Limits
from drivecal.configuration.settings import load_settings
from drivecal.contracts.specification import CampaignSpecification, EvaluationSpecification
from drivecal.storage import processes
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now

MANIFEST: dict[str, Any] = {
    "problem": "licensed",
    "parameters": {"x": {"lower": 0, "upper": 1}},
    "simulator": {"kind": "command", "command": ["sh", "-c", "{parameters} {results}"], "resources": {"carmaker": 2}},
    "scenarios": {"city": {}, "road": {"resources": {"carmaker": 0}}},
    "measures": {"m": "1"},
    "scores": {"s": {"formula": "m", "direction": "minimise", "range": [0, 1]}},
}
SMALL = {"problem": "licensed", "optimizer": {"kind": "random", "population": 5, "iterations": 1}}


def test_a_campaign_that_needs_more_than_exists_is_refused_with_the_field(database: Database) -> None:
    store(database, MANIFEST)
    campaign = CampaignSpecification.model_validate(SMALL)
    on_the_road = CampaignSpecification.model_validate(SMALL | {"catalogue": ["road"]})
    one = EvaluationSpecification.model_validate({"problem": "licensed", "parameters": {"x": 0.5}})
    few, enough = (Limits.of(load_settings(resources=f"carmaker={count}, vtd=1")) for count in (1, 2))
    for refused in (
        lambda: submission.submit(database, few, campaign, None),
        lambda: expectation.expected(database, few, campaign),
        lambda: submission.evaluate(database, few, one, None),
    ):
        [problem] = faults_of(refused)
        assert problem.field == "problem"
        assert "city needs 2 carmaker" in problem.message
    assert submission.submit(database, enough, campaign, None).state == "queued"
    assert submission.submit(database, few, on_the_road, None).state == "queued"


@pytest.mark.parametrize(("carmaker", "workers"), [(8, 3), (4, 2), (2, 1)])
def test_resources_bound_how_many_workers_an_expected_time_rests_on(database: Database, carmaker: int, workers: int) -> None:
    store(database, MANIFEST)
    with database.transaction() as connection:
        processes.heartbeat(connection, processes.DISPATCHER, 1, now(), {"workers": [{}, {}, {}]})
    limits = Limits.of(load_settings(resources=f"carmaker={carmaker}"))
    assert expectation.expected(database, limits, CampaignSpecification.model_validate(SMALL)).workers == workers


def test_resources_are_read_from_text_and_passed_to_the_servers_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DRIVECAL_RESOURCES", "carmaker=4,vtd=2")
    settings = load_settings()
    assert settings.resources == {"carmaker": 4, "vtd": 2}
    assert settings.environment["DRIVECAL_RESOURCES"] == "carmaker=4,vtd=2"
    for faulty in ("carmaker=4, carmaker=2", "carmaker", "carmaker=many", "a b=1", "carmaker=-1"):
        assert faults_of(load_settings, resources=faulty)[0].field.startswith("resources")
