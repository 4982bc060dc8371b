"""Results of a user's problem under another of its scores, and its measures as columns: from what is stored, without a simulation."""

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import ANY

import httpx
import pytest
from fastapi.testclient import TestClient
from tests.support.computed import ComputedBackend
from tests.support.problems import RANDOM, scored, store
from tests.support.runs import run_posted
from tests.support.server import RunningApi
from tests.support.several import SEARCH, installed

from drivecal.api.app import create_app
from drivecal.api.tables.influence import NEAR
from drivecal.configuration.settings import load_settings
from drivecal.contracts.work import Cell, CellResult
from drivecal.storage.engine.database import Database

MANIFEST = scored("mine", {"x": {"lower": 0, "upper": 1, "step": 0.01}}) | {
    "measures": {"score": "1", "y": "1"},
    "scores": {
        "cost": {"formula": "abs(y - 2)", "direction": "minimise", "range": [0, 10], "failed": 10},
        "gain": {"formula": "10*y - score", "direction": "maximise", "range": [0, 100]},
    },
}
SPEC = RANDOM | {"optimizer": {"kind": "random", "population": 40, "iterations": 1, "seed": 1}}


def simulated(scenario: str, cell: Cell) -> CellResult:
    x = float(cell.parameters["x"])
    if x > 0.8:
        return CellResult(cell.id, None, None, {"score": 0.0}, "collision", 7.0)
    return CellResult(cell.id, None, None, {"score": x, "y": 4 * x + (scenario == "city")}, None, 7.0)


@dataclass(frozen=True)
class Asked:
    """Two campaigns that search the same sets by different scores."""

    http: httpx.Client
    first: str
    other: str


@pytest.fixture
def api(database: Database, tmp_path: Path) -> Iterator[RunningApi]:
    """The API in this process."""
    app = create_app(load_settings(database_url=f"sqlite:///{tmp_path / 'drivecal.db'}"))
    with TestClient(app, base_url="http://127.0.0.1") as http:
        yield RunningApi("", http, database)


def carried_out(api: RunningApi, changes: dict[str, Any]) -> str:
    """The path of a campaign that has ended."""
    return f"/api/v1/campaigns/{run_posted(api, SPEC | changes, ComputedBackend(answer=simulated))}"


@pytest.fixture
def asked(api: RunningApi) -> Asked:
    store(api.database, MANIFEST)
    return Asked(api.http, carried_out(api, {}), carried_out(api, {"evaluator": "gain"}))


def items(asked: Asked, path: str, **query: Any) -> list[dict[str, Any]]:
    answered: list[dict[str, Any]] = asked.http.get(path, params=query).raise_for_status().json()["items"]
    return answered


def test_the_ranking_under_another_score_is_that_of_a_campaign_with_it(asked: Asked) -> None:
    weightings: tuple[dict[str, str], ...] = ({}, {"weights": "city=3"})
    for weights in weightings:
        cost = items(asked, f"{asked.first}/solutions", limit=100, **weights)
        gain = items(asked, f"{asked.first}/solutions", limit=100, score="gain", **weights)
        assert gain == items(asked, f"{asked.other}/solutions", limit=100, **weights)
        assert cost == items(asked, f"{asked.other}/solutions", limit=100, score="cost", **weights)
        assert cost == items(asked, f"{asked.first}/solutions", limit=100, score="cost", **weights)
        assert [solution["parameters"] for solution in gain] != [solution["parameters"] for solution in cost]
        assert gain[0]["objective"] == max(solution["objective"] for solution in gain)


