"""Overload is refused, over real HTTP: a full queue, campaigns that are too large, clients that are slow or many."""

import socket
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import func, select
from tests.support.answered_campaigns import carry_out
from tests.support.serve import until
from tests.support.server import RunningApi, new_database, problem_of, serving
from tests.support.values import MIDDLE

from drivecal.api.http import protocol
from drivecal.client.client import Client
from drivecal.domain.errors import InvalidInputError
from drivecal.storage import admission
from drivecal.storage.engine.tables import campaigns

SMALL: dict[str, Any] = {"sensitivity": None, "optimizer": {"population": 10, "iterations": 3}}
SINGLE = {"parameters": MIDDLE}
PLACES = 5


@pytest.fixture(params=["sqlite", "postgresql"])
def api(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningApi]:
    with serving(new_database(request, request.param, tmp_path_factory.mktemp("limits")), queued_campaigns=PLACES) as running:
        yield running


def post(api: RunningApi, body: dict[str, Any], key: str = "", path: str = "campaigns") -> httpx.Response:
    return api.http.post(f"/api/v1/{path}", json=body, headers={"Idempotency-Key": key} if key else {})


@pytest.mark.slow("sqlite")
def test_the_queue_is_never_longer_than_it_may_be_however_many_come_at_once(api: RunningApi) -> None:
    def crowd(number: int) -> httpx.Response:
        return post(api, SINGLE, path="evaluations") if number % 3 == 0 else post(api, SMALL, key=f"key-{number}")

    with ThreadPoolExecutor(25) as pool:
        responses = list(pool.map(crowd, range(50)))
    assert sorted(response.status_code for response in responses) == [202] * PLACES + [429] * (50 - PLACES)
    with api.database.read() as connection:
        assert connection.scalar(select(func.count()).select_from(campaigns)) == PLACES
    refused = next(response for response in responses if response.status_code == 429)
    assert int(refused.headers["retry-after"]) > 0
    assert "5 campaigns" in problem_of(refused, 429)["detail"]


@pytest.mark.slow("postgresql")
def test_a_full_queue_still_knows_what_it_took_and_what_contradicts_it(api: RunningApi) -> None:
    first = post(api, SMALL, key="first").json()
    for _ in range(PLACES - 1):
        assert post(api, SMALL).status_code == 202
    assert post(api, SMALL, key="second").status_code == 429
    assert post(api, SMALL, key="first").json()["id"] == first["id"]
    problem_of(post(api, SMALL | {"name": "other"}, key="first"), 409)
    assert api.http.post("/api/v1/campaigns?validate_only=true", json=SMALL).status_code == 200


@pytest.mark.slow("postgresql")
def test_what_starts_or_is_cancelled_makes_room(api: RunningApi) -> None:
    ids = [post(api, SMALL).json()["id"] for _ in range(PLACES)]
    assert post(api, SMALL).status_code == 429
    api.http.post(f"/api/v1/campaigns/{ids[0]}/cancel").raise_for_status()
    carry_out(api.database, ids[1])
    assert [post(api, SMALL).status_code for _ in range(3)] == [202, 202, 429]
    assert problem_of(post(api, {"weights": {"S1": 2}}, path=f"campaigns/{ids[1]}/rerun"), 429)


@pytest.mark.slow("postgresql")
def test_influence_maps_are_kept_up_to_a_limit(api: RunningApi, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(admission, "MOST_MAPS", PLACES)
    document = {"scenarios": {"S1": {"P1": {"influential": False}}}}
    with ThreadPoolExecutor(10) as pool:
        responses = list(pool.map(lambda _: post(api, document, path="influence-maps"), range(10)))
    assert sorted(response.status_code for response in responses) == [201] * PLACES + [413] * (10 - PLACES)
    refused = next(response for response in responses if response.status_code == 413)
    assert problem_of(refused, 413)["errors"]
    assert len(api.http.get("/api/v1/influence-maps").json()["items"]) == PLACES


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningApi]:
    with serving(f"sqlite:///{tmp_path_factory.mktemp('small') / 'drivecal.db'}", largest_campaign=10_000) as running:
        yield running


@pytest.mark.parametrize(
    ("specification", "field", "said"),
    [
        (
            {"sensitivity": None, "optimizer": {"population": 1000, "iterations": 10}},
            "optimizer",
            "60,000 cells, 60,000 of them here: 1,000 individuals x 10 iterations x 6 scenarios",
        ),
        ({"sensitivity": {}, "optimizer": None}, "sensitivity", "cells, "),
        (
            {"optimizer": {"population": 1500, "iterations": 1}, "sensitivity": {"samples": 4, "intervals": 2}},
            "optimizer",
            "11,160 cells, 9,000 of them here: 1,500 individuals x 1 iterations x 6 scenarios",
        ),
        ({"budget": {"minutes": 10}}, "optimizer", "a budget of 1,000,000 simulations"),
        ({"optimizer": {"kind": "genetic"}, "budget": {"simulations": 20_000}}, "optimizer", "a budget of 20,000 simulations"),
    ],
)
@pytest.mark.parametrize("query", ["", "?validate_only=true"])
def test_a_campaign_that_is_too_large_is_refused_with_its_numbers(
    small: RunningApi, specification: dict[str, Any], field: str, said: str, query: str
) -> None:
    document = problem_of(small.http.post(f"/api/v1/campaigns{query}", json=specification), 413)
    assert [error["field"] for error in document["errors"]] == [field]
    assert said in document["detail"]
    assert "10,000" in document["detail"]
    with Client(small.url) as client, pytest.raises(InvalidInputError, match="reduce"):
        client.submit(specification)


def test_of_many_faulty_query_parameters_the_first_are_listed(small: RunningApi) -> None:
    query = "&".join(f"p{number}={number}" for number in range(1_000))
    errors = problem_of(small.http.get(f"/api/v1/campaigns?{query}"), 422)["errors"]
    assert len(errors) == 101


def test_connections_are_not_taken_without_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(protocol, "MOST_CONNECTIONS", 20)
    with serving(f"sqlite:///{tmp_path / 'drivecal.db'}") as api, ExitStack() as others:
        url = httpx.URL(api.url)
        for _ in range(30):
            others.enter_context(socket.create_connection((url.host, url.port or 80), timeout=20))
        with httpx.Client(base_url=api.url) as client:
            assert client.get("/healthz").status_code == 503
            others.close()
            until(lambda: client.get("/healthz").status_code == 200, "room for others")
