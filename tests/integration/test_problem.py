"""The built-in problem in small: `tests/benchmarks/problem.py` measures it in full."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from tests.support.effort import tries

BENCHMARK = Path(__file__).parents[1] / "benchmarks" / "problem.py"


@pytest.mark.slow
def test_random_sets_drive_from_badly_to_well_and_every_parameter_counts(tmp_path: Path) -> None:
    output = tmp_path / "problem.json"
    command = [
        sys.executable,
        str(BENCHMARK),
        "--sets",
        str(tries(24, 60)),
        "--lines",
        "4",
        "--output",
        str(output),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert output.is_file(), done.stderr
    figures = json.loads(output.read_text())
    for name, row in figures["scenarios"].items():
        assert row["distinct_scores"] >= 4, name
        assert row["share_best"] < 0.35, name
        assert row["share_failed"] < 0.4, name
    for parameter, row in figures["changed"].items():
        assert max(row.values()) > 0, f"{parameter} changes no score"
    assert figures["largest_correlation"] < 0.98
    objective = figures["objective"]
    assert objective["quantiles"][0] < 3.5 < 5.5 < objective["best"]
