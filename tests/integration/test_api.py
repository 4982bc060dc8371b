"""The API over real HTTP on a real SQLite file; what the dispatcher would store is stored by hand."""

import asyncio
import csv
import io
from typing import Any

import pyarrow.parquet as pq
import pytest
from tests.support.answered_campaigns import METRICS, carry_out, carry_out_evaluation
from tests.support.server import RunningApi, problem_of
from tests.support.values import MIDDLE

from drivecal.api import expectation
from drivecal.api.http.queries import EvaluationsOf, TableOf
from drivecal.api.routes.tables import list_evaluations, list_generations
from drivecal.contracts.campaign import Pace
from drivecal.domain.errors import NotFoundError

SMALL: dict[str, Any] = {"name": "small", "sensitivity": None, "optimizer": {"population": 10, "iterations": 3}}


def submit(api: RunningApi, specification: dict[str, Any] | None = None, **headers: str) -> dict[str, Any]:
    response = api.http.post("/api/v1/campaigns", json=specification or SMALL, headers=headers)
    assert response.status_code == 202, response.text
    campaign: dict[str, Any] = response.json()
    return campaign


def test_a_submitted_campaign_is_accepted_and_found_at_its_location(api: RunningApi) -> None:
    response = api.http.post("/api/v1/campaigns", json=SMALL)
    assert response.status_code == 202
    campaign = response.json()
    assert response.headers["location"] == f"/api/v1/campaigns/{campaign['id']}" == campaign["links"]["self"]
    result = api.http.get(response.headers["location"]).json()
    assert result == campaign
    assert result["state"] == "queued"
    assert result["spec"]["optimizer"]["population"] == 10
    assert result["spec"]["reduction"]["audit"] == 0.02, "defaults are filled in"
    assert set(result["cells"]) >= {"proposed", "carried_over", "pending", "requested", "repeated", "reused", "certified"}


def test_an_expected_time_holds_the_choice_of_cells(api: RunningApi, monkeypatch: pytest.MonkeyPatch) -> None:
    known = Pace(milliseconds=2.0, measured=True, workers=2)
    monkeypatch.setattr(expectation, "pace", lambda *given: known.model_copy(update={"seconds": given[-1] * 0.001}))
    url = "/api/v1/campaigns?validate_only=true"
    seconds = [api.http.post(url, json={"optimizer": {"kind": kind}}).json()["seconds"] for kind in ("surrogate", "random")]
    assert seconds == [pytest.approx(600 * (0.001 + 0.02)), pytest.approx(37.92)]
    assert api.http.post(url, json={"budget": {"minutes": 0.1}}).json()["seconds"] == pytest.approx(6.0)


def test_an_etag_spares_what_has_not_changed(api: RunningApi) -> None:
    campaign = submit(api)
    url = f"/api/v1/campaigns/{campaign['id']}"
    response = api.http.get(url)
    tag = response.headers["etag"]
    assert float(response.headers["retry-after"]) > 0
    again = api.http.get(url, headers={"If-None-Match": f'"other", {tag}'})
    assert again.status_code == 304
    assert again.content == b""
    assert api.http.get(url, headers={"If-None-Match": '"other"'}).status_code == 200
    carried = carry_out(api.database, campaign["id"])
    changed = api.http.get(url, headers={"If-None-Match": tag})
    assert changed.status_code == 200
    assert changed.json()["state"] == "succeeded"
    assert changed.json()["best"]["parameters"] == carried.sets[-1].floats
    assert "retry-after" not in changed.headers


def test_a_rerun_takes_over_everything_but_what_is_changed(api: RunningApi) -> None:
    first = submit(api, SMALL | {"optimizer": {"population": 10, "iterations": 3, "seed": 7}, "fixed": {"P9": 5}})
    url = f"/api/v1/campaigns/{first['id']}/rerun"
    assert "is queued" in problem_of(api.http.post(url, json={"weights": {"S1": 2}}), 409)["detail"]
    carry_out(api.database, first["id"])
    response = api.http.post(url, json={"weights": {"S1": 2}, "optimizer": {"iterations": 4}})
    assert response.status_code == 202
    second = response.json()
    assert response.headers["location"] == second["links"]["self"] != first["links"]["self"]
    assert second["rerun_of"] == first["id"]
    assert second["name"] == "small (rerun: weights, optimizer)"
    assert second["spec"]["weights"] == {"S1": 2}
    expected = first["spec"]["optimizer"] | {"iterations": 4}
    assert second["spec"]["optimizer"] == expected
    assert second["spec"]["fixed"] == {"P9": 5}


