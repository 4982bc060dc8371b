"""What one evaluation costs, beside SUMO alone stepping the same scenarios: `python tests/benchmarks/evaluation.py`.

SUMO alone: the same vehicles, the ego vehicle driven by SUMO as any other, only simulation steps. Both are measured in turn; of each
run the fastest of several rounds counts, so that what else the machine does disturbs the ratio least. CPU time.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from time import thread_time
from typing import Any

import libsumo
import numpy as np
from scipy.stats import qmc

import drivecal.episode.loop
from drivecal.comfort.plugin import REFERENCE
from drivecal.domain.scenarios import Scenario
from drivecal.episode.runner import Runner
from drivecal.planner.plugin import FRENET
from drivecal.scenarios.plugin import HIGHWAY
from drivecal.traffic.configuration import EGO
from drivecal.traffic.simulation import Simulation, simulation
from drivecal.vehicle.plugin import SINGLE_TRACK

TARGET = Path(".drivecal/bench/evaluation.json")
AT_MOST = 4.0
"""Times SUMO alone, summed over the scenarios."""
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


def runner_of(scenario: Scenario) -> Runner:
    """With the vehicle's nominal values."""
    vehicle = SINGLE_TRACK.create({parameter.name: parameter.nominal for parameter in SINGLE_TRACK.parameters})
    return Runner(scenario, FRENET, vehicle, REFERENCE)


def alone(scenario: Scenario) -> float:
    """Seconds that SUMO needs for the scenario by itself, the reset not included."""
    sumo = simulation()
    sumo.load(scenario)
    sumo.reset()
    libsumo.vehicle.setSpeedMode(EGO, DEFAULT_SPEED_MODE)
    libsumo.vehicle.setLaneChangeMode(EGO, DEFAULT_LANE_CHANGE_MODE)
    steps = range(round(scenario.duration / scenario.step))
    begin = thread_time()
    for _ in steps:
        libsumo.simulationStep()
    return thread_time() - begin


class Clock:
    """Adds up the seconds spent in functions by name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def around(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """`function`, timed."""
        self.seconds[name] = 0.0

        def timed(*arguments: Any) -> Any:
            begin = thread_time()
            answer = function(*arguments)
            self.seconds[name] += thread_time() - begin
            return answer

        return timed


class Timed:
    """An object of which some methods are timed."""

    def __init__(self, target: Any, clock: Clock, prefix: str, *methods: str) -> None:
        self._target = target
        for method in methods:
            setattr(self, method, clock.around(f"{prefix}.{method}", getattr(target, method)))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._target, name)


def breakdown(runner: Runner, sets: Sequence[Sequence[float]]) -> dict[str, float]:
    """Milliseconds per evaluation by part. The clocks themselves cost, so the sum is somewhat above the evaluation's."""
    clock = Clock()
    inner: Any = runner._loop
    loop: Any = drivecal.episode.loop
    plain = inner._planner, inner._vehicle, inner._simulation, loop.place, loop.hits
    inner._planner = Timed(plain[0], clock, "planner", "plan")
    inner._vehicle = Timed(plain[1], clock, "vehicle", "follow")
    inner._simulation = Timed(plain[2], clock, "simulation", "reset", "advance")
    loop.place, loop.hits = clock.around("geometry.place", plain[3]), clock.around("geometry.hits", plain[4])
    read = Simulation._read
    Simulation._read = clock.around("  of which reading neighbours", read)  # type: ignore[method-assign]
    drive = inner.drive
    inner.drive = clock.around("drive", drive)
    try:
        begin = thread_time()
        for parameters in sets:
            runner.run(parameters)
        total = thread_time() - begin
    finally:
        inner._planner, inner._vehicle, inner._simulation, loop.place, loop.hits = plain
        Simulation._read = read  # type: ignore[method-assign]
        inner.drive = drive
    seconds = clock.seconds
    in_drive = seconds.pop("drive")
    seconds["loop itself"] = in_drive - sum(value for name, value in seconds.items() if not name.startswith(" "))
    seconds["metrics and rating"] = total - in_drive
    return {name: 1e3 * value / len(sets) for name, value in seconds.items()}


def main() -> int:
    """Prints the tables, writes the figures; 1 where an evaluation costs more than `AT_MOST` times SUMO alone."""
    sets = latin_hypercube(SETS, seed=1)
    table: dict[str, dict[str, float]] = {}
    parts: dict[str, dict[str, float]] = {}
    for name, scenario in HIGHWAY.scenarios.items():
        runner = runner_of(scenario)
        full = [parameters for parameters in sets if runner.run(parameters).metrics["driven_s"] > scenario.duration - 0.05]
        full = full or sets
        bare = np.zeros((ROUNDS, len(full)))
        own = np.zeros((ROUNDS, len(full)))
        for turn in range(ROUNDS):
            for column, parameters in enumerate(full):
                bare[turn, column] = alone(scenario)
                begin = thread_time()
                runner.run(parameters)
                own[turn, column] = thread_time() - begin
        seconds = {"alone_ms": 1e3 * bare.min(axis=0).mean(), "evaluation_ms": 1e3 * own.min(axis=0).mean()}
        table[name] = seconds | {"vehicles": len(scenario.traffic) + 1.0}
        parts[name] = breakdown(runner, full)
    total_alone = sum(row["alone_ms"] for row in table.values())
    total = sum(row["evaluation_ms"] for row in table.values())
    print(f"{'':4}{'vehicles':>9}{'SUMO alone':>12}{'evaluation':>12}{'ratio':>7}")
    for name, row in table.items():
        ratio = row["evaluation_ms"] / row["alone_ms"]
        print(f"{name:4}{row['vehicles']:9.0f}{row['alone_ms']:9.2f} ms{row['evaluation_ms']:9.2f} ms{ratio:7.2f}")
    print(f"{'sum':13}{total_alone:9.2f} ms{total:9.2f} ms{total / total_alone:7.2f}   at most {AT_MOST}\n")
    print(f"{'ms per evaluation, clocks included':36}" + "".join(f"{name:>8}" for name in parts))
    for part in next(iter(parts.values())):
        print(f"{part:36}" + "".join(f"{values[part]:8.2f}" for values in parts.values()))
    ratio = total / total_alone
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    document = {"ratio": ratio, "at_most": AT_MOST, "scenarios": table, "parts_ms": parts, "numpy": np.__version__}
    TARGET.write_text(json.dumps(document, indent=1))
    return int(ratio > AT_MOST)


if __name__ == "__main__":
    sys.exit(main())
