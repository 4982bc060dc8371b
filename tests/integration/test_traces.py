"""Time series of evaluations over HTTP: the workers simulate the evaluation again, and the server keeps the series for a while."""

import gzip
import json
from collections.abc import Callable
from dataclasses import replace
from datetime import timedelta
from typing import Any

import httpx
import pytest
from tests.support.computed import ComputedBackend, computed
from tests.support.problems import REPLAY, ROADS, replayed, store
from tests.support.runs import dispatcher, get, rows_of, run, submit
from tests.support.server import RunningApi
from tests.support.values import MIDDLE, present

from drivecal.client import Client
from drivecal.contracts.evaluation import SeriesAnswer
from drivecal.contracts.work import Cell, CellResult
from drivecal.domain.evaluations import Breakdown
from drivecal.plugins import registry
from drivecal.storage import campaigns, traces
from drivecal.storage.engine.types import now

SERIES = {"s_m": [0.1, 3.0], "speed_mps": [30.0, 29.5]}


FAILING: list[Breakdown] = []
"""The breakdown that traces of P9 = 8 meet at present."""


def traced(scenario: str, cell: Cell) -> CellResult:
    """Returns what a worker gives: time series where they are wanted; for P9 = 7 nothing."""
    result = computed(scenario, cell)
    if cell.parameters["P9"] == 8 and cell.trace and FAILING:
        return CellResult(cell.id, None, None, {}, None, 7.0, FAILING[0], "it took too long")
    if cell.parameters["P9"] == 7:
        return CellResult(cell.id, None, None, {}, None, 7.0, "error", "the driving function gave up")
    document = {"measures": dict(result.metrics), "failure": result.failure, "series": SERIES}
    return replace(result, trace=gzip.compress(json.dumps(document).encode(), mtime=0)) if cell.trace else result


def work(api: RunningApi, answer: Callable[[str, Cell], CellResult] = traced) -> ComputedBackend:
    """Everything that waits is carried out."""
    backend = ComputedBackend(answer=answer)
    one = dispatcher(api.database, backend)
    while True:
        with api.database.read() as connection:
            if not campaigns.active(connection):
                return backend
        one.step()


def evaluated(api: RunningApi, **changes: Any) -> dict[str, Any]:
    answer = api.http.post("/api/v1/evaluations", json={"parameters": MIDDLE | changes, "scenario": "S1"})
    work(api)
    result: dict[str, Any] = api.http.get(answer.headers["location"]).json()
    return result


def ask(api: RunningApi, evaluation: object, **headers: str) -> httpx.Response:
    return api.http.get(f"/api/v1/evaluations/{evaluation}/trace", headers=headers)


def test_the_first_to_ask_has_it_driven_once_more_and_all_get_the_same(api: RunningApi) -> None:
    evaluation = evaluated(api)
    number = evaluation["items"][0]["id"]
    first = ask(api, evaluation["id"])
    assert first.status_code == 202
    assert first.headers["location"] == f"/api/v1/evaluations/{evaluation['id']}/trace"
    assert int(first.headers["retry-after"]) > 0
    assert first.json()["evaluation"] == number
    assert ask(api, number).status_code == 202
    ended = ComputedBackend(answer=traced)
    one = dispatcher(api.database, ended)
    while not ended.sent:
        one.step()
    assert len(work(api).sent) == 1, "both wait for one simulation, which another dispatcher takes up"
    result = ask(api, number)
    assert result.status_code == 200
    assert (result.json()["measures"], result.json()["series"]) == (evaluation["metrics"], SERIES)
    tag = result.headers["etag"]
    assert ask(api, evaluation["id"], **{"If-None-Match": tag}).status_code == 304
    assert result.headers["content-encoding"] == "gzip"
    for refusing in ("identity", "br, gzip;q=0", "gzip; q=0.00"):
        plain = ask(api, number, **{"Accept-Encoding": refusing})
        assert "content-encoding" not in plain.headers
        assert plain.content == result.content
    assert work(api).sent == []
    again = api.http.get(f"/api/v1/evaluations/{evaluation['id']}").json()
    assert again == evaluation, "nothing of the evaluation itself has changed"


