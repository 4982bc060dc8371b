"""Retries and races: one Idempotency-Key makes one campaign, on both databases."""

import uuid
from concurrent.futures import ThreadPoolExecutor
from typing import Any
from unittest.mock import Mock

import httpx
import pytest
from sqlalchemy import text
from tests.support.answered_campaigns import carry_out
from tests.support.server import RunningApi
from tests.support.values import MIDDLE

from drivecal.api import submission
from drivecal.domain.errors import InvalidInputError, Problem

pytestmark = pytest.mark.parametrize("api", ["sqlite", "postgresql"], indirect=True, scope="module")


@pytest.mark.slow("sqlite")
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


REQUESTS: list[tuple[str, dict[str, Any]]] = [
    ("campaigns", {"name": "known"}),
    ("evaluations", {"parameters": MIDDLE, "scenario": "S1"}),
    ("comparisons", {"optimizers": [{"kind": "genetic"}], "populations": [10], "seeds": [1, 2, 3]}),
]


@pytest.mark.parametrize(("path", "body"), REQUESTS)
def test_a_retry_is_known_by_its_key(api: RunningApi, monkeypatch: pytest.MonkeyPatch, path: str, body: dict[str, Any]) -> None:
    headers = {"Idempotency-Key": uuid.uuid4().hex}
    first = api.http.post(f"/api/v1/{path}", json=body, headers=headers)
    for module, name in ((submission, "checked"), (submission, "resolve_evaluation"), (submission, "checked_comparison")):
        monkeypatch.setattr(module, name, Mock(side_effect=InvalidInputError(Problem("evaluator", "unknown"))))
    again = api.http.post(f"/api/v1/{path}", json=body, headers=headers)
    assert (first.status_code, again.status_code, again.json()) == (202, 202, first.json())
    assert api.http.post(f"/api/v1/{path}", json=body).status_code == 422
    other = body | ({"scenario": "S2"} if path == "evaluations" else {"name": "another"})
    assert api.http.post(f"/api/v1/{path}", json=other, headers=headers).status_code == 409


def test_a_retry_of_a_rerun_is_known_again_whatever_became_of_the_first_campaign(api: RunningApi) -> None:
    first = api.http.post(
        "/api/v1/campaigns", json={"optimizer": {"population": 10, "iterations": 2}, "catalogue": ["S1"]}
    ).json()["id"]
    carry_out(api.database, first)
    headers = {"Idempotency-Key": uuid.uuid4().hex}
    posted = [api.http.post(f"/api/v1/campaigns/{first}/rerun", json={"weights": {"S1": 2}}, headers=headers)]
    with api.database.transaction() as connection:
        connection.execute(text("UPDATE campaigns SET state = 'running' WHERE id = :first"), {"first": first})
    posted.append(api.http.post(f"/api/v1/campaigns/{first[:8]}/rerun", json={"weights": {"S1": 2}}, headers=headers))
    assert [answer.status_code for answer in posted] == [202, 202]
    assert posted[0].json()["id"] == posted[1].json()["id"]
    elsewhere = api.http.post("/api/v1/campaigns", json={"weights": {"S1": 2}}, headers=headers)
    assert elsewhere.status_code == 409, "the same body on another path is another request"
