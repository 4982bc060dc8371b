"""The example of the built-in planner on a road network, as a campaign on two workers without Ray."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tests.support.serve import serving
from tests.support.user_problems import problem

from drivecal.client import Client

pytestmark = pytest.mark.slow
SPEC: dict[str, Any] = {
    "problem": "planner-highway",
    "sensitivity": None,
    "optimizer": {"kind": "genetic", "population": 3, "iterations": 1, "seed": 3},
    "reduction": {"mode": "off"},
}


def test_the_planner_is_calibrated_to_the_same_bits_by_one_worker_and_by_two(tmp_path: Path) -> None:
    folder = problem("planner-highway", tmp_path)
    results = []
    for workers in (2, 1):
        home = tmp_path / str(workers)
        home.mkdir()
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("DRIVECAL_HOME", str(home / "home"))
            settings = {"DRIVECAL_BACKEND": "processes", "DRIVECAL_BUNDLE_CACHE": str(home / "cache")}
            with serving(home, workers=workers, **settings) as server, Client(server.url) as client:
                client.push_problem(folder)
                ended = client.wait(client.submit(SPEC).id)
                assert (ended.state, ended.error, ended.cells.failed) == ("succeeded", None, 0)
                table = client.evaluations(ended.id, measures=True).to_pandas()
        measures = sorted(name for name in table.columns if name.startswith("measure_"))
        assert "measure_min_ttc_s" in measures
        columns = ["scenario", "iteration", "individual", "outcome", "failure", "score", *measures]
        results.append([tuple(row) for row in table[columns].itertuples(index=False, name=None)])
        assert {row[3] for row in results[-1]} == {"simulated"}
    assert len(results[0]) >= 6
    assert results[0] == results[1]
