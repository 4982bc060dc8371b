"""Campaigns kept in order over HTTP, by the client and by `drivecal label|list|delete`."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.support.answered_campaigns import carry_out
from tests.support.command import Run
from tests.support.server import RunningApi, serving

from drivecal.client import Client
from drivecal.domain.errors import ConflictError, NotFoundError

SMALL: dict[str, Any] = {"sensitivity": None, "catalogue": ["S1"], "optimizer": {"population": 10, "iterations": 2}}
READER, WRITER = "reader-0123456789abcdef", "writer-0123456789abcdef"


@pytest.fixture
def api(tmp_path: Path) -> Iterator[RunningApi]:
    with serving(f"sqlite:///{tmp_path / 'drivecal.db'}") as running:
        yield running


@pytest.fixture
def client(api: RunningApi) -> Iterator[Client]:
    with Client(api.url, "") as opened:
        yield opened


def ended(api: RunningApi, name: str) -> str:
    campaign = api.http.post("/api/v1/campaigns", json=SMALL | {"name": name}).raise_for_status().json()
    carry_out(api.database, campaign["id"])
    return str(campaign["id"])


def names(client: Client, **query: Any) -> list[str]:
    return [campaign.name for campaign in client.campaigns(**query).items]


def test_labels_filter_the_list_and_archived_campaigns_are_hidden_but_found(api: RunningApi, client: Client) -> None:
    first, second = ended(api, "first"), ended(api, "second")
    before = api.http.get("/api/v1/campaigns").headers["etag"]
    labelled = client.label(first[:6], tags=["good", "car-7"], comment="for the review")
    assert (labelled.tags, labelled.comment) == (["car-7", "good"], "for the review")
    assert client.label(first, tags=["good", "car-7"]) == labelled
    assert client.label(first, add_tags=["new"]).tags == ["car-7", "good", "new"]
    assert client.label(first, remove_tags=["new"]).tags == ["car-7", "good"]
    assert names(client, tags=["good"]) == ["first"]
    client.label(first, archived=True)
    assert api.http.get("/api/v1/campaigns").headers["etag"] != before
    assert (names(client), names(client, archived="only"), names(client, archived="with")) == (
        ["second"],
        ["first"],
        ["second", "first"],
    )
    assert client.campaign(first[:6]).archived_at is not None
    client.label(first, archived=False)
    assert names(client) == ["second", "first"]
    assert client.full_id(second[:6]) == second


@pytest.mark.parametrize(
    "changes",
    [
        {"tags": ["two words"]},
        {"tags": ["a,b"]},
        {"add_tags": ["two words"]},
        {"add_tags": ["good"], "tags": ["good"]},
        {"remove_tags": [], "tags": []},
        {"tags": [""]},
        {"tags": ["\0"]},
        {"comment": "\0"},
        {"name": ""},
        {"state": "x"},
    ],
)
def test_a_label_that_cannot_be_stored_is_refused_by_its_field(api: RunningApi, changes: dict[str, Any]) -> None:
    campaign = api.http.post("/api/v1/campaigns", json=SMALL).json()["id"]
    refusal = api.http.patch(f"/api/v1/campaigns/{campaign}", json=changes)
    assert refusal.status_code == 422
    assert refusal.json()["errors"][0]["field"].startswith(next(iter(changes)))


def test_deleting_twice_is_deleting_and_what_was_simulated_is_still_explained(api: RunningApi, client: Client) -> None:
    campaign = ended(api, "gone")
    rows = client.rows(campaign, "evaluations")
    number = next(row["id"] for row in rows if row["outcome"] == "simulated")
    for _ in range(2):
        deletion = client.delete(campaign)
        assert (deletion.deleted, deletion.archived, deletion.referring) == (True, False, [])
    with pytest.raises(NotFoundError):
        client.campaign(campaign)
    assert names(client, archived="with") == []
    assert client.explanation(str(number)).evaluation == number
    assert api.http.get(f"/api/v1/evaluations/{number}").json()["campaign"]["id"] == campaign


def test_a_rerun_keeps_the_weights_that_it_does_not_change(api: RunningApi, client: Client) -> None:
    campaign = ended(api, "first")
    weighted = client.rerun(campaign, {"weights": {"S1": 2}})
    assert weighted.spec["weights"] == {"S1": 2}
    assert client.rerun(campaign, {"name": "again"}).spec["weights"] == client.campaign(campaign).spec["weights"]


def test_a_rerun_of_a_single_evaluation_is_refused_by_the_server(client: Client, run: Run) -> None:
    single = client.evaluate({"parameters": dict.fromkeys((f"P{number}" for number in range(1, 12)), 0.5), "scenario": "S1"}).id
    with pytest.raises(ConflictError):
        client.rerun(single, {"evaluator": "learned"})
    refused = run("rerun", single, "--evaluator", "learned")
    assert (refused.exit_code, type(refused.exception)) == (1, SystemExit)


def test_a_campaign_with_a_rerun_is_archived_instead_with_the_reason(api: RunningApi, client: Client) -> None:
    campaign = ended(api, "first")
    with pytest.raises(ConflictError):
        client.delete(client.rerun(campaign, {"weights": {"S1": 2}}).id)
    [rerun, first] = client.campaigns().items
    deletion = client.delete(campaign)
    assert (deletion.deleted, deletion.archived) == (False, True)
    assert [(reference.campaign, reference.use) for reference in deletion.referring] == [(rerun.id, "rerun of it")]
    assert client.delete(first.id) == deletion
    assert names(client) == [rerun.name]


def test_a_reader_changes_and_deletes_nothing(tmp_path: Path) -> None:
    (tmp_path / "tokens").write_text(f"anna read {READER}\nben write {WRITER}\n")
    with serving(f"sqlite:///{tmp_path / 'drivecal.db'}", tokens_file=str(tmp_path / "tokens")) as api:
        writes = {"Authorization": f"Bearer {WRITER}"}
        reads = {"Authorization": f"Bearer {READER}"}
        campaign = api.http.post("/api/v1/campaigns", json=SMALL, headers=writes).json()["id"]
        view = api.http.post("/api/v1/views", json={"name": "mine", "address": "#/"}, headers=writes).json()["id"]
        requests = [
            ("PATCH", f"campaigns/{campaign}", {"tags": ["a"]}),
            ("DELETE", f"campaigns/{campaign}", None),
            ("POST", "views", {"name": "other", "address": "#/"}),
            ("PATCH", f"views/{view}", {"name": "other"}),
            ("DELETE", f"views/{view}", None),
        ]
        answers = [api.http.request(method, f"/api/v1/{path}", json=body, headers=reads) for method, path, body in requests]
        assert [answer.status_code for answer in answers] == [403] * 5
        assert [view["name"] for view in api.http.get("/api/v1/views", headers=reads).json()["items"]] == ["mine"]


def test_views_are_saved_for_a_campaign_or_for_all(api: RunningApi, client: Client) -> None:
    campaign = api.http.post("/api/v1/campaigns", json=SMALL).json()["id"]
    mine = {"name": "best", "address": "#/campaigns/x?b.P1=0:1", "campaign": campaign}
    saved = api.http.post("/api/v1/views", json=mine)
    assert (saved.status_code, saved.headers["location"]) == (201, f"/api/v1/views/{saved.json()['id']}")
    assert api.http.post("/api/v1/views", json=mine).json() == saved.json()
    api.http.post("/api/v1/views", json={"name": "all", "address": "#/workers"})
    assert [view.name for view in client.saved_views(campaign)] == ["all", "best"]
    assert [(view.name, view.campaign) for view in client.saved_views()] == [("all", None)]
    for wrong in ({"address": "https://elsewhere"}, {"address": "javascript:alert(1)"}, {"name": ""}):
        assert api.http.post("/api/v1/views", json=mine | wrong).status_code == 422
    assert api.http.post("/api/v1/views", json=mine | {"campaign": "0" * 32}).status_code == 404
    for _ in range(2):
        assert api.http.delete(f"/api/v1/views/{saved.json()['id']}").status_code == 204
    assert [view.name for view in client.saved_views(campaign)] == ["all"]


def test_the_command_line_labels_lists_and_deletes(run: Run, api: RunningApi) -> None:
    campaign = ended(api, "mine")
    assert run("label", campaign[:6]).exit_code == 2
    assert run("label", campaign[:6], "--tag", "good", "--tag", "bad", "--comment", "why").exit_code == 0
    changed = json.loads(run("label", campaign[:6], "--untag", "bad", "--archive", "--json").stdout)
    assert (changed["tags"], changed["comment"]) == (["good"], "why")
    assert json.loads(run("list", "--json").stdout)["items"] == []
    listed = json.loads(run("list", "--archived", "--tag", "good", "--json").stdout)["items"]
    assert [item["id"] for item in listed] == [campaign]
    assert "good" in run("show", campaign[:6]).stdout
    assert json.loads(run("delete", campaign[:6], "--json").stdout)["deleted"]
    assert run("show", campaign).exit_code == 5