def test_the_rows_of_a_campaign_come_in_pages_and_whole(api: RunningApi) -> None:
    campaign = submit(api, SMALL | {"catalogue": ["S1", "S4"]})
    carried = carry_out(api.database, campaign["id"], individuals=5)
    url = f"/api/v1/campaigns/{campaign['id']}/evaluations"
    first = api.http.get(url, params={"limit": 6}).json()
    rest = api.http.get(url, params={"limit": 6, "cursor": first["next_cursor"]}).json()
    rows = first["items"] + rest["items"]
    assert rest["next_cursor"] is None
    assert [(row["individual"], row["scenario"]) for row in rows] == [(i, s) for i in range(5) for s in ("S1", "S4")]
    names = ["id", "stage", "iteration", "individual", "scenario", *carried.problem.space.names]
    names += ["outcome", "purpose", "score", "rating", "reference", "agrees", "failure", "milliseconds", "worker"]
    names += ["runs", "lot", "confidence", "seed"]
    assert list(rows[0]) == names
    assert rows[2]["P1"] == -14.5
    assert (rows[2]["outcome"], rows[2]["score"], rows[2]["agrees"]) == ("simulated", 1, None)

    text = api.http.get(url, params={"format": "csv"})
    assert text.headers["content-type"].startswith("text/csv")
    assert text.text == api.http.get(url, headers={"Accept": "text/csv"}).text
    table = list(csv.DictReader(io.StringIO(text.text)))
    assert list(table[0]) == names
    assert [row["id"] for row in table] == [str(row["id"]) for row in rows]
    assert (table[2]["P1"], table[2]["purpose"], table[2]["reference"]) == ("-14.5", "search", "")

    parquet = pq.read_table(io.BytesIO(api.http.get(url, params={"format": "parquet"}).content))
    assert parquet.column_names == names
    assert parquet.to_pylist() == rows


@pytest.mark.parametrize(
    ("table", "query"), [(list_evaluations, EvaluationsOf(format="csv")), (list_generations, TableOf(format="csv"))]
)
def test_a_file_of_a_campaign_that_is_deleted_meanwhile_breaks_off(api: RunningApi, table: Any, query: TableOf) -> None:
    campaign = submit(api, SMALL)
    file = table(campaign["id"], query, api.database).body_iterator
    api.http.post(f"/api/v1/campaigns/{campaign['id']}/cancel")
    assert api.http.delete(f"/api/v1/campaigns/{campaign['id']}").status_code == 204
    with pytest.raises(NotFoundError):
        asyncio.run(anext(file))


def test_solutions_are_ranked_by_any_weights(api: RunningApi) -> None:
    campaign = submit(api, SMALL | {"catalogue": ["S1", "S4"]})
    carried = carry_out(api.database, campaign["id"], individuals=5)
    url = f"/api/v1/campaigns/{campaign['id']}/solutions"
    best = api.http.get(url, params={"limit": 1}).json()["items"][0]
    assert best["parameters"] == carried.sets[4].floats
    assert (best["rank"], best["objective"], best["scores"]) == (1, 3.5, {"S1": 4, "S4": 3})
    heavier = api.http.get(url, params={"weights": "S1=3,S4=1"}).json()["items"]
    assert heavier[0]["objective"] == pytest.approx(3.75)
    assert [item["scores"]["S1"] for item in heavier] == [4, 3, 2, 1, 0]
    alone = api.http.get(url, params={"weights": "S1=0"}).json()["items"]
    assert {entry["objective"] for entry in alone} == {3.0}, "a scenario that is not named has weight 1"
    lines = list(csv.DictReader(io.StringIO(api.http.get(url, params={"format": "csv", "limit": 1}).text)))
    assert [line["score_S1"] for line in lines] == ["4", "3", "2", "1", "0"], "the whole table"
    assert lines[0]["P1"] == "-13.0"


@pytest.mark.parametrize(
    ("document", "fields"),
    [
        (
            {"optimizer": {"kind": "genetik", "population": "abc"}, "weights": {"S9": 1}, "reduction": {"audt": 1}},
            ["optimizer.population", "reduction.audt"],  # faults of meaning appear once all fields fit
        ),
        ({"optimizer": {"kind": "genetik"}, "weights": {"S9": 1}}, ["weights.S9", "optimizer.kind"]),
        ({"sensitivity": {"map": "0" * 32}, "weights": {"S9": 1}}, ["weights.S9", "sensitivity.map"]),
        (
            {"optimizer": None, "sensitivity": {"map": "0" * 32}, "robustness": {"of": "1" * 32}},
            ["sensitivity.map", "robustness.of"],
        ),
    ],
)
def test_all_faults_of_a_document_come_in_one_answer(api: RunningApi, document: dict[str, Any], fields: list[str]) -> None:
    for query in ({}, {"validate_only": True}):
        answer = api.http.post("/api/v1/campaigns", json=document, params=query)
        assert [error["field"] for error in problem_of(answer, 422)["errors"]] == fields


def test_faults_of_a_comparison_and_of_an_evaluation_come_together(api: RunningApi) -> None:
    """Faults of single fields come first, then faults of their combination."""
    optimizers = [{"kind": "swarm"}, {"kind": "swarm", "label": ""}]
    comparison = {"optimizers": optimizers, "populations": [10], "seeds": [1, 2, 3], "iterations": 0}
    for document, field in ((comparison, "iterations"), (comparison | {"iterations": 2}, "optimizers[1].label")):
        errors = problem_of(api.http.post("/api/v1/comparisons", json=document), 422)["errors"]
        assert [error["field"] for error in errors] == [field]
    evaluation = {"parameters": MIDDLE | {"Q": 1}, "scenario": "S9"}
    errors = problem_of(api.http.post("/api/v1/evaluations", json=evaluation), 422)["errors"]
    assert [error["field"] for error in errors] == ["scenario", "parameters.Q"]


