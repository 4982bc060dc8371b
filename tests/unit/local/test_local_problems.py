"""The check of a problem before its push rates as a campaign does."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import yaml

from drivecal.bundles.archives import pack
from drivecal.bundles.checks import checked
from drivecal.local.problems import run_problem

EXAMPLE = Path(__file__).parents[3] / "deploy" / "examples" / "problems" / "python-function"
SCORES: dict[str, Any] = {
    "plain": {"formula": "rms_jerk - rms_jerk + 5", "direction": "minimise", "range": [0, 10]},
    "beyond": {"formula": "rms_jerk - rms_jerk + 50", "direction": "minimise", "range": [0, 10]},
    "undefined": {"formula": "1/(rms_jerk - rms_jerk)", "direction": "maximise", "range": [0, 10]},
}


LEAVING = """
import json, os, shutil, sys
print(json.dumps({"ready": bool(input())}), flush=True)
for number in (1, 2):
    json.loads(input())
    if number == 2:
        shutil.rmtree(os.getcwd())
    print(json.dumps({"id": number, "measures": {"y": 1.0}}), flush=True)
"""
"""A simulator that removes its working directory in its second run, and ends."""


def test_a_simulator_that_removes_its_folder_is_named_by_the_check(tmp_path: Path) -> None:
    document = {
        "problem": "leaving",
        "parameters": {"x": {"lower": 0, "upper": 1, "step": 0.5}},
        "scenarios": {"s": {}},
        "simulator": {"kind": "process", "command": [sys.executable, "sim.py"]},
        "measures": {"y": "m"},
        "scores": {"y": {"formula": "y", "direction": "minimise", "range": [0, 10]}},
    }
    (tmp_path / "problem.yaml").write_text(yaml.safe_dump(document))
    (tmp_path / "sim.py").write_text(LEAVING)
    [result] = run_problem(checked(document), pack(tmp_path), {"x": 0.5}, {"x": 1.0})
    assert result.other is not None
    assert result.other.error


def test_no_shown_score_is_worse_than_that_of_a_failed_run() -> None:
    document = yaml.safe_load((EXAMPLE / "problem.yaml").read_text())
    scenario = next(iter(document["scenarios"].items()))
    manifest = checked(document | {"scores": SCORES, "scenarios": dict([scenario])})
    [result] = run_problem(manifest, pack(EXAMPLE), manifest.baseline or {})
    assert result.error is None
    assert result.scores == {"plain": 5.0, "beyond": 10.0, "undefined": 0.0}
    assert set(result.undefined) == {"undefined"}
    assert result.cut == {"beyond": 50.0}
