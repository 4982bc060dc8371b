"""Retries and races: one Idempotency-Key makes one campaign, on both databases."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import pytest
from tests.support.server import RunningApi, new_database, serving


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
