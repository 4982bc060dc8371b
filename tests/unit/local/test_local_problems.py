"""The check of a problem before its push rates as a campaign does."""

from __future__ import annotations

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


def test_no_shown_score_is_worse_than_that_of_a_failed_run() -> None:
    document = yaml.safe_load((EXAMPLE / "problem.yaml").read_text())
    scenario = next(iter(document["scenarios"].items()))
    manifest = checked(document | {"scores": SCORES, "scenarios": dict([scenario])})
    [result] = run_problem(manifest, pack(EXAMPLE), manifest.baseline or {})
    assert result.error is None
    assert result.scores == {"plain": 5.0, "beyond": 10.0, "undefined": 0.0}
    assert set(result.undefined) == {"undefined"}
    assert result.cut == {"beyond": 50.0}
