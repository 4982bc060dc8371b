"""The example of the built-in planner on a road network, as a campaign on two workers without Ray."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import httpx
import pytest
from tests.support.motorways import driven
from tests.support.serve import serving
from tests.support.user_problems import problem

from drivecal.client import Client
from drivecal.client.problems import read_bundle

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
SPEC: dict[str, Any] = {
    "problem": "planner-highway",
    "sensitivity": None,
    "optimizer": {"kind": "genetic", "population": 4, "iterations": 1, "seed": 3},
    "reduction": {"mode": "off"},
}


def test_the_planner_is_calibrated_and_gives_the_same_bits_in_any_worker(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = problem("planner-highway", tmp_path)
    manifest, _ = read_bundle(folder)
    monkeypatch.setenv("DRIVECAL_HOME", str(tmp_path / "home"))
    cache = str(tmp_path / "cache")
    with (
        serving(tmp_path, workers=2, DRIVECAL_BACKEND="processes", DRIVECAL_BUNDLE_CACHE=cache) as server,
        Client(server.url) as client,
    ):
        client.push_problem(folder)
        ended = client.wait(client.submit(SPEC).id)
        query: dict[str, str | int] = {"measures": "true", "limit": 1000}
        rows = (
            httpx.get(f"{server.url}/api/v1/campaigns/{ended.id}/evaluations", params=query, timeout=60)
            .raise_for_status()
            .json()["items"]
        )
    assert (ended.state, ended.error, ended.cells.failed) == ("succeeded", None, 0)
    assert {row["outcome"] for row in rows} == {"simulated"}
    assert {row["scenario"] for row in rows} == {"merge", "cut_in"}
    controller = manifest.simulator.model_dump(mode="json")["controller"]
    for scenario in ("merge", "cut_in"):
        with driven(folder, manifest.scenarios[scenario], controller) as session:
            for row in [row for row in rows if row["scenario"] == scenario][::-1]:  # another process, another order
                again = session.evaluate({name: float(row[name]) for name in manifest.parameters})
                assert {name: again.measures[name] for name in manifest.measures} == {
                    name: row[f"measure_{name}"] for name in manifest.measures
                }
