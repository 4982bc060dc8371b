"""`drivecal influence` and `drivecal influence-maps` against a real server: what is found, compared, shortened, missing."""

import json
from typing import Any

import pytest
from tests.support.answered_campaigns import ANALYSIS, analyse
from tests.support.command import Run
from tests.support.server import RunningApi

ANALYSED = ANALYSIS | {"name": "mine"}


def campaign(api: RunningApi, document: dict[str, Any]) -> str:
    return str(api.http.post("/api/v1/campaigns", json=document).raise_for_status().json()["id"])


@pytest.fixture(scope="module")
def analysed(api: RunningApi) -> str:
    """P1 matters up to 0.5 in S1; S2 tells nothing."""
    identifier = campaign(api, ANALYSED)
    analyse(api.database, identifier, lambda scenario, values: 0 if scenario == "S2" else round(7 * min(values["P1"], 0.5)))
    return identifier


@pytest.fixture(scope="module")
def other(api: RunningApi) -> str:
    """P1 matters from 0.5 on in both, P2 nowhere; the same settings but for the seed."""
    identifier = campaign(api, ANALYSED | {"sensitivity": {**ANALYSED["sensitivity"], "seed": 2}})
    analyse(api.database, identifier, lambda _, values: round(7 * max(values["P1"] - 0.5, 0)) + 1)
    return identifier


def test_influence_shows_a_table_per_scenario(run: Run, api: RunningApi, analysed: str) -> None:
    result = run("influence", analysed[:10])
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    assert lines[0] == f"campaign {analysed}  mine"
    assert lines[2] == "S1"
    assert lines[4].split()[:3] == ["P1", "yes", "0"]
    assert lines[5].split()[:5] == ["P2", "no", "-", "-", "s"]
    assert any(line.startswith("S2  unknown") for line in lines)
    assert "design lines, 5 intervals, 6 samples, threshold 0.02, seed 1" in result.stdout
    basis = api.http.get(api.http.get(f"/api/v1/campaigns/{analysed}").json()["links"]["influence_map"]).json()["basis"]
    outcome = basis["smallest_s_rel"]["S1"]
    assert lines[-2].split() == ["S1", f"{outcome['intervals']:.3f}", f"{outcome['overall']:.3f}"]
    assert lines[-1].split() == ["S2", *["all", "are", "0"] * 2]
    rows = json.loads(run("influence", analysed, "--json").stdout)
    assert [(row["scenario"], row["parameter"]) for row in rows] == [(s, f"P{i}") for s in ("S1", "S2") for i in (1, 2, 3)]


@pytest.mark.usefixtures("other")
def test_a_map_is_shown_by_its_own_id_as_well(run: Run, api: RunningApi, analysed: str) -> None:
    map_id = api.http.get(f"/api/v1/campaigns/{analysed}").json()["links"]["influence_map"].rpartition("/")[2]
    by_map, by_campaign = run("influence", map_id).stdout, run("influence", analysed).stdout
    assert by_map.splitlines()[1:] == by_campaign.splitlines()[1:]
    shown = run("influence-maps", "show", map_id[:12]).stdout
    assert shown.splitlines()[0] == f"influence map {map_id}  mine  ({analysed})"
    assert shown.splitlines()[1:] == by_map.splitlines()[1:]
    listed = run("influence-maps", "list", "--limit", "1")
    assert len(listed.stdout.splitlines()) == 2


def test_comparing_lists_the_pairs_that_differ_and_the_share_that_agrees(run: Run, analysed: str, other: str) -> None:
    result = run("influence", analysed, "--compare", other)
    assert result.exit_code == 0, result.output
    assert "(33.3 %)" in result.stdout
    differing = [line.split()[:2] for line in result.stdout.splitlines() if line.startswith(("S1 ", "S2 "))]
    assert differing == [["S1", "P1"], ["S2", "P1"], ["S2", "P2"], ["S2", "P3"]]
    assert "0 .. 1 (unknown)" in result.stdout
    outcome = json.loads(run("influence", analysed, "--compare", other, "--json").stdout)
    assert (outcome["pairs"], outcome["agreeing"]) == (6, 2)
    assert outcome["differences"][0]["second"]["upper"] == 1
    assert json.loads(run("influence", analysed, "--compare", analysed, "--json").stdout)["share"] == 1
