"""Campaigns over continuous parameters, integers and choices within constraints, through database and dispatcher."""

import csv
import io
from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from fastapi.testclient import TestClient
from tests.support.computed import ComputedBackend
from tests.support.runs import rows_of, run, study_of, submit
from tests.support.values import faults_of

from drivecal.api.app import create_app
from drivecal.bundles.highway import Scenario
from drivecal.campaigns.resolve.problem import resolve
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.configuration.settings import load_settings
from drivecal.contracts.specification import CampaignSpecification
from drivecal.contracts.work import Cell, CellResult
from drivecal.domain.campaigns import StageName
from drivecal.domain.constraints import Constraint
from drivecal.domain.parameters import Parameter
from drivecal.plugins import registry
from drivecal.plugins.ports import Planner
from drivecal.storage import campaigns
from drivecal.storage.engine.database import Database

WANTED: dict[str, Any] = {"driving_function": "mixed", "parameters": "all", "catalogue": ["S1", "S2"], "name": "mixed"}
BASELINE = {"speed": 12.123456789, "limit": 50, "gears": 2, "mode": "eco", "tyre": "a"}
ANALYSIS = {"intervals": 4, "samples": 12, "threshold": "auto"}


class Mixed:
    """A driving function that is never driven."""

    name = "mixed"
    version = "1"
    spaces: Mapping[str, tuple[Parameter, ...]] = {
        "all": (
            Parameter.from_step("speed", Decimal(0), Decimal(100), None),
            Parameter.from_step("limit", Decimal(0), Decimal(100), Decimal("0.5")),
            Parameter.integer("gears", Decimal(1), Decimal(6)),
            Parameter.choice("mode", ["eco", "sport", "winter"]),
            Parameter.choice("tyre", ["a", "b"]),
        )
    }
    limits: Mapping[str, tuple[float | None, float | None]] = {}
    constraints: Mapping[str, Constraint] = {
        "speed <= limit": lambda values: values["speed"] <= values["limit"],
        "gears * 10 <= limit": lambda values: values["gears"] * 10 <= values["limit"],
    }

    def create(self, scenario: Scenario) -> Planner:
        raise NotImplementedError(scenario)


MIXED = Mixed()


def rated(scenario: str, cell: Cell) -> CellResult:
    """S1 depends on speed up to 40, on gears and on mode; S2 on limit. The tyre matters nowhere."""
    p = cell.parameters
    assert p["speed"] <= p["limit"]
    assert p["gears"] * 10 <= p["limit"]
    if scenario == "S1":
        rating = 4 * min(p["speed"], 40) / 40 + p["gears"] / 4 + {"eco": 0, "sport": 1.4, "winter": 0.6}[p["mode"]]
    else:
        rating = 6 * p["limit"] / 100
    return CellResult(cell.id, rating, round(rating), {"rating": rating}, None, 7.0)


@pytest.fixture(autouse=True)
def _installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "driving_function", lambda *_: MIXED)


@pytest.mark.parametrize("kind", ["genetic", "swarm", "random"])
def test_every_optimizer_keeps_constraints_and_a_budget_that_ends_within_a_round(database: Database, kind: str) -> None:
    wanted = {"sensitivity": None, "reduction": {"mode": "off"}, "budget": {"simulations": 35}}
    search = {"kind": kind, "population": 12, "seed": 3}
    ended = run(database, submit(database, **WANTED | wanted | {"optimizer": search}), ComputedBackend(answer=rated))
    assert 30 < ended.cells.requested <= 35


def test_a_map_of_every_kind_answers_and_is_validated(database: Database) -> None:
    wanted = WANTED | {
        "sensitivity": ANALYSIS,
        "optimizer": {"kind": "genetic", "population": 30, "iterations": 4, "seed": 2},
        "reduction": {"audit": 0.2},
        "validation": {"samples": 30, "references": 4, "largest": 200},
    }
    ended = run(database, submit(database, **wanted), ComputedBackend(answer=rated))
    assert ended.cells.reused > 0
    assert all(not rate.wrong for rate in ended.error_rate.values())
    validated = study_of(database, ended, StageName.VALIDATION)["items"]
    assert {row.parameters.floats["mode"] for row in rows_of(database, ended)} == {"eco", "sport", "winter"}
    assert sum(row["compared"] for row in validated) > 0
    assert [row["wrong"] for row in validated] == [0, 0]
    space = resolved_spec(ended).space
    assert [parameter.kind for parameter in space.parameters] == ["continuous", "grid", "integer", "choice", "choice"]
    assert space.parameters[3].choices == ("eco", "sport", "winter")


