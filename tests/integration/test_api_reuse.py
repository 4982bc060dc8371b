"""Tests of what reuse did, over HTTP, on both databases: explanations, accounts, contradictions, reruns."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest
from tests.support.computed import ComputedBackend
from tests.support.runs import WITH_ANALYSIS, influenced, run
from tests.support.server import RunningApi, new_database, serving
from tests.support.values import present

from drivecal.client import Client
from drivecal.contracts.evaluation import Explanation
from drivecal.contracts.results import CampaignResults, ResultTrust
from drivecal.storage import campaigns


@dataclass(frozen=True)
class Ended:
    """A campaign with an analysis, and its rerun, both ended."""

    api: RunningApi
    first: dict[str, Any]
    rerun: dict[str, Any]

    def rows(self, campaign: dict[str, Any]) -> list[dict[str, Any]]:
        with Client(self.api.url) as client:
            return list(client.rows(campaign["id"], "evaluations"))


def _carry_out(api: RunningApi, campaign: dict[str, Any]) -> dict[str, Any]:
    with api.database.read() as connection:
        stored = campaigns.get(connection, campaign["id"])
    run(api.database, stored, ComputedBackend(answer=influenced))
    ended: dict[str, Any] = api.http.get(campaign["links"]["self"]).json()
    return ended


@pytest.fixture(scope="module", params=["sqlite", pytest.param("postgresql", marks=pytest.mark.slow)])
def ended(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ended]:
    changes = {"reduction": {"mode": "influence", "audit": 0.1, "max_error": 1}}
    with serving(new_database(request, request.param, tmp_path_factory.mktemp("reuse"))) as api:
        submitted = api.http.post("/api/v1/campaigns", json=WITH_ANALYSIS | changes)
        assert submitted.status_code == 202, submitted.text
        first = _carry_out(api, submitted.json())
        again = api.http.post(f"{first['links']['self']}/rerun", json={"weights": {"S1": 3}})
        yield Ended(api, first, _carry_out(api, again.json()))


def test_every_cell_can_be_explained(ended: Ended) -> None:
    reasons = set()
    for row in ended.rows(ended.first)[::29]:
        response = ended.api.http.get(f"/api/v1/evaluations/{row['id']}/explain")
        assert response.status_code == 200, response.text
        result = Explanation.model_validate(response.json())
        assert (result.evaluation, result.outcome, result.score) == (row["id"], row["outcome"], row["score"])
        assert result.sentence
        if row["reference"] is not None:
            assert present(result.reference).evaluation == row["reference"]
        reasons.add(result.reason)
    assert reasons >= {"reused", "simulated"}


def test_references_of_an_earlier_campaign_are_named_with_it(ended: Ended) -> None:
    copied = next(row for row in ended.rows(ended.rerun) if row["outcome"] == "repeated")
    result = ended.api.http.get(f"/api/v1/evaluations/{copied['id']}/explain").json()
    assert result["reason"] == "repeated"
    assert result["reference"]["campaign"] == ended.first["id"]
    assert ended.first["id"] in result["sentence"]


def results_of(ended: Ended, campaign: dict[str, Any]) -> CampaignResults:
    return CampaignResults.model_validate(ended.api.http.get(campaign["links"]["results"]).raise_for_status().json())


def test_the_account_adds_up(ended: Ended) -> None:
    result = present(results_of(ended, ended.first).accounting)
    cells, analysis = ended.first["cells"], ended.first["sensitivity_cells"]
    for name in ("requested", "simulated", "audited", "repeated", "reused"):
        assert sum(getattr(scenario, name) for scenario in result.scenarios) == cells[name]
    assert (result.sensitivity.requested, result.sensitivity.simulated) == (analysis["requested"], analysis["simulated"])
    seconds = 0.007  # of every simulation
    assert result.sensitivity.seconds == pytest.approx(analysis["simulated"] * seconds)
    confirmed = sum(scenario.confirmed for scenario in result.scenarios)
    assert result.saved_seconds == pytest.approx((cells["repeated"] + cells["reused"] - confirmed) * seconds)
    (planned,) = (-item.seconds for item in result.balance if item.name == "dispatcher")
    assert planned > 0
    assert result.net_seconds == pytest.approx(result.saved_seconds - result.sensitivity.seconds - planned)
    simulated = sum(scenario.simulated_seconds for scenario in result.scenarios)
    assert simulated + result.sensitivity.seconds == pytest.approx(ended.first["seconds"]["simulating"])
    assert [scenario.scenario for scenario in result.scenarios] == ["S1", "S2"]
    assert present(result.map).made_by == ended.first["id"]
    saving = (cells["reused"] - confirmed) / cells["requested"]
    assert result.break_even == pytest.approx(analysis["simulated"] / saving, abs=1)


def test_a_rerun_reports_what_it_saved_and_who_paid_for_the_map(ended: Ended) -> None:
    result = present(results_of(ended, ended.rerun).accounting)
    assert result.sensitivity.requested == 0
    assert {item.name for item in result.balance} <= {"repeated", "reused", "dispatcher"}
    assert result.saved_seconds > 0
    assert present(result.map).made_by == ended.first["id"]
    answered = sum(scenario.repeated + scenario.reused for scenario in result.scenarios)
    assert answered > 0.5 * sum(scenario.requested for scenario in result.scenarios)


def test_a_validation_of_its_map_by_another_campaign_changes_the_light_of_a_campaign(ended: Ended) -> None:
    def light() -> dict[str, str]:
        return {each.code: each.light for each in results_of(ended, ended.first).trust.verdicts if each.code.startswith("map")}

    assert light() == {"map_unchecked": "amber"}
    map_id = ended.first["links"]["influence_map"].rpartition("/")[2]
    wanted = {"samples": 20, "references": 3, "largest": 20}
    spec = WITH_ANALYSIS | {"sensitivity": {"map": map_id}, "optimizer": None, "validation": wanted}
    study = _carry_out(ended.api, ended.api.http.post("/api/v1/campaigns", json=spec).json())
    assert study["state"] == "succeeded"
    assert light() == {"map_validated": "amber"}, "20 bases do not show that at most 2 % are wrong"
    assert results_of(ended, study).trust == ResultTrust(answers=[], verdicts=[])


def test_a_check_before_a_campaign_notes_an_analysis_that_does_not_pay(ended: Ended) -> None:
    usual = ended.api.http.post("/api/v1/campaigns?validate_only=true", json=WITH_ANALYSIS).raise_for_status().json()
    assert 4 * usual["sensitivity"] > usual["calibration_at_most"]
    assert set(usual["notes"]) & set(ended.first["notes"])
    assert (usual["measured"], usual["milliseconds"]) == (True, pytest.approx(7.0))
    assert (usual["workers"], usual["seconds"]) == (None, None), "no dispatcher reports any worker"


def test_a_single_evaluation_is_explained_by_its_own_id(ended: Ended) -> None:
    one = {"parameters": {f"P{i}": 0.5 for i in range(1, 12)}}
    alone = ended.api.http.post("/api/v1/evaluations", json=one | {"scenario": "S2"}).json()
    early = ended.api.http.get(f"{alone['links']['self']}/explain")
    assert early.status_code == 409
    _carry_out(ended.api, alone)
    result = ended.api.http.get(f"{alone['links']['self']}/explain").json()
    assert result["reason"] in {"simulated", "repeated"}
    every = ended.api.http.post("/api/v1/evaluations", json=one).json()
    _carry_out(ended.api, every)
    several = ended.api.http.get(f"{every['links']['self']}/explain")
    assert several.status_code == 409
    assert "6 cells" in several.json()["detail"]
    account = ended.api.http.get(f"/api/v1/campaigns/{every['id']}/results")
    assert account.status_code == 409