def test_importance_explains_the_objective_of_its_ranking(asked: Asked, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivecal.analysis.importance.LEAST_SETS", 30)

    def importance(campaign: str, **query: str) -> dict[str, Any]:
        answer: dict[str, Any] = asked.http.get(f"{campaign}/importance", params=query).raise_for_status().json()
        return answer

    own, gain = importance(asked.first), importance(asked.first, score="gain")
    assert own["items"]
    assert gain == importance(asked.other) != own
    weighted = importance(asked.first, score="gain", weights="city=1,road=0")
    assert weighted["items"] == importance(asked.other, scenario="city")["items"] != gain["items"]
    refused = [asked.http.get(f"{asked.first}/importance", params=query) for query in ({"score": "none"}, {"weights": "sea=1"})]
    assert [answer.json()["errors"][0]["field"] for answer in refused] == ["score", "weights.sea"]


def test_importance_counts_given_up_sets_where_they_were_simulated(
    asked: Asked, api: RunningApi, monkeypatch: pytest.MonkeyPatch
) -> None:
    search = {"optimizer": {"kind": "surrogate"}, "budget": {"simulations": 60}, "reduction": {"mode": "off"}}
    path = f"{carried_out(api, search)}/importance"

    def importance(**query: str) -> dict[str, Any]:
        answer: dict[str, Any] = asked.http.get(path, params=query).raise_for_status().json()
        return answer

    whole, first = importance()["sets"], max(importance(scenario=name)["sets"] for name in ("city", "road"))
    assert whole < first
    for module in ("analysis.importance", "api.tables.influence"):
        monkeypatch.setattr(f"drivecal.{module}.LEAST_SETS", whole + 1)
    mean = importance()
    assert mean["scenarios"] == ["city", "road"]
    assert NEAR in mean["notes"]
    assert mean["sets"] == first
    assert [item["parameter"] for item in mean["items"]] == ["x"]


BOUNDED: dict[str, Any] = {
    "optimizer": SEARCH | {"iterations": 2},
    "constraints": [
        {"measure": "y", "at_most": 2.0, "failed": 10.0},
        {"score": "cost", "at_most": 1.6},
        {"score": "gain", "at_most": 30.0},
    ],
}


@pytest.fixture
def bounded(asked: Asked, api: RunningApi) -> str:
    """The path of a campaign under constraints on a measure and on its own score; y grows with x, the cost is least at x = 0.5."""
    del asked
    with installed():
        return carried_out(api, BOUNDED)


def amounts(x: float) -> dict[str, float]:
    """Amounts that the constraints bound, in the worse scenario."""
    ys = [4 * x + extra for extra in (0, 1)]
    if x > 0.8:
        return {"y": 10.0, "cost": 10.0, "gain": 0.0}
    return {"y": max(ys), "cost": max(abs(y - 2) for y in ys), "gain": max(10 * y - x for y in ys)}


QUERIES: list[dict[str, str]] = [
    *({}, {"weights": "city=3"}, {"weights": "city=0"}, {"score": "gain"}, {"score": "cost@mine"}, {"score": "gain@mine"})
]


def test_sets_that_keep_the_constraints_come_first_in_every_ranking(asked: Asked, bounded: str, database: Database) -> None:
    gain = {"formula": "200 - y", "direction": "maximise", "range": [0, 200]}
    store(database, MANIFEST | {"scores": PUSHED_LATER | {"gain": gain}})
    for query in QUERIES:
        file = asked.http.get(f"{bounded}/solutions", params={**query, "format": "csv"}).raise_for_status().text
        feasible_first(items(asked, f"{bounded}/solutions", limit=100, **query), file, query)


def feasible_first(ranked: list[dict[str, Any]], file: str, query: dict[str, str]) -> None:
    """Checks the ranking of a query, and its file."""
    for row in ranked:
        expected = amounts(row["parameters"]["x"])
        assert row["constraints"] == pytest.approx(expected)
        # in units of the limit of a measure, and of the range of a score
        shares = (expected["y"] - 2) / 2, (expected["cost"] - 1.6) / 10, (expected["gain"] - 30) / 100
        assert row["violation"] == pytest.approx(sum(max(0, share) for share in shares))
    violations = [round(row["violation"], 9) for row in ranked]
    assert violations == sorted(violations)
    assert violations[0] == 0 < violations[-1]
    kept = [row["objective"] for row in ranked if row["violation"] == 0]
    assert kept == sorted(kept, reverse=query.get("score", "").startswith("gain"))
    first = next(csv.DictReader(io.StringIO(file)))
    assert float(first["constraint_y"]) == pytest.approx(ranked[0]["constraints"]["y"])


def test_the_light_of_a_set_is_its_own(asked: Asked, bounded: str) -> None:
    def light(**place: int) -> dict[str, Any]:
        trust = asked.http.get(f"{bounded}/results", params=place).raise_for_status().json()["trust"]
        kept = [each["numbers"]["bounded"] for each in trust["verdicts"] if each["code"] == "constraints_kept"]
        return {each["code"]: each["light"] for each in trust["verdicts"]} | {"all": trust["answers"][0]["light"], "kept": kept}

    ranked = items(asked, f"{bounded}/solutions", limit=100)
    best, worst = ({name: row[name] for name in ("iteration", "individual")} for row in (ranked[0], ranked[-1]))
    assert light()["all"] == light(**best)["all"] != "red"
    assert light()["kept"] == light(**best)["kept"] == [[ANY, ANY, ANY]]
    assert light(**worst)["constraints_broken"] == light(**worst)["all"] == "red"
    half = asked.http.get(f"{bounded}/results", params={"iteration": 0})
    assert half.status_code == 422
    assert half.json()["errors"][0]["field"] == "individual"
    assert asked.http.get(f"{bounded}/results", params={"iteration": 99, "individual": 0}).status_code == 404


PUSHED_LATER = {"cost": {"formula": "abs(y - 3)", "direction": "minimise", "range": [0, 20], "failed": 30}}


def test_a_formula_of_a_later_push_ranks_what_is_stored(asked: Asked, database: Database) -> None:
    digest = store(database, MANIFEST | {"scores": PUSHED_LATER})
    ranked = items(asked, f"{asked.first}/solutions", limit=100, score="cost@mine")
    assert ranked == items(asked, f"{asked.other}/solutions", limit=100, score=f"cost@{digest}")
    measured = [row for row in ranked if row["parameters"]["x"] <= 0.8]
    for row in measured:
        distances = [abs(4 * row["parameters"]["x"] + extra - 3) for extra in (1, 0)]
        assert row["objective"] == pytest.approx(sum(distances) / 2)
    assert {row["objective"] for row in ranked[len(measured) :]} == {30}
    assert ranked != items(asked, f"{asked.first}/solutions", limit=100, score="cost")
    store(database, MANIFEST)
    own = items(asked, f"{asked.first}/solutions", limit=100)
    assert items(asked, f"{asked.first}/solutions", limit=100, score="cost@mine") == own


def test_a_reference_answers_no_other_score(api: RunningApi) -> None:
    """z matters to the other score alone, so that references answer the own score across z."""
    parameters = {name: {"lower": 0, "upper": 1, "step": 0.05} for name in ("x", "z")}
    scores = {
        "cost": {"formula": "x", "direction": "minimise", "range": [0, 1]},
        "gain": {"formula": "z", "direction": "maximise", "range": [0, 1]},
    }
    store(api.database, MANIFEST | {"parameters": parameters, "measures": {"x": "1", "z": "1"}, "scores": scores})

    def both(scenario: str, cell: Cell) -> CellResult:
        del scenario
        return CellResult(cell.id, None, None, {name: float(cell.parameters[name]) for name in ("x", "z")}, None, 7.0)

    analysed = {"sensitivity": {"intervals": 4, "samples": 4}, "reduction": {"mode": "influence", "max_error": 1, "confirm": 0}}
    path = f"/api/v1/campaigns/{run_posted(api, SPEC | analysed, ComputedBackend(answer=both))}"
    assert api.http.get(path).json()["cells"]["reused"] > 0
    asked = Asked(api.http, path, path)
    by_gain = items(asked, f"{path}/solutions", limit=100, score="gain")
    assert 0 < len(by_gain) < len(items(asked, f"{path}/solutions", limit=100))
    assert all(row["objective"] == pytest.approx(row["parameters"]["z"]) and not row["reused"] for row in by_gain)