@pytest.mark.parametrize(
    ("weights", "field"),
    [
        ("S1=-1", "weights.S1"),
        ("S9=1", "weights.S9"),
        ("S1=nan", "weights S1"),
        ("S1", "weights"),
        ("S1=0,S4=0", "weights"),
        ("", "weights"),
    ],
)
def test_weights_that_rank_nothing_are_refused(api: RunningApi, weights: str, field: str) -> None:
    campaign = submit(api, SMALL | {"catalogue": ["S1", "S4"]})
    response = api.http.get(f"/api/v1/campaigns/{campaign['id']}/solutions", params={"weights": weights})
    assert problem_of(response, 422)["errors"][0]["field"] == field


def test_an_influence_map_is_stored_named_and_shown(api: RunningApi) -> None:
    document = {"name": "mine", "scenarios": {"S1": {"P1": {"lower": -10, "upper": 3.5}, "P2": {"influential": False}}}}
    response = api.http.post("/api/v1/influence-maps", json=document)
    assert response.status_code == 201
    posted = response.json()
    assert api.http.get(response.headers["location"]).json() == posted
    assert [(row["parameter"], row["influential"], row["lower"], row["upper"]) for row in posted["rows"]] == [
        ("P1", True, -10, 3.5),
        ("P2", False, None, None),
    ]
    assert api.http.get("/api/v1/influence-maps").json()["items"][0]["id"] == posted["id"]

    campaign = submit(api, SMALL | {"catalogue": ["S1", "S4"], "sensitivity": {"map": posted["id"]}})
    url = f"/api/v1/campaigns/{campaign['id']}/influence"
    rows = api.http.get(url).json()["items"]
    assert len(rows) == 2 * 11
    assert rows[0] == posted["rows"][0]
    assert rows[-1]["influential"], "what a map does not list counts as influential"


def test_a_single_evaluation_shows_its_scenario_at_the_top(api: RunningApi) -> None:
    response = api.http.post("/api/v1/evaluations", json={"parameters": MIDDLE | {"P9": 5.05}, "scenario": "S2"})
    assert response.status_code == 202
    queued = response.json()
    assert (queued["state"], queued["items"], queued["outcome"]) == ("queued", [], None)
    carry_out_evaluation(api.database, queued["id"])
    result = api.http.get(response.headers["location"]).json()
    assert (result["state"], result["scenario"], result["outcome"], result["score"]) == ("succeeded", "S2", "simulated", 0)
    assert result["metrics"] == METRICS
    assert result["parameters"] == MIDDLE | {"P9": 5.05}
    assert [note.partition(":")[0] for note in result["notes"]] == ["P9"]
    row = api.http.get(f"/api/v1/evaluations/{result['items'][0]['id']}").json()
    assert (row["scenario"], row["P1"], row["metrics"]) == ("S2", 0, METRICS)


def test_an_evaluation_of_all_scenarios_has_their_mean_score(api: RunningApi) -> None:
    queued = api.http.post("/api/v1/evaluations", json={"parameters": MIDDLE}).json()
    carry_out_evaluation(api.database, queued["id"])
    result = api.http.get(f"/api/v1/evaluations/{queued['id']}").json()
    assert [item["scenario"] for item in result["items"]] == ["S1", "S2", "S3", "S4", "S5", "S6"]
    assert result["objective"] == pytest.approx(15 / 6)
    assert result["outcome"] is None
    for table in ("answers", "results"):
        problem_of(api.http.get(f"/api/v1/campaigns/{queued['id']}/{table}"), 409)
    assert queued["id"] not in {entry["id"] for entry in api.http.get("/api/v1/campaigns?limit=1000").json()["items"]}


def test_the_inventory_lists_scenarios_parameters_and_references(api: RunningApi) -> None:
    page = api.http.get("/api/v1/scenarios").json()
    assert [row["id"] for row in page["items"] if row["catalogue"] == "highway"] == ["S1", "S2", "S3", "S4", "S5", "S6"]
    assert (page["scores"], page["measures"]["offset_peak_m"]) == (["comfort"], "m")
    spaces = {space["name"]: space["parameters"] for space in api.http.get("/api/v1/parameters").json()["items"]}
    first = spaces["highway"][0]
    assert (first["name"], first["lower"], first["upper"], first["step"]) == ("P1", -15, 14, 0.5)
    assert [entry["n_values"] for entry in spaces["highway_table9"]] == [2**k for k in (6, 5, 8, 11, 4, 4, 8, 11, 5, 5, 8)]
    carry_out(api.database, submit(api)["id"])
    runs = {row["scenario"]: row["runs"] for row in api.http.get("/api/v1/references").json()["items"]}
    assert all(runs[scenario] > 0 for scenario in ("S1", "S6"))
