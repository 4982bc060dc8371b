"""Campaigns whose sets another program proposes, over HTTP: nothing is lost or doubled, and all that holds inside applies."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast
from unittest.mock import create_autospec

import httpx
import numpy as np
import pytest
from tests.support.computed import ComputedBackend
from tests.support.deaths import ends_in_spite_of_deaths
from tests.support.effort import tries
from tests.support.runs import dispatcher, get, submit, working
from tests.support.serve import until
from tests.support.server import RunningApi, new_database, problem_of, serving
from tests.support.tree import PROJECT, loaded
from tests.support.values import faulty_fields

from drivecal.client import Client
from drivecal.client.outside import _key
from drivecal.dispatch.dispatcher import Dispatcher
from drivecal.dispatch.heartbeat import Waits
from drivecal.domain.errors import ConflictError
from drivecal.storage import campaigns
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.outside import answers as outside_answers
from drivecal.storage.outside import sets as outside_sets
from drivecal.storage.outside.sets import OutsideSet

SPACE = [{"name": name, "lower": 0, "upper": 1, "step": 0.05} for name in ("P1", "P3")]
SPEC: dict[str, Any] = {
    "catalogue": ["S1", "S2"],
    "parameters": SPACE,
    "fixed": {f"P{i}": 0.5 for i in (2, *range(4, 12))},
    "optimizer": {"kind": "external"},
}


@pytest.fixture(params=["sqlite", "postgresql"])
def api(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[RunningApi]:
    with serving(new_database(request, request.param, tmp_path)) as running:
        yield running


@pytest.fixture
def sqlite(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[RunningApi]:
    with serving(new_database(request, "sqlite", tmp_path)) as running:
        yield running


def submitted(api: RunningApi, **changes: Any) -> str:
    answer = api.http.post("/api/v1/campaigns", json=SPEC | changes)
    assert answer.status_code == 202, answer.text
    return str(answer.json()["id"])


def sets(first: int, number: int, **more: Any) -> dict[str, Any]:
    """Different sets, with their numbers as keys."""
    points = range(first, first + number)
    values = ({"P1": (point % 21) * 0.05, "P3": (point // 21 % 21) * 0.05} for point in points)
    return {"sets": [{"key": f"k{point}", "parameters": each} | more for point, each in zip(points, values, strict=True)]}


def propose(api: RunningApi, campaign: str, proposed: dict[str, Any]) -> dict[str, Any]:
    answer = api.http.post(f"/api/v1/campaigns/{campaign}/sets", json=proposed)
    assert answer.status_code == 202, answer.text
    return dict(answer.json())


def answers(api: RunningApi, campaign: str, **query: Any) -> dict[str, Any]:
    return dict(api.http.get(f"/api/v1/campaigns/{campaign}/answers", params=query).json())


def finish(api: RunningApi, campaign: str) -> None:
    assert api.http.post(f"/api/v1/campaigns/{campaign}/finish").status_code == 202


def read(api: RunningApi, campaign: str) -> dict[str, Any]:
    return dict(api.http.get(f"/api/v1/campaigns/{campaign}").json())


def steps(work: Dispatcher, number: int = 40) -> None:
    for _ in range(number):
        work.step()


def ended(api: RunningApi, campaign: str, work: Dispatcher) -> dict[str, Any]:
    for _ in range(3_000):
        work.step()
        if (document := read(api, campaign))["ended_at"] is not None:
            return document
    raise AssertionError(document)


@pytest.mark.slow("postgresql")
def test_sets_are_answered_by_cell_in_order_and_the_campaign_ends_when_finished(api: RunningApi) -> None:
    campaign, work = submitted(api, baseline={"P1": 0.5, "P3": 1.0}), dispatcher(api.database, ComputedBackend(1))
    accepted = propose(api, campaign, sets(0, 30))
    assert accepted["numbers"] == {f"k{number}": number + 1 for number in range(30)}
    assert propose(api, campaign, sets(0, 30)) == accepted
    steps(work)
    finish(api, campaign)
    finish(api, campaign)
    document = ended(api, campaign, work)
    whole = answers(api, campaign)
    assert [row["number"] for row in whole["items"]] == sorted({row["number"] for row in whole["items"]})
    assert len({(row["key"], row["scenario"]) for row in whole["items"]}) == len(whole["items"]) == 60
    assert whole["is_complete"]
    middle = whole["items"][29]["number"]
    assert answers(api, campaign, after=middle)["items"] == whole["items"][30:]
    assert answers(api, campaign, after=middle, limit=5)["items"] == whole["items"][30:35]
    assert (document["state"], document["ended_by"], document["cells"]["runs"]) == ("succeeded", "finished", 62)
    assert document["baseline"]["objective"] is not None
    best = max(document["best"]["objective"], document["baseline"]["objective"])
    by_set: dict[str, list[float]] = {}
    for row in whole["items"]:
        by_set.setdefault(row["key"], []).append(row["score"])
        assert row["wrong_at_most"] == 0
        assert row["metrics"]
    assert best == max(document["baseline"]["objective"], *(sum(scores) / 2 for scores in by_set.values()))
    problem_of(api.http.post(f"/api/v1/campaigns/{campaign}/sets", json=sets(100, 1)), 409)
    assert len(api.http.get(f"/api/v1/campaigns/{campaign}/solutions").json()["items"]) > 20
    assert api.http.get(f"/api/v1/campaigns/{campaign}/results").status_code == 200


def test_stored_cells_are_answered_without_a_simulation_and_repeated_sets_once(sqlite: RunningApi) -> None:
    backend = ComputedBackend()
    work = dispatcher(sqlite.database, backend)
    for runs in (20, 0):
        campaign = submitted(sqlite)
        proposed = sets(0, 10)
        proposed["sets"].append({"key": "again", "parameters": proposed["sets"][3]["parameters"]})
        propose(sqlite, campaign, proposed)
        finish(sqlite, campaign)
        cells = ended(sqlite, campaign, work)["cells"]
        assert (cells["runs"], cells["simulated"] + cells["repeated"]) == (runs, 22)
        assert len(answers(sqlite, campaign)["items"]) == 22
    assert len(backend.sent) == 20


def test_a_budget_of_simulations_ends_the_campaign_exactly(sqlite: RunningApi) -> None:
    campaign = submitted(sqlite, budget={"simulations": 31})
    propose(sqlite, campaign, sets(0, 100))
    document = ended(sqlite, campaign, dispatcher(sqlite.database))
    page = answers(sqlite, campaign)
    assert (document["ended_by"], document["cells"]["runs"], len(page["items"])) == ("budget", 30, 30)  # whole sets
    assert page["is_complete"]


def test_few_cells_are_asked_for_ahead_so_that_sets_can_be_cancelled(sqlite: RunningApi) -> None:
    backend = ComputedBackend()
    campaign, work = submitted(sqlite), dispatcher(sqlite.database, backend)
    propose(sqlite, campaign, sets(0, 200, scenarios=["S1"]))
    while len(backend.sent) < 4:
        work.step()
    sets_url = f"/api/v1/campaigns/{campaign}/sets"
    assert sqlite.http.delete(f"{sets_url}/k0").json() == {"key": "k0", "number": 1, "cancelled": False}
    assert read(sqlite, campaign)["cells"]["proposed"] < 100
    cancelled = [
        key
        for key in (f"k{number}" for number in range(100, 200))
        if sqlite.http.delete(f"{sets_url}/{key}").json()["cancelled"]
    ]
    assert len(cancelled) == 100
    problem_of(sqlite.http.delete(f"{sets_url}/other"), 404)
    assert propose(sqlite, campaign, sets(199, 1, scenarios=["S1"]))["numbers"] == {"k199": 200}  # waits again
    cancelled.remove("k199")
    finish(sqlite, campaign)
    assert ended(sqlite, campaign, work)["cells"]["requested"] == 101
    assert propose(sqlite, campaign, sets(0, 9, scenarios=["S1"]))["numbers"]["k8"] == 9  # known keys, also after the end
    page = answers(sqlite, campaign)["items"]
    assert {row["scenario"] for row in page} == {"S1"}
    assert not {row["key"] for row in page} & set(cancelled)


@pytest.mark.slow("postgresql")
def test_a_set_cancelled_during_planning_is_not_asked_for(api: RunningApi, monkeypatch: pytest.MonkeyPatch) -> None:
    campaign, work = submitted(api), dispatcher(api.database, ComputedBackend())
    propose(api, campaign, sets(0, 6))
    late, waiting = ["k0", "k3"], outside_sets.waiting

    def then_cancelled(*here: Any) -> tuple[bool, list[OutsideSet]]:
        result = waiting(*here)
        while late and result[1]:
            assert api.http.delete(f"/api/v1/campaigns/{campaign}/sets/{late.pop()}").json()["cancelled"]
        return result

    monkeypatch.setattr(outside_sets, "waiting", then_cancelled)
    steps(work)
    finish(api, campaign)
    assert ended(api, campaign, work)["state"] == "succeeded"
    assert {row["key"] for row in answers(api, campaign)["items"]} == {"k1", "k2", "k4", "k5"}


def test_values_between_grid_points_are_rounded_and_others_are_refused_by_field(sqlite: RunningApi) -> None:
    campaign = submitted(sqlite)
    near = propose(sqlite, campaign, {"sets": [{"key": "a", "parameters": {"P1": 0.5234, "P3": 0.25, "P2": 0.5}}]})
    assert near["changed"] == {"a": {"P1": 0.5, "P3": 0.25} | SPEC["fixed"]}
    url = f"/api/v1/campaigns/{campaign}/sets"
    faults = {
        "sets[0].parameters.P1": {"P1": 1.2, "P3": 0.5},
        "sets[0].parameters.P3": {"P1": 0.5},
        "sets[0].parameters.P9": {"P1": 0.5, "P3": 0.5, "P9": 0.1},
        "sets[0].parameters.nonsense": {"P1": 0.5, "P3": 0.5, "nonsense": 1},
    }
    for field, values in faults.items():
        refused = problem_of(sqlite.http.post(url, json={"sets": [{"key": "b", "parameters": values}]}), 422)
        assert [error["field"] for error in refused["errors"]] == [field]
    elsewhere = {"key": "b", "parameters": {"P1": 0, "P3": 0}, "scenarios": ["S5"]}
    assert problem_of(sqlite.http.post(url, json={"sets": [elsewhere]}), 422)["errors"][0]["field"] == "sets[0].scenarios"
    problem_of(sqlite.http.post(url, json={"sets": [{"key": "a", "parameters": {"P1": 0.6, "P3": 0.25}}]}), 409)
    problem_of(sqlite.http.post(url, json={"sets": [{"key": "c", "parameters": {"P1": 0, "P3": 0}}] * 2}), 422)
    own = sqlite.http.post("/api/v1/campaigns", json=SPEC | {"optimizer": {"kind": "random"}}).json()["id"]
    problem_of(sqlite.http.post(f"/api/v1/campaigns/{own}/sets", json=sets(0, 1)), 409)
    problem_of(sqlite.http.post(f"/api/v1/campaigns/{own}/finish"), 409)


def test_sets_outside_of_the_space_are_repaired_on_request(sqlite: RunningApi) -> None:
    campaign = submitted(sqlite, optimizer={"kind": "external", "infeasible": "repair"})
    changed = propose(sqlite, campaign, {"sets": [{"key": "a", "parameters": {"P1": 1.2, "P3": -5}}]})["changed"]
    assert (changed["a"]["P1"], changed["a"]["P3"]) == (1, 0)


@pytest.mark.slow
def test_a_campaign_that_waits_for_sets_takes_no_place_and_says_so(api: RunningApi) -> None:
    fed, other = submitted(api), submitted(api, optimizer={"kind": "random", "population": 5, "iterations": 1})
    said: list[Waits] = []
    work = dispatcher(api.database, ComputedBackend(1), running_campaigns=1, report=lambda *parts: said.append(parts[2]))
    propose(api, fed, sets(0, 3))
    assert ended(api, other, work)["state"] == "succeeded"
    work = dispatcher(api.database, ComputedBackend(1), running_campaigns=1, report=lambda *parts: said.append(parts[2]))
    for _ in range(3_000):
        work.step()
        if said and said[-1].campaigns:
            break
    with api.database.transaction() as connection:
        campaigns.explain(connection, said[-1].campaigns)
    [waiting] = api.http.get("/api/v1/workers").json()["waiting"]
    assert (waiting["id"], waiting["reason"]) == (fed, outside_sets.AWAITED)
    assert read(api, fed)["waiting"] == outside_sets.AWAITED
    assert 'drivecal_campaigns_waiting{for="sets"} 1.0' in api.http.get("/metrics").text
    full = submitted(api)
    propose(api, full, sets(50, 300))
    propose(api, fed, sets(10, 2))
    for _ in range(3_000):
        work.step()
        if len(answers(api, fed)["items"]) == 10:
            break
    assert len(answers(api, fed)["items"]) == 10
    assert read(api, full)["state"] == "running", "it has the place, and the first one went on"


def test_a_request_may_wait_for_an_answer(sqlite: RunningApi) -> None:
    campaign = submitted(sqlite)
    empty = answers(sqlite, campaign, wait=0.5)
    assert (empty["items"], empty["last"], empty["is_complete"]) == ([], 0, False)
    with pytest.raises(httpx.ReadTimeout):
        sqlite.http.get(f"/api/v1/campaigns/{campaign}/answers", params={"wait": 60}, timeout=0.5)
    until(lambda: "drivecal_http_event_streams 0.0" in sqlite.http.get("/metrics").text, "the end of its wait", 30)


def test_a_set_costs_five_transactions(sqlite: RunningApi, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivecal.dispatch.dispatcher.TIDY_SECONDS", math.inf)
    campaign, work = submitted(sqlite), dispatcher(sqlite.database, ComputedBackend(1))
    propose(sqlite, campaign, sets(0, 1))
    while len(answers(sqlite, campaign)["items"]) < 2:
        work.step()
    written = create_autospec(Database.transaction, side_effect=Database.transaction)
    monkeypatch.setattr(Database, "transaction", written)
    propose(sqlite, campaign, sets(1, 1, scenarios=["S1"]))
    assert written.call_count == 1
    while len(answers(sqlite, campaign)["items"]) < 3:
        work.step()
    assert written.call_count == 5  # the cells of a round, their lease, their results, the end of the round


@pytest.mark.slow
def test_a_thousand_sets_go_in_one_request(sqlite: RunningApi) -> None:
    space = [{"name": name, "lower": 0, "upper": 1, "step": 0.001} for name in ("P1", "P3")]
    campaign = submitted(sqlite, parameters=space, catalogue=["S1"])
    points = [{"key": f"k{point}", "parameters": {"P1": point / 1000, "P3": 0.123}} for point in range(1001)]
    assert len(propose(sqlite, campaign, {"sets": points[:1000]})["numbers"]) == 1000
    problem_of(sqlite.http.post(f"/api/v1/campaigns/{campaign}/sets", json={"sets": points}), 422)
    finish(sqlite, campaign)
    assert ended(sqlite, campaign, dispatcher(sqlite.database))["cells"]["simulated"] == 1000
    page = answers(sqlite, campaign)
    assert [row["number"] for row in page["items"]] == list(range(1, 1001))
    assert answers(sqlite, campaign, after=page["last"])["is_complete"]


def begun(database: Database) -> StoredCampaign:
    """A campaign with some equal sets, that was asked to finish."""
    campaign = submit(database, **SPEC | {"baseline": {"P1": 0.5, "P3": 1.0}})
    with database.transaction() as connection:
        proposed = [OutsideSet(f"k{number}", [number % 17, number % 5]) for number in range(24)]
        outside_sets.add(connection, campaign, [*proposed, OutsideSet("again", [1, 1]), OutsideSet("part", [20, 1], ["S2"])])
        outside_sets.finish(connection, campaign)
    return campaign


def told(database: Database, campaign: StoredCampaign) -> tuple[Any, ...]:
    """The answers of the outside optimizer; their order may differ. A copy whose first cell is under way counts as simulated."""
    with database.read() as connection:
        rows = outside_answers.after(connection, campaign, 0, 1_000)
    after = get(database, campaign)
    numbers = [row.number for row in rows]
    assert len(set(numbers)) == len(numbers)
    cells = sorted((row.key, row.scenario, row.score, row.rating) for row in rows)
    answered = after.cells.simulated + after.cells.repeated
    return cells, after.state, after.best, answered, after.search and after.search.ended_by


def test_a_dispatcher_that_is_killed_at_any_moment_loses_and_doubles_nothing(tmp_path: Path) -> None:
    ends = ends_in_spite_of_deaths(tmp_path, begun, ComputedBackend, told, tries(45, 1))
    assert len(ends) > tries(3, 10)
    assert len(ends[0][0]) == 51
    assert all(end == ends[0] for end in ends)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["optuna", "cma", "scipy"])
def test_the_example_of_an_optimizer_uses_its_budget(sqlite: RunningApi, tmp_path: Path, name: str) -> None:
    file = tmp_path / "spec.json"
    file.write_text(json.dumps(SPEC | {"optimizer": {"kind": "external", "infeasible": "repair"}}))
    example = PROJECT / "deploy" / "examples" / "optimizers" / f"with_{name}.py"
    assert len(example.read_text().splitlines()) <= 40
    module = loaded(f"with_{name}", example)
    backend = ComputedBackend()
    with working(sqlite.database, backend), Client(sqlite.url) as client:
        assert module.search(client, str(file), 40) > 0
        (campaign,) = client.campaigns().items
        assert (campaign.state, campaign.ended_by) == ("succeeded", "budget")
        assert 36 <= campaign.cells.runs == len(backend.sent) <= 40


def test_a_program_that_starts_again_goes_on_without_new_simulations(sqlite: RunningApi) -> None:
    half: Any = np.float32(0.5)
    backend, points = ComputedBackend(), [{"P1": number / 20, "P3": half} for number in range(10)]
    with working(sqlite.database, backend), Client(sqlite.url) as client:
        search = client.ask_tell(SPEC)
        first = search.evaluate(points[:6])
        again = client.ask_tell(resume=search.campaign.id)
        assert again.evaluate(points[:6]) == first
        assert len(backend.sent) == 12
        with again:
            whole = again.evaluate([*points, points[0]])
        campaign = again.result()
        own = client.submit(SPEC | {"optimizer": {"kind": "genetic"}})
        with pytest.raises(ConflictError):
            client.ask_tell(resume=own.id)
        assert faulty_fields(client.ask_tell, SPEC | {"optimizer": {"kind": "genetic"}}) == ["optimizer.kind"]
        budget = {"budget": {"simulations": np.int64(7)}, "optimizer": {"start_sets": []}}
        assert client.ask_tell(SPEC | budget).campaign.spec["optimizer"]["kind"] == "external"
        assert faulty_fields(client.submit, {"budget": Path()}) == [""]
        assert faulty_fields(client.evaluation, "16") == ["identifier"]
    assert whole[0] == whole[-1]
    assert _key({"tank": cast("Any", np.array([1.0, 2.5]))}) == _key({"tank": [1.0, 2.5]})
    assert campaign.best is not None
    assert campaign.best.objective == max(answer.objective or 0 for answer in whole)
    assert min(whole, key=lambda answer: answer.loss).objective == campaign.best.objective


def test_a_campaign_that_others_feed_is_not_compared(sqlite: RunningApi) -> None:
    compared = {"optimizers": [{"kind": "external"}, {"kind": "random"}], "seeds": [1, 2, 3], "populations": [10]}
    refused = problem_of(sqlite.http.post("/api/v1/comparisons", json=compared, headers={"Idempotency-Key": "a"}), 422)
    assert [error["field"] for error in refused["errors"]] == ["optimizers[0].kind"]
