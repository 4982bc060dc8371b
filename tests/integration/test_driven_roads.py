"""Drives on real networks and converted OpenDRIVE files, from a folder to measures, in the child process of a worker."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.support.networks import REAL, entrance, generated, real
from tests.support.opendrive_files import FILES

from drivecal.client.problems import read_bundle
from drivecal.local.problems import CheckedScenario, run_problem, trial_set

CODE = "def control(observation, parameters):\n    return {'acceleration': 0.5 * (parameters['v'] - observation['speed'])}\n"
GRID = ("--grid", "--grid.x-number", "4", "--grid.y-number", "1", "--grid.length", "300", "-L", "2")
SCENARIOS: dict[str, dict[str, Any]] = {
    "motorway": {
        "network": "a10.net.xml",
        "route": list(REAL["motorway"][1]),
        "duration": 20,
        "ego": {"lane": 1, "s": 50, "speed": 24},
    },
    "exits": {
        "network": "a10.net.xml",
        "route": list(REAL["exits"][1]),
        "duration": 20,
        "ego": {"lane": 1, "s": 50, "speed": 24},
    },
    "highway": {"network": "highway.net.xml", "route": list(REAL["highway"][1]), "duration": 20, "ego": {"s": 20, "speed": 24}},
    "ramp": {
        "network": "ramp.net.xml",
        "route": list(REAL["ramp"][1]),
        "duration": 20,
        "ego": {"lane": 1, "s": 20, "speed": 24},
    },
    "merge": {
        "network": "ramp.net.xml",
        "route": list(REAL["merge"][1]),
        "duration": 20,
        "ego": {"lane": 1, "s": 90, "speed": 24},
        "traffic": [{"edge": "gneE14", "route": list(REAL["merge"][1]), "s": 10, "speed": 10, "lane_change": "LC2013"}],
    },
    "built": {
        "network": "entrance.net.xml",
        "route": ["before", "beside", "after"],
        "duration": 20,
        "ego": {"lane": 1, "s": 50, "speed": 24},
        "traffic": [{"edge": "ramp", "route": ["ramp", "beside", "after"], "s": 40, "speed": 20, "lane_change": "LC2013"}],
    },
    "generated": {"network": "grid.net.xml", "route": ["A0B0", "B0C0", "C0D0"], "duration": 20, "ego": {"s": 50, "speed": 24}},
    "exit": {
        "network": "exit_ramp.xodr",
        "route": ["-1#0", "-1#1", "-1#2", "-2"],
        "duration": 20,
        "ego": {"lane": 1, "s": 50, "speed": 24},
    },
    "joined": {
        "network": "entrance.xodr",
        "route": ["-1", "-2#0", "-2#1", "-2#2", "-2#3"],
        "duration": 20,
        "ego": {"s": 50, "speed": 24},
    },
    "two_way": {
        "network": "two_way.xodr",
        "route": ["5#5", "5#4", "5#3", "5#2", "5#1", "5#0"],
        "duration": 15,
        "ego": {"s": 50, "speed": 24},
    },
    "direct": {
        "network": "direct.xodr",
        "route": ["-1#0", "-1#1", "-1#2", "-2", "-4#0"],
        "duration": 20,
        "default_limit": 33,
        "ego": {"s": 50, "speed": 24, "lane": 1},
    },
}
MANIFEST: Mapping[str, Any] = {
    "problem": "roads",
    "parameters": {"v": {"lower": 20, "upper": 30}},
    "simulator": {
        "kind": "highway",
        "deterministic": True,
        "controller": {"kind": "python", "file": "acc.py", "output": ["acceleration"]},
    },
    "scenarios": SCENARIOS,
    "measures": {"lane_departures": "1", "distance_m": "m"},
    "scores": {"far": {"formula": "distance_m", "direction": "maximise", "range": [0, 1000]}},
}


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, CheckedScenario]:
    folder: Path = tmp_path_factory.mktemp("roads")
    (folder / "problem.yaml").write_text(yaml.safe_dump(dict(MANIFEST)))
    (folder / "acc.py").write_text(CODE)
    networks = {
        "a10": real("motorway").read_bytes(),
        "highway": real("highway").read_bytes(),
        "ramp": real("ramp").read_bytes(),
        "entrance": entrance(),
        "grid": generated(*GRID),
    }
    for name, content in networks.items():
        (folder / f"{name}.net.xml").write_bytes(content)
    for name, make in FILES.items():
        (folder / f"{name}.xodr").write_bytes(make())
    manifest, archive = read_bundle(folder)
    return {result.scenario: result for result in run_problem(manifest, archive, trial_set(manifest))}


@pytest.mark.slow
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_a_car_keeps_its_lane_to_the_end(results: dict[str, CheckedScenario], scenario: str) -> None:
    result = results[scenario]
    assert result.error is None
    assert result.failure is None
    assert result.repeats
    assert result.measures["lane_departures"] == 0
    assert result.measures["distance_m"] > 0.9 * 24.0 * SCENARIOS[scenario]["duration"]
