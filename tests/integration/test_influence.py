"""Influence maps over HTTP: made by an analysis or posted by a user, shown within requested bounds."""

import csv
import io
import json
from typing import Any

import pyarrow.parquet as pq
import pytest
from tests.support.answered_campaigns import ANALYSIS, analyse
from tests.support.server import RunningApi
from tests.support.values import present

from drivecal.contracts.tables import InfluenceRow


@pytest.fixture(scope="module")
def analysed(api: RunningApi) -> dict[str, Any]:
    """A campaign whose analysis found P1 up to 0.5 in S1 and nothing in S2, where every run scored 0."""
    campaign: dict[str, Any] = api.http.post("/api/v1/campaigns", json=ANALYSIS).raise_for_status().json()
    analyse(api.database, campaign["id"], lambda scenario, values: 0 if scenario == "S2" else round(7 * min(values["P1"], 0.5)))
    return campaign


def rows_of(api: RunningApi, campaign: dict[str, Any]) -> dict[tuple[str, str], InfluenceRow]:
    items = api.http.get(f"/api/v1/campaigns/{campaign['id']}/influence").raise_for_status().json()["items"]
    rows = [InfluenceRow.model_validate(item) for item in items]
    return {(row.scenario, row.parameter): row for row in rows}


def posted(api: RunningApi, scenarios: dict[str, Any]) -> dict[str, Any]:
    answer: dict[str, Any] = api.http.post("/api/v1/influence-maps", json={"scenarios": scenarios}).raise_for_status().json()
    return answer


def test_an_analysis_gives_bounds_in_units_and_its_measures(api: RunningApi, analysed: dict[str, Any]) -> None:
    rows = rows_of(api, analysed)
    assert list(rows) == [(scenario, f"P{i}") for scenario in ("S1", "S2") for i in range(1, 4)]
    p1, p2 = rows["S1", "P1"], rows["S1", "P2"]
    assert (p1.influential, p1.lower, p1.unknown) == (True, 0, False), "where nothing is cut the space's own bound is given"
    assert 0.5 <= present(p1.upper) <= 0.65
    assert (p1.unit, p1.space_lower, p1.space_upper, p1.n_values) == ("s", 0, 1, 21)
    assert present(p1.mu) > 0
    assert p1.mu_star is not None
    assert p1.s_rel_intervals is not None
    assert len(p1.s_rel_intervals) == 5
    assert p1.s_rel_intervals[-1] == 0
    assert (p2.influential, p2.lower, p2.upper, p2.mu, p2.sigma) == (False, None, None, 0, 0)
    assert (p1.decided_by, p2.decided_by) == ("intervals", "intervals")


def test_a_map_says_what_it_rests_on_and_gives_the_same_rows(api: RunningApi, analysed: dict[str, Any]) -> None:
    url = api.http.get(f"/api/v1/campaigns/{analysed['id']}").json()["links"]["influence_map"]
    result = api.http.get(url).json()
    assert result["source"] == analysed["id"]
    assert result["basis"]["sensitivity"]["intervals"] == 5
    assert [InfluenceRow.model_validate(row) for row in result["rows"]] == list(rows_of(api, analysed).values())
    listed = next(item for item in api.http.get("/api/v1/influence-maps").json()["items"] if item["id"] == result["id"])
    assert (listed["rows"], listed["basis"]) == (None, None)


def test_tables_of_maps_and_campaigns_hold_the_same(api: RunningApi, analysed: dict[str, Any]) -> None:
    campaign = f"/api/v1/campaigns/{analysed['id']}"
    items = api.http.get(f"{campaign}/influence").json()["items"]
    for url in (f"{campaign}/influence", api.http.get(campaign).json()["links"]["influence_map"]):
        table = pq.read_table(io.BytesIO(api.http.get(url, params={"format": "parquet"}).content))
        assert table.to_pylist() == items
        response = api.http.get(url, headers={"Accept": "text/csv"})
        assert response.headers["content-type"].startswith("text/csv")
        lines = list(csv.DictReader(io.StringIO(response.text)))
        assert list(lines[0]) == list(InfluenceRow.model_fields)
        assert json.loads(lines[0]["s_rel_intervals"]) == items[0]["s_rel_intervals"]
        assert (lines[0]["unknown"], lines[-1]["unknown"], lines[1]["lower"]) == ("false", "true", "")


def test_a_map_is_shown_within_the_narrower_bounds_of_a_campaign(api: RunningApi) -> None:
    known = posted(api, {"S1": {"P2": {"lower": 0.5, "upper": 1.5}, "P3": {"upper": 50}, "P4": {"lower": 20}}})
    assert [(row["lower"], row["upper"], row["mu"], row["unknown"]) for row in known["rows"]] == [
        (0.5, 1.5, None, False),
        (0, 50, None, False),
        (20, 2000, None, False),
    ]
    narrow = ANALYSIS | {
        "parameters": [
            {"name": "P2", "lower": 1, "upper": 2, "step": 0.1},
            {"name": "P3", "lower": 60, "upper": 70, "step": 1},
            {"name": "P5", "lower": 0, "upper": 1, "step": 0.1},
        ],
        "fixed": {f"P{i}": 0.5 for i in (1, 4, 6, 7, 8, 9, 10, 11)},
        "sensitivity": {"map": known["id"]},
        "optimizer": {"population": 10, "iterations": 2},
    }
    campaign = api.http.post("/api/v1/campaigns", json=narrow).raise_for_status().json()
    rows = rows_of(api, campaign)
    p2, p3, p5 = (rows["S1", name] for name in ("P2", "P3", "P5"))
    assert (p2.influential, p2.lower, p2.upper) == (True, 1, 1.5)
    assert (p3.influential, p3.lower, p3.upper) == (False, None, None), "all its values lie in one non-influential region"
    assert (p5.influential, p5.unknown, p5.lower, p5.upper) == (True, True, 0, 1), "the map says nothing of it"
    assert rows["S2", "P2"].unknown
    assert not p2.unknown
    assert [row.decided_by for row in (p2, p3, p5)] == ["posted", "space", "unknown"]
