"""Campaigns kept in order over HTTP, by the client and by `drivecal label|list|delete`."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.support.answered_campaigns import carry_out
from tests.support.command import Run
from tests.support.server import RunningApi, serving

from drivecal.client import Client

SMALL: dict[str, Any] = {"sensitivity": None, "catalogue": ["S1"], "optimizer": {"population": 10, "iterations": 2}}


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


def test_a_rerun_keeps_the_weights_that_it_does_not_change(api: RunningApi, client: Client) -> None:
    campaign = ended(api, "first")
    weighted = client.rerun(campaign, {"weights": {"S1": 2}})
    assert weighted.spec["weights"] == {"S1": 2}
    assert client.rerun(campaign, {"name": "again"}).spec["weights"] == client.campaign(campaign).spec["weights"]


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
