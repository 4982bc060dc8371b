"""Benchmark of what one evaluation costs, next to SUMO alone stepping the same scenarios: `python tests/benchmarks/run.py evaluation`.

SUMO alone: the scenario's network as it is and the same vehicles, the ego vehicle driven by SUMO as any other and the others told to keep
their lanes, only simulation steps. drivecal forbids lane changes in the network, which leaves out SUMO's model of them (decision 052); the
ratio to SUMO stepping that network is printed, too. All are measured in turn; of each run the fastest of several rounds counts, so that
what else the machine does disturbs the ratios least. CPU time.
"""

import json
import sys
from pathlib import Path
from time import thread_time
from unittest import mock

import libsumo
import numpy as np
from scipy.stats import qmc

from drivecal.bundles.highway import Scenario
from drivecal.highway import sumo as sumo_calls
from drivecal.highway.drive.tasks import TaskRunner
from drivecal.highway.planner.plugin import FRENET
from drivecal.highway.scenarios import HIGHWAY
from drivecal.highway.sumo import EGO
from drivecal.highway.vehicle.plugin import SINGLE_TRACK

TARGET = Path(".drivecal/bench/evaluation.json")
AT_MOST = 4.0
"""Times SUMO alone, summed over the scenarios."""
WANTED = 2.0
"""The same; what would be nice to have."""
ROUNDS = 15
SETS = 6
DEFAULT_SPEED_MODE = 31
DEFAULT_LANE_CHANGE_MODE = 1621


def latin_hypercube(count: int, seed: int) -> list[list[float]]:
    """Parameter sets of the built-in space on its grid."""
    space = FRENET.spaces["highway"]
    unit = qmc.LatinHypercube(len(space), seed=seed).random(count)
    return [
        [float(parameter.value(round(u * (parameter.n_values - 1)))) for u, parameter in zip(row, space, strict=True)]
        for row in unit
    ]


def runner_of(scenario: Scenario) -> TaskRunner:
    """With the vehicle's nominal values."""
    vehicle = SINGLE_TRACK.create({parameter.name: parameter.nominal for parameter in SINGLE_TRACK.parameters})
    return TaskRunner(scenario, FRENET, vehicle)


def alone(runner: TaskRunner) -> float:
    """Seconds that SUMO needs for the runner's scenario by itself, as it is loaded, the reset not included."""
    traffic, scenario = runner._loop._traffic, runner._scenario
    traffic.reset()
    for vehicle in scenario.traffic:
        libsumo.vehicle.setLaneChangeMode(vehicle.id, sumo_calls.NO_LANE_CHANGES)
    libsumo.vehicle.setSpeedMode(EGO, DEFAULT_SPEED_MODE)
    libsumo.vehicle.setLaneChangeMode(EGO, DEFAULT_LANE_CHANGE_MODE)
    steps = range(round(scenario.duration / scenario.step))
    begin = thread_time()
    for _ in steps:
        libsumo.simulationStep()
    return thread_time() - begin


def main() -> int:
    """Prints the table, writes the figures; 1 where an evaluation costs more than `AT_MOST` times SUMO alone."""
    sets = latin_hypercube(SETS, seed=1)
    table: dict[str, dict[str, float]] = {}
    for name, scenario in HIGHWAY.scenarios.items():
        runner = runner_of(scenario)
        full = [parameters for parameters in sets if runner.run(parameters).measures["driven_s"] > scenario.duration - 0.05]
        full = full or sets
        own = np.zeros((ROUNDS, len(full)))
        unchanging, bare = [], []
        for turn in range(ROUNDS):
            with mock.patch.object(sumo_calls, "forbid_lane_changes", return_value=None):
                bare.append(alone(runner_of(scenario)))
            unchanging.append(alone(runner))
            for column, parameters in enumerate(full):
                begin = thread_time()
                runner.run(parameters)
                own[turn, column] = thread_time() - begin
        table[name] = {
            "vehicles": len(scenario.traffic) + 1.0,
            "alone_ms": 1e3 * min(bare),
            "without_lane_changes_ms": 1e3 * min(unchanging),
            "evaluation_ms": 1e3 * own.min(axis=0).mean(),
        }
    total_alone, total_unchanging, total = (
        sum(row[column] for row in table.values()) for column in ("alone_ms", "without_lane_changes_ms", "evaluation_ms")
    )
    print(f"{'':4}{'vehicles':>9}{'SUMO alone':>12}{'no lane changes':>17}{'evaluation':>12}{'ratio':>7}")
    for name, row in table.items():
        print(
            f"{name:4}{row['vehicles']:9.0f}{row['alone_ms']:9.2f} ms{row['without_lane_changes_ms']:14.2f} ms"
            f"{row['evaluation_ms']:9.2f} ms{row['evaluation_ms'] / row['alone_ms']:7.2f}"
        )
    print(
        f"{'sum':13}{total_alone:9.2f} ms{total_unchanging:14.2f} ms{total:9.2f} ms{total / total_alone:7.2f}   "
        f"at most {AT_MOST}, wanted {WANTED}; {total / total_unchanging:.2f} times SUMO without lane changes"
    )
    ratio = total / total_alone
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    document = {
        "ratio": ratio,
        "ratio_without_lane_changes": total / total_unchanging,
        "at_most": AT_MOST,
        "scenarios": table,
        "numpy": np.__version__,
    }
    TARGET.write_text(json.dumps(document, indent=1))
    return int(ratio > AT_MOST)


if __name__ == "__main__":
    sys.exit(main())