def test_a_cell_of_a_campaign_is_driven_in_the_very_vehicle_that_it_had(api: RunningApi) -> None:
    mass = registry.vehicle("single_track").parameters[0]
    heavy = {"model": "single_track", "parameters": {mass.name: mass.maximum}}
    campaign = run(api.database, submit(api.database, vehicle=heavy), ComputedBackend())
    row = next(item for item in rows_of(api.database, campaign) if item.scenario == "S3")
    assert ask(api, row.id).status_code == 202
    with api.database.read() as connection:
        wanted = present(traces.find(connection, row.id))
        made = campaigns.by_sequence(connection, wanted.campaign_sequence)
    work(api)
    assert ask(api, row.id).status_code == 200
    assert made.spec["vehicle"]["parameters"][mass.name] == mass.maximum
    [cell] = rows_of(api.database, made)
    assert (cell.setup_id, cell.parameter_set_id, cell.scenario) == (row.setup_id, row.parameter_set_id, "S3")
    assert (cell.score, cell.run_id) == (row.score, row.run_id) or row.outcome == "reused"
    assert get(api.database, made).cells.unrepeatable == 0
    assert api.http.get("/api/v1/campaigns").json()["items"][0]["id"] == campaign.id, "the list shows campaigns only"


def test_what_cannot_be_driven_again_says_why(api: RunningApi, monkeypatch: pytest.MonkeyPatch) -> None:
    failed = evaluated(api, P9=7)
    number = failed["items"][0]["id"]
    assert ask(api, number).status_code == 202
    work(api)
    answer = ask(api, number)
    assert answer.status_code == 409
    assert "gave up" in answer.json()["detail"]
    assert ask(api, 10**6).status_code == 404
    assert ask(api, "nobody").status_code == 404
    other = evaluated(api)["items"][0]["id"]
    monkeypatch.setattr(type(registry.driving_function("frenet")), "version", "another")
    answer = ask(api, other)
    assert answer.status_code == 409
    assert "another controller than" in answer.json()["detail"]


def test_traces_are_forgotten_after_a_while_and_made_anew(api: RunningApi) -> None:
    numbers = [evaluated(api, P9=value)["items"][0]["id"] for value in (1, 2, 3)]
    for number in numbers:
        ask(api, number)
    with api.database.transaction() as connection:
        traces.prune(connection, now() + timedelta(days=1), 0)
        assert all(traces.find(connection, number) for number in numbers), "they are still being made"
        made = present(traces.find(connection, numbers[0]))
        cancelled = campaigns.by_sequence(connection, made.campaign_sequence)
        campaigns.request_action(connection, cancelled.id, "cancel")
    assert ask(api, numbers[0]).status_code == 202, "somebody else cancelled it"
    work(api)
    with api.database.transaction() as connection:
        traces.prune(connection, now() - timedelta(days=1), 2)
        assert sum(traces.find(connection, number) is not None for number in numbers) == 2
        traces.prune(connection, now() + timedelta(days=1), 2)
        assert not any(traces.find(connection, number) for number in numbers)
    assert ask(api, numbers[1]).status_code == 202
    work(api)
    assert ask(api, numbers[1]).status_code == 200


def test_a_run_on_a_road_network_has_a_replay_with_its_lanes(api: RunningApi) -> None:
    store(api.database, ROADS)
    wanted = {"problem": "roads", "parameters": {"v": 25.0}, "scenario": "merge"}
    answer = api.http.post("/api/v1/evaluations", json=wanted).raise_for_status()
    work(api, replayed)
    number = api.http.get(answer.headers["location"]).json()["items"][0]["id"]
    assert ask(api, number).status_code == 202
    work(api, replayed)
    assert ask(api, number).json()["replay"] == REPLAY
    with Client(api.url) as client:
        trace = client.trace(str(number))
    assert isinstance(trace, SeriesAnswer)
    assert present(trace.replay).model_dump() == REPLAY
    assert (trace.series, trace.measures["distance_m"]) == ({}, 25.0)