def test_texts_reach_every_answer_table_and_file(database: Database, tmp_path: Path) -> None:
    app = create_app(load_settings(database_url=f"sqlite:///{tmp_path / 'drivecal.db'}"))
    with TestClient(app, base_url="http://127.0.0.1") as http:
        wanted = WANTED | {
            "sensitivity": ANALYSIS,
            "optimizer": {"kind": "random", "population": 8, "iterations": 2, "seed": 3},
            "baseline": BASELINE,
            "fixed": {"tyre": "a"},
        }
        accepted = http.post("/api/v1/campaigns", json=wanted).raise_for_status().json()
        with database.read() as connection:
            queued = campaigns.get(connection, accepted["id"])
        run(database, queued, ComputedBackend(answer=rated))
        here = f"/api/v1/campaigns/{accepted['id']}"

        def answer(path: str) -> Any:
            return http.get(path).raise_for_status().json()

        setup = {parameter["name"]: parameter for parameter in answer(f"{here}/setup")["parameters"]}
        assert {name: parameter["kind"] for name, parameter in setup.items()} == {
            "speed": "continuous",
            "limit": "grid",
            "gears": "integer",
            "mode": "choice",
            "tyre": "choice",
        }
        assert setup["mode"]["choices"] == ["eco", "sport", "winter"]
        assert (setup["tyre"]["fixed"], setup["mode"]["fixed"]) == ("a", None)
        assert answer(here)["baseline"]["parameters"] == BASELINE
        first = answer(f"{here}/solutions")["items"][0]
        assert first["parameters"]["mode"] in setup["mode"]["choices"]
        cells = answer(f"{here}/evaluations?limit=1000")["items"]
        assert {cell["mode"] for cell in cells} == {"eco", "sport", "winter"}
        explained = [answer(f"/api/v1/evaluations/{cell['id']}/explain") for cell in cells[-20:]]
        texts = {
            value
            for explanation in explained
            for difference in explanation["differences"]
            for value in (difference["value"], difference["reference_value"])
            if difference["parameter"] == "mode"
        }
        assert texts <= {"eco", "sport", "winter"}
        influence = {(row["scenario"], row["parameter"]): row for row in answer(f"{here}/influence")["items"]}
        assert influence["S1", "mode"]["influential"]
        assert not influence["S2", "mode"]["influential"]
        for table in ("evaluations", "solutions"):
            lines = list(csv.DictReader(io.StringIO(http.get(f"{here}/{table}", headers={"Accept": "text/csv"}).text)))
            assert {line["mode"] for line in lines} <= {"eco", "sport", "winter"}
            assert {line["tyre"] for line in lines} == {"a"}
            parquet = http.get(f"{here}/{table}", headers={"Accept": "application/vnd.apache.parquet"}).raise_for_status()
            columns = pq.read_table(io.BytesIO(parquet.content))
            assert columns["mode"].to_pylist() == [line["mode"] for line in lines]
            assert columns["speed"].to_pylist() == [float(line["speed"]) for line in lines]


def test_an_optimizer_is_refused_for_what_it_does_not_declare(monkeypatch: pytest.MonkeyPatch) -> None:
    class Simple:
        name = "simple"
        settings = registry.optimizer("genetic").settings
        supports = frozenset({"grid", "integer"})

    monkeypatch.setattr(registry, "optimizer", lambda *_: Simple())
    refused = faults_of(resolve, CampaignSpecification.model_validate(WANTED | {"optimizer": {"kind": "genetic"}}))
    assert [problem.field for problem in refused] == ["optimizer.kind"] * 3
    said = " ".join(problem.message for problem in refused)
    assert all(word in said for word in ("continuous parameters (speed)", "choice parameters (mode, tyre)", "constraints"))
