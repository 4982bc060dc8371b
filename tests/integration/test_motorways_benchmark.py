"""The benchmark of runs of the simulator `highway`."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from tests.benchmarks import motorways
from tests.support.motorways import motorway


@pytest.mark.slow
def test_a_run_takes_longer_than_sumo_alone(tmp_path: Path) -> None:
    folder = motorway(tmp_path / "bundle")
    command = [sys.executable, "-m", motorways.__name__, "--runs", "2", "--case", "3 others", "--folder", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=Path(__file__).parents[2])
    times = json.loads(done.stdout.splitlines()[-1])
    assert times.keys() == {"run", "bare", "reset", "step"}
    assert times["run"] > times["bare"] > times["reset"] > 0
    assert times["step"] > 0
