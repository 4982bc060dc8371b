"""The benchmark of clients at the server's limits, on a small server without a dispatcher."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from tests.benchmarks.limits import HEALTH, LONG, Figures, admitted, judged, load
from tests.support.server import serving

STREAMS, QUEUE = 2, 4


@pytest.fixture(scope="module")
def figures(tmp_path_factory: pytest.TempPathFactory) -> Figures:
    """What few clients meet at a server with fewer places."""
    database = f"sqlite:///{tmp_path_factory.mktemp('limits') / 'drivecal.db'}"
    with serving(database, event_streams=STREAMS, queued_campaigns=QUEUE) as api:
        campaign = api.http.post("/api/v1/campaigns", json=LONG).raise_for_status().json()["id"]
        clients = {"polling": 2, "trying": 1, "posting": 6, "streams": STREAMS + 3}
        return asyncio.run(load(api.url, campaign, clients, 2.0))


def test_clients_are_served_or_refused_by_kind_and_nothing_is_lost(figures: Figures) -> None:
    assert figures.keys() == {"polling", "trying", "posting", "streams", HEALTH}
    assert {kind: each["wrong"] for kind, each in figures.items() if each["wrong"]} == {}
    assert (figures["posting"]["served"], figures["streams"]["served"]) == (QUEUE - 1, STREAMS)
    refused = {kind: set(each["refused"]) for kind, each in figures.items()}
    assert refused == {"polling": set(), "trying": set(), "posting": {"429"}, "streams": {"429"}, HEALTH: set()}
    for each in figures.values():
        assert each["served"]
        assert 0 < each["p50_milliseconds"] <= each["p99_milliseconds"]
    assert list(judged(2, figures, STREAMS)) == []


@pytest.mark.parametrize(
    ("times", "kind", "change"),
    [
        (1, "polling", {"refused": {"503": 1}}),
        (2, HEALTH, {"refused": {"503": 1}}),
        (2, "polling", {"wrong": {"status 503 without Retry-After": 1}}),
        (2, "streams", {"open_at_the_end": STREAMS - 1}),
    ],
)
def test_a_broken_promise_is_named(figures: Figures, times: float, kind: str, change: dict[str, Any]) -> None:
    kept = {name: each | {"refused": {}} for name, each in figures.items()}
    assert list(judged(times, kept, STREAMS)) == []
    assert len(list(judged(times, kept | {kind: kept[kind] | change}, STREAMS))) == 1


def test_as_many_ask_as_are_admitted() -> None:
    clients = admitted(1)
    assert (sum(clients.values()) - clients["streams"], clients["streams"]) == (200, 100)
