"""A simulator that mostly waits, of 90 s in the long form: real children, real clocks, and the account of a campaign."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.support.effort import LONG
from tests.support.serve import serving

from drivecal.client import Client

SECONDS, POPULATION = (90.0, 2) if LONG else (0.4, 8)
MODEL = f"import time\n\ndef evaluate(parameters, scenario):\n    time.sleep({SECONDS})\n    return {{'y': parameters['x']}}\n"
MANIFEST: dict[str, Any] = {
    "problem": "sleeping",
    "parameters": {"x": {"lower": 0, "upper": 1, "step": 0.1}},
    "simulator": {"kind": "python", "file": "model.py", "function": "evaluate", "timeout": 600, "deterministic": True},
    "scenarios": {"city": {}},
    "measures": {"y": "1"},
    "scores": {"cost": {"formula": "y", "direction": "minimise", "range": [0, 1]}},
}
SPEC: dict[str, Any] = {
    "problem": "sleeping",
    "sensitivity": None,
    "optimizer": {"kind": "random", "population": POPULATION, "iterations": 1, "seed": 1},
    "reduction": {"mode": "exact"},
}


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_cpu_time_wall_time_and_savings_of_a_simulator_that_sleeps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DRIVECAL_HOME", str(tmp_path / "home"))
    folder = tmp_path / "sleeping"
    folder.mkdir()
    (folder / "problem.yaml").write_text(yaml.safe_dump(MANIFEST))
    (folder / "model.py").write_text(MODEL)
    with serving(tmp_path, DRIVECAL_BACKEND="processes") as server, Client(server.url) as client:
        client.push_problem(folder)
        first, again = (client.wait(client.submit(SPEC).id) for _ in range(2))
        accounts = [client.accounting(campaign.id) for campaign in (first, again)]
    assert (first.state, first.cells.failed, first.cells.repeated) == ("succeeded", 0, 0)
    assert (again.cells.simulated, again.cells.repeated) == (0, first.cells.simulated)
    waited = SECONDS * first.cells.simulated
    assert first.seconds.simulating < 0.25 * waited, "CPU time"
    assert first.seconds.wall >= waited
    assert [account.clock for account in accounts] == ["wall", "wall"]
    assert 0.99 * waited <= accounts[0].simulated_seconds <= first.seconds.wall
    assert accounts[1].repeated_saved_seconds == pytest.approx(accounts[0].simulated_seconds, rel=0.05)
