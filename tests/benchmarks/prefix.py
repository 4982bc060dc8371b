"""Could a simulation go on from the last state that it shares with an earlier run? `python tests/benchmarks/run.py prefix`.

In each scenario SUMO saves its state in the middle of a run, the run goes on to its end, then the state is loaded and the same is driven
again. What the other vehicles do must be the same to the bit for results to be. CPU time of saving and loading beside that of
the steps which they would spare.
"""

from __future__ import annotations

import json
import sys
import tempfile
from contextlib import nullcontext
from pathlib import Path
from time import thread_time
from types import SimpleNamespace
from typing import Any

import libsumo
from tests.benchmarks.evaluation import latin_hypercube, record, runner_of

import drivecal.highway.traffic.simulation
from drivecal.domain.scenarios import Scenario
from drivecal.highway.scenarios.highway import HIGHWAY
from drivecal.highway.traffic.simulation import simulation

TARGET = Path(".drivecal/bench/prefix.json")
State = tuple[tuple[float, float], float]


def drive(scenario: Scenario, poses: list[tuple[int, Any, Any]]) -> list[State]:
    """Moves the ego vehicle along; gives position and speed of all others after each step."""
    seen = []
    for index, ego, pose in poses:
        simulation().ego[:] = ego
        simulation().advance(index, pose)
        seen += [(libsumo.vehicle.getPosition(other.id), libsumo.vehicle.getSpeed(other.id)) for other in scenario.traffic]
    return seen


def compare(scenario: Scenario, folder: Path) -> dict[str, float]:
    """One scenario: how many of the values after the middle differ, the largest difference (m), milliseconds."""
    kept = SimpleNamespace(TemporaryDirectory=lambda: nullcontext(folder))  # a state names its files, which have to stay
    vars(drivecal.highway.traffic.simulation)["tempfile"] = kept
    simulation()._scenario = None
    runner = runner_of(scenario)
    poses = record(runner, latin_hypercube(1, seed=1)[0]).advanced
    middle = len(poses) // 2
    state = str(folder / f"{scenario.id}.xml.gz")
    simulation().reset()
    drive(scenario, poses[:middle])
    begin = thread_time()
    libsumo.simulation.saveState(state)
    saved = thread_time() - begin
    begin = thread_time()
    straight = drive(scenario, poses[middle:])
    driven = thread_time() - begin
    begin = thread_time()
    libsumo.simulation.loadState(state)
    loaded = thread_time() - begin
    again = drive(scenario, poses[middle:])
    off = [max(abs(one[0][0] - other[0][0]), abs(one[0][1] - other[0][1])) for one, other in zip(straight, again, strict=True)]
    return {
        "values": len(straight),
        "different": sum(one != other for one, other in zip(straight, again, strict=True)),
        "largest_m": max(off),
        "save_ms": 1e3 * saved,
        "load_ms": 1e3 * loaded,
        "half_a_run_ms": 1e3 * driven,
    }


def main() -> int:
    """Prints the table, writes the figures; 0, for there is nothing to reach."""
    table = {}
    print(f"{'':4}{'different':>16}{'largest, m':>14}{'save, ms':>10}{'load, ms':>10}{'half a run of SUMO, ms':>24}")
    for name, scenario in HIGHWAY.scenarios.items():
        with tempfile.TemporaryDirectory() as folder:
            row = table[name] = compare(scenario, Path(folder))
        share = f"{row['different']:,.0f} of {row['values']:,.0f}"
        print(
            f"{name:4}{share:>16}{row['largest_m']:14.2e}{row['save_ms']:10.2f}{row['load_ms']:10.2f}{row['half_a_run_ms']:24.2f}"
        )
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text(json.dumps(table, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
