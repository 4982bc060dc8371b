"""Retries and races: one Idempotency-Key makes one campaign, on both databases."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import pytest
from tests.support.found import carry_out
from tests.support.server import RunningApi, new_database, serving

MIDDLE = [0, 1, 100, 1000, 750, 0.5, 100, 1000, 5, 10, 100]


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def api(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningApi]:
    with serving(new_database(request, request.param, tmp_path_factory.mktemp("idempotency"))) as running:
        yield running


def test_fifty_posts_at_once_with_one_key_make_one_campaign(api: RunningApi) -> None:
    def post(number: int) -> httpx.Response:
        body: dict[str, Any] = {"name": "mine" if number % 5 else "another"}
        return api.http.post("/api/v1/campaigns", json=body, headers={"Idempotency-Key": "one"})

    with ThreadPoolExecutor(20) as pool:
        responses = list(pool.map(post, range(50)))
    accepted = [response.json() for response in responses if response.status_code == 202]
    assert {response.status_code for response in responses} == {202, 409}
    assert len({campaign["id"] for campaign in accepted}) == 1
    assert len(accepted) in {10, 40}, "the first body that came is the one that counts"
    listed = api.http.get("/api/v1/campaigns?limit=1000").json()["items"]
    assert [campaign["id"] for campaign in listed] == [accepted[0]["id"]]


def test_fifty_evaluations_at_once_with_one_key_are_one(api: RunningApi) -> None:
    body = {"parameters": {f"P{number}": value for number, value in enumerate(MIDDLE, start=1)}, "scenario": "S1"}

    def post(_: int) -> httpx.Response:
        return api.http.post("/api/v1/evaluations", json=body, headers={"Idempotency-Key": "evaluation"})

    with ThreadPoolExecutor(20) as pool:
        responses = list(pool.map(post, range(50)))
    assert {response.status_code for response in responses} == {202}
    assert len({response.json()["id"] for response in responses}) == 1


def test_fifty_reruns_at_once_with_one_key_are_one_and_no_other_request(api: RunningApi) -> None:
    small = {"sensitivity": None, "optimizer": {"population": 10, "iterations": 2}}
    first = api.http.post("/api/v1/campaigns", json=small).json()["id"]
    carry_out(api.database, first)

    def post(number: int) -> httpx.Response:
        path = f"/api/v1/campaigns/{first}/rerun" if number % 2 else "/api/v1/campaigns"
        return api.http.post(path, json={"weights": {"S1": 2}}, headers={"Idempotency-Key": "rerun"})

    with ThreadPoolExecutor(20) as pool:
        responses = list(pool.map(post, range(50)))
    statuses = [response.status_code for response in responses]
    assert (statuses.count(202), statuses.count(409)) == (25, 25), "the same body on another path is another request"
    assert len({response.json()["id"] for response in responses if response.status_code == 202}) == 1
