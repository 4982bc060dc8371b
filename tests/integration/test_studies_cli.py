"""`drivecal robustness` and `drivecal validate` against a real server whose dispatcher drives on formulas."""

import csv
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.support.command import Run
from tests.support.computed import ComputedBackend
from tests.support.runs import SMALL, influenced, nothing_matters, post_map, working
from tests.support.server import RunningApi

from drivecal.client.client import Client
from drivecal.contracts.work import Cell, CellResult, SetupRequest


def fragile(setup: SetupRequest, cell: Cell) -> CellResult:
    """As `influenced`, in vehicles of up to a twentieth of the mass's range more."""
    result = influenced(setup.scenario, cell)
    if setup.varied["mass"] > 2060 + 0.05 * 1400:
        return CellResult(cell.id, 0.0, 0, result.metrics, "collision", 5.0)
    return result


@pytest.fixture(scope="module", autouse=True)
def _dispatcher(api: RunningApi) -> Iterator[None]:
    with working(api.database, ComputedBackend(driven=fragile)):
        yield


@pytest.fixture(scope="module")
def ended(api: RunningApi) -> str:
    """A calibration on a map that denies every influence."""
    stored = post_map(api.database, nothing_matters())
    document: dict[str, Any] = SMALL | {"sensitivity": {"map": stored}, "catalogue": ["S1", "S2"], "name": "searched"}
    with Client(api.url) as client:
        campaign = client.submit(document)
        for found in client.watch(campaign.id):
            assert found.error is None
    return campaign.id


def newest(api: RunningApi) -> dict[str, Any]:
    """The campaign that was submitted last."""
    campaign: dict[str, Any] = api.http.get("/api/v1/campaigns?limit=1").json()["items"][0]
    return campaign


def test_robustness_makes_the_study_of_an_ended_campaign_and_shows_it(run: Run, api: RunningApi, ended: str) -> None:
    result = run("robustness", ended[:12], "--steps", "4", "--samples", "5", "--delta", "0.02", "--solutions", "3")
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    assert lines[0].split()[:5] == ["rank", "degree", "delta_max", "objective", "scores"]
    assert lines[1].split()[0] == "1"
    assert "(5): up to 45.1 %" in lines[-2], "what five vehicles leave open"
    assert lines[-1].startswith("recommended: rank ")
    assert newest(api)["id"] in result.stderr
    assert api.http.get(f"/api/v1/campaigns/{ended}/robustness").json() == {"items": [], "next_cursor": None}
    made = newest(api)
    assert made["name"] == "searched (robustness)"
    again = run("robustness", made["id"], "--json")
    assert newest(api) == made
    rows = json.loads(again.stdout)
    assert len(rows) <= 3
    assert sum(row["recommended"] for row in rows) == 1
    assert set(rows[0]["scores"]) == {"S1", "S2"}
    table = list(csv.DictReader(io.StringIO(run("export", made["id"], "--table", "robustness").stdout)))
    assert [row["rank"] for row in table] == [str(row["rank"]) for row in rows]
    assert table[0]["degree"] == str(rows[0]["degree"])
    assert float(table[0]["P1"]) == rows[0]["parameters"]["P1"]


def test_an_unknown_vehicle_is_refused_before_anything_is_driven(run: Run, api: RunningApi, ended: str) -> None:
    before = newest(api)["id"]  # a campaign that still runs changes
    refused = run("robustness", ended, "--delta", "0.03", "--vehicle", "hybird")
    assert refused.exit_code != 0
    assert newest(api)["id"] == before


def test_validate_shows_tables_1_and_2(run: Run, api: RunningApi, ended: str) -> None:
    result = run("validate", ended, "--samples", "10", "--references", "4")
    assert result.exit_code == 0, result.output
    words = [line.split() for line in result.stdout.splitlines() if line]
    assert [line[0] for line in words if line[0] in {"scenario", "S1", "S2"}] == ["scenario", "S1", "S2"]
    newest = api.http.get("/api/v1/campaigns?limit=1").json()["items"][0]["id"]
    rows = json.loads(run("validate", newest, "--json").stdout)
    assert rows[0]["different"] > 0  # the map is wrong, and is shown to be
    assert rows[0]["compared"] == rows[0]["bases"] * 4
    table = list(csv.DictReader(io.StringIO(run("export", newest, "--table", "validation").stdout)))
    assert sum(json.loads(table[0]["histogram"])) == rows[0]["compared"]
    assert 1 - 0.025 ** (1 / rows[1]["bases"]) < rows[1]["upper_95"]


def test_a_campaign_without_a_map_has_nothing_to_validate(run: Run, api: RunningApi) -> None:
    posted = api.http.post("/api/v1/campaigns", json=SMALL | {"catalogue": ["S1"]}).json()["id"]
    result = run("validate", posted)
    assert result.exit_code == 1
    assert posted in result.stderr
    with Client(api.url) as client:  # the next tests compare two requests, between which its runs would correct scores
        client.wait(posted, progress=False)


def test_a_campaign_without_a_search_has_a_report(run: Run, api: RunningApi, ended: str, tmp_path: Path) -> None:
    run("robustness", ended, "--steps", "1", "--samples", "2", "--delta", "0.07", "--solutions", "1")
    study = newest(api)["id"]
    result = run("report", study, "-o", str(tmp_path / "report"))
    assert result.exit_code == 0, result.output
    assert (tmp_path / "report" / "index.html").exists()


def test_a_study_in_another_vehicle_is_told_apart(run: Run, api: RunningApi, ended: str) -> None:
    run("robustness", ended, "--steps", "2", "--samples", "2", "--delta", "0.01", "--solutions", "1")
    spec = newest(api)["spec"]
    heavy = spec | {"vehicle": {"model": "single_track", "parameters": {"mass": 2600}}}
    with Client(api.url) as client:
        sets = [client.solutions(ended, limit=1000).items[-1].parameters]
        made = client.wait(client.submit(heavy | {"robustness": spec["robustness"] | {"sets": sets}}).id, progress=False)
        assert sets[0] in [row.parameters for row in client.robustness(made.id)]
        assert [each.in_own_vehicle for each in client.studies(ended).items[:2]] == [False, True]


def test_the_setup_tells_versions_and_the_fingerprints_of_the_reference_table(api: RunningApi, ended: str) -> None:
    result = api.http.get(f"/api/v1/campaigns/{ended}/setup").json()
    known = {item["fingerprint"]: item for item in api.http.get("/api/v1/references").json()["items"]}
    assert [scenario["scenario"] for scenario in result["scenarios"]] == ["S1", "S2"]
    for scenario in result["scenarios"]:
        assert (scenario["driving_function"], scenario["vehicle"], scenario["simulator"]) == tuple(
            known[scenario["fingerprint"]][name] for name in ("driving_function", "vehicle", "simulator")
        )
        assert scenario["weight"] == 0.5
        assert scenario["vehicle_parameters"]["mass"] == 2060
    assert [parameter["name"] for parameter in result["parameters"]] == list(
        api.http.get(f"/api/v1/campaigns/{ended}").json()["best"]["parameters"]
    )
