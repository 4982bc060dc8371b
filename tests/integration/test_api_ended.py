"""Tests of what an ended campaign found stays readable, whatever is installed by then."""

from typing import Any

import pytest
from tests.support.answered_campaigns import ANALYSIS, analyse, carry_out, carry_out_evaluation
from tests.support.server import RunningApi

from drivecal.plugins import registry
from drivecal.storage.engine.records import encode_cursor

SMALL = ANALYSIS | {"catalogue": ["S1", "S4"], "weights": {"S1": 3}, "optimizer": {"population": 10, "iterations": 3}}


def posted(api: RunningApi, path: str, document: dict[str, Any]) -> dict[str, Any]:
    answer: dict[str, Any] = api.http.post(f"/api/v1/{path}", json=document).raise_for_status().json()
    return answer


def test_results_are_read_as_before_when_the_plug_ins_are_gone(api: RunningApi, monkeypatch: pytest.MonkeyPatch) -> None:
    campaign = posted(api, "campaigns", SMALL)
    analyse(api.database, campaign["id"], lambda _, values: round(7 * min(values["P1"], 0.5)))
    carry_out(api.database, campaign["id"])
    known = posted(api, "influence-maps", {"scenarios": {"S1": {"P1": {"lower": -10}}}})
    single = posted(api, "evaluations", {"parameters": {f"P{i}": 0.5 for i in range(1, 12)}, "scenario": "S1"})
    carry_out_evaluation(api.database, single["id"])
    first = api.http.get(f"/api/v1/campaigns/{campaign['id']}/evaluations").json()["items"][0]["id"]
    urls = [
        *(f"/api/v1/campaigns/{campaign['id']}/{table}" for table in ("solutions", "solutions?format=csv", "influence")),
        f"/api/v1/campaigns/{campaign['id']}/solutions?weights=S1=1,S4=2",
        f"/api/v1/campaigns/{campaign['id']}/evaluations?format=csv",
        f"/api/v1/campaigns/{single['id']}/evaluations?format=csv",
        f"/api/v1/influence-maps/{known['id']}",
        f"/api/v1/evaluations/{first}/explain",
        f"/api/v1/evaluations/{single['id']}/explain",
    ]
    before = [api.http.get(url).raise_for_status().text for url in urls]
    monkeypatch.setattr(registry, "_installed", lambda _: {})
    assert api.http.post("/api/v1/campaigns", json=SMALL).status_code == 422, "they are gone"
    assert [api.http.get(url).text for url in urls] == before


def test_a_crafted_cursor_counts_nothing_from_the_end(api: RunningApi) -> None:
    campaign = posted(api, "campaigns", SMALL)
    analyse(api.database, campaign["id"], lambda _, values: round(7 * min(values["P1"], 0.5)))
    carry_out(api.database, campaign["id"])
    for table in ("solutions", "influence", "evaluations", "generations"):
        position: tuple[int | str, ...] = (-3, 0, 0, "S1") if table == "evaluations" else (-3,)
        response = api.http.get(f"/api/v1/campaigns/{campaign['id']}/{table}", params={"cursor": encode_cursor(*position)})
        assert (response.status_code, response.json()["errors"][0]["field"]) == (422, "cursor")
