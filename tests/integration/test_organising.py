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


def test_labels_filter_the_list(api: RunningApi, client: Client) -> None:
    first, second = ended(api, "first"), ended(api, "second")
    before = api.http.get("/api/v1/campaigns").headers["etag"]
    labelled = client.label(first[:6], tags=["good", "car-7"])
    assert labelled.tags == ["car-7", "good"]
    assert api.http.get("/api/v1/campaigns").headers["etag"] != before
    assert client.label(first, tags=["good", "car-7"]) == labelled
    assert client.label(first, add_tags=["new"]).tags == ["car-7", "good", "new"]
    assert client.label(first, remove_tags=["new"]).tags == ["car-7", "good"]
    assert names(client, tags=["good"]) == ["first"]
    assert names(client) == ["second", "first"]
    assert client.campaign(second[:6]).id == second


def test_a_rerun_keeps_the_weights_that_it_does_not_change(api: RunningApi, client: Client) -> None:
    campaign = ended(api, "first")
    weighted = client.rerun(campaign[:6], {"weights": {"S1": 2}})
    assert (weighted.rerun_of, weighted.spec["weights"]) == (campaign, {"S1": 2})
    study = client.submit(SMALL | {"optimizer": None, "robustness": {"of": campaign[:6]}})
    assert study.spec["robustness"]["of"] == campaign
    assert client.rerun(campaign, {"name": "again"}).spec["weights"] == client.campaign(campaign).spec["weights"]


def test_the_command_line_labels_lists_and_deletes(run: Run, api: RunningApi) -> None:
    campaign = ended(api, "mine")
    assert run("label", campaign[:6]).exit_code == 2
    assert run("label", campaign[:6], "--tag", "good", "--tag", "bad").exit_code == 0
    changed = json.loads(run("label", campaign[:6], "--untag", "bad", "--json").stdout)
    assert changed["tags"] == ["good"]
    assert json.loads(run("list", "--tag", "bad", "--json").stdout)["items"] == []
    listed = json.loads(run("list", "--tag", "good", "--json").stdout)["items"]
    assert [item["id"] for item in listed] == [campaign]
    assert "good" in run("show", campaign[:6]).stdout
    assert json.loads(run("delete", campaign[:6], "--json").stdout) == {"deleted": [campaign]}
    assert run("show", campaign).exit_code == 5


def test_a_tag_means_all_campaigns_that_have_it_also_those_on_further_pages(
    run: Run, api: RunningApi, client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivecal.cli.commands.campaigns.PAGE", 1)
    for name in ("first", "second", "third"):
        client.label(ended(api, name), tags=["old"])
    assert len(json.loads(run("delete", "--tag", "old", "--json").stdout)["deleted"]) == 3
    assert names(client) == []


def test_a_campaign_to_which_others_refer_is_kept_until_they_are_gone(run: Run, api: RunningApi, client: Client) -> None:
    first, second = ended(api, "first"), ended(api, "second")
    rerun = client.rerun(first, {"weights": {"S1": 2}}).id
    for campaign in (first, second):
        client.label(campaign, tags=["old"])
    refused = api.http.delete(f"/api/v1/campaigns/{first}")
    assert (refused.status_code, rerun in refused.json()["detail"]) == (409, True)
    answer = run("delete", "--tag", "old", "--json")
    assert (answer.exit_code, json.loads(answer.stdout)) == (1, {"deleted": [second]})
    client.act(rerun, "cancel")
    client.delete(rerun)
    client.delete(first)
    client.delete(first)
    assert names(client) == []
