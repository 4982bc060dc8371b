"""Benchmark of what one evaluation costs, next to SUMO alone stepping the same scenarios: `python tests/benchmarks/run.py evaluation`.

SUMO alone: the scenario's network as it is and the same vehicles, the ego vehicle driven by SUMO as any other and the others told to keep
their lanes, only simulation steps. drivecal forbids lane changes in the network, which leaves out SUMO's model of them (decision 052); the
ratio to SUMO stepping that network is printed, too. All are measured in turn; of each run the fastest of several rounds counts, so that
what else the machine does disturbs the ratios least. CPU time.
"""

import json
import sys
from array import array
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import thread_time
from typing import Any

import libsumo
import numpy as np
from scipy.stats import qmc

from drivecal.domain.scenarios import Scenario
from drivecal.highway import sumo as sumo_calls
from drivecal.highway.comfort.reference import REFERENCE
from drivecal.highway.episode import loop as loops
from drivecal.highway.episode.runner import EpisodeRunner
from drivecal.highway.planner.frenet import FRENET
from drivecal.highway.scenarios.highway import HIGHWAY
from drivecal.highway.sumo import EGO
from drivecal.highway.traffic import simulation as traffic
from drivecal.highway.traffic.simulation import simulation
from drivecal.highway.vehicle.single_track import SINGLE_TRACK
from drivecal.plugins.ports import Observation

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


def runner_of(scenario: Scenario) -> EpisodeRunner:
    """With the vehicle's nominal values."""
    vehicle = SINGLE_TRACK.create({parameter.name: parameter.nominal for parameter in SINGLE_TRACK.parameters})
    return EpisodeRunner(scenario, FRENET, vehicle, REFERENCE)


def alone(scenario: Scenario) -> float:
    """Seconds that SUMO needs for the scenario by itself, as it is loaded, the reset not included."""
    sumo = simulation()
    sumo.load(scenario)
    sumo.reset()
    for vehicle in scenario.traffic:
        libsumo.vehicle.setLaneChangeMode(vehicle.id, sumo_calls.NO_LANE_CHANGES)
    libsumo.vehicle.setSpeedMode(EGO, DEFAULT_SPEED_MODE)
    libsumo.vehicle.setLaneChangeMode(EGO, DEFAULT_LANE_CHANGE_MODE)
    steps = range(round(scenario.duration / scenario.step))
    begin = thread_time()
    for _ in steps:
        libsumo.simulationStep()
    return thread_time() - begin


def seconds_of(work: Callable[[], object], prepare: Callable[[], object] = lambda: None) -> float:
    """CPU seconds of `work`, the least of several rounds; `prepare` is not counted."""
    least = float("inf")
    for _ in range(ROUNDS):
        prepare()
        begin = thread_time()
        work()
        least = min(least, thread_time() - begin)
    return least


@dataclass(slots=True)
class Tape:
    """Describes what the parts of the closed loop were asked for in one run, in order."""

    seen: list[Observation] = field(default_factory=list)
    moved: list[tuple[Any, float, int]] = field(default_factory=list)
    """Trajectories, the time since each was planned, and the step."""
    advanced: list[tuple[int, Any, Any]] = field(default_factory=list)
    """Step, SUMO's place and pose of the ego vehicle."""


def record(runner: EpisodeRunner, parameters: Sequence[float]) -> Tape:
    """A run that leaves its tape."""
    tape, loop = Tape(), runner._loop
    planner, simulated = loop._planner, loop._simulation
    plan, mover, advance = planner.plan, loops.mover, simulated.advance

    def planned(observation: Observation) -> Any:
        tape.seen.append(Observation(observation.time, observation.ego.copy(), observation.neighbours.copy()))
        return plan(observation)

    def moving(*arguments: Any) -> loops.Move:
        move = mover(*arguments)

        def moved(trajectory: Any, since: float, index: int) -> int:
            tape.moved.append((trajectory, since, index))
            return move(trajectory, since, index)

        return moved

    def advanced(index: int, pose: Any) -> bool:
        tape.advanced.append((index, simulated.ego.copy(), pose.copy()))
        return advance(index, pose)

    with replaced(planner, "plan", planned), replaced(loops, "mover", moving), replaced(simulated, "advance", advanced):
        runner.run(parameters)
    return tape


@contextmanager
def replaced(owner: object, name: str, by: object) -> Iterator[None]:
    """An object's method, or a module's function, is another one meanwhile."""
    getattr(owner, name)  # a name that is no more would change nothing
    own = vars(owner).get(name)
    setattr(owner, name, by)
    try:
        yield
    finally:
        if own is None:
            delattr(owner, name)
        else:
            setattr(owner, name, own)


def shares(runner: EpisodeRunner, parameters: Sequence[float]) -> dict[str, float]:
    """Milliseconds of one evaluation by part: each part does again, by itself, what it did in the run, so that no clock runs inside of
    it. What is left is the loop's own."""
    tape, loop = record(runner, parameters), runner._loop
    planner, vehicle, simulated, drive = loop._planner, loop._vehicle, loop._simulation, loop.drive(parameters)

    def plan() -> None:
        for observation in tape.seen:
            planner.plan(observation)

    def move() -> None:
        moved = loops.mover(vehicle, simulated, loop._frame, loop._motion, loop._dynamics)
        for trajectory, since, index in tape.moved:
            moved(trajectory, since, index)

    def advance() -> None:
        for index, ego, pose in tape.advanced:
            simulated.ego[:] = ego
            simulated.advance(index, pose)

    unread = array("d", [0.0] * len(runner._scenario.traffic))
    with replaced(sumo_calls, "speeds", lambda _: unread), replaced(traffic, "settle", lambda *_: False):
        sumo = seconds_of(advance, simulated.reset)
    parts = {
        "SUMO with the ego vehicle in it": sumo,
        "planner": seconds_of(plan, lambda: planner.reset(parameters)),
        "where the other vehicles are": seconds_of(advance, simulated.reset) - sumo,
        "vehicle and its place": seconds_of(move, lambda: vehicle.start(*loop._start)),
        "putting the vehicles back": seconds_of(simulated.reset),
        "metrics and rating": seconds_of(lambda: runner._result(drive)),
    }
    parts["loop, cold caches, what is left"] = seconds_of(lambda: runner.run(parameters)) - sum(parts.values())
    return {name: 1e3 * value for name, value in parts.items()}


def main() -> int:
    """Prints the tables, writes the figures; 1 where an evaluation costs more than `AT_MOST` times SUMO alone."""
    sets = latin_hypercube(SETS, seed=1)
    table: dict[str, dict[str, float]] = {}
    parts: dict[str, dict[str, float]] = {}
    for name, scenario in HIGHWAY.scenarios.items():
        runner = runner_of(scenario)
        full = [parameters for parameters in sets if runner.run(parameters).metrics["driven_s"] > scenario.duration - 0.05]
        full = full or sets
        own = np.zeros((ROUNDS, len(full)))
        unchanging, bare = [], []
        for turn in range(ROUNDS):
            with replaced(sumo_calls, "forbid_lane_changes", lambda: None):
                bare.append(alone(replace(scenario)))
            unchanging.append(alone(scenario))
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
        parts[name] = shares(runner, full[0])
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
        f"at most {AT_MOST}, wanted {WANTED}; {total / total_unchanging:.2f} times SUMO without lane changes\n"
    )
    whole = sum(sum(values.values()) for values in parts.values())
    print(f"{'where it goes, ms per evaluation':34}" + "".join(f"{name:>8}" for name in parts) + f"{'sum':>8}{'share':>8}")
    for part in next(iter(parts.values())):
        row_ms = [values[part] for values in parts.values()]
        print(f"{part:34}" + "".join(f"{one:8.2f}" for one in row_ms) + f"{sum(row_ms):8.2f}{sum(row_ms) / whole:8.1%}")
    ratio = total / total_alone
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    document = {
        "ratio": ratio,
        "ratio_without_lane_changes": total / total_unchanging,
        "at_most": AT_MOST,
        "scenarios": table,
        "parts_ms": parts,
        "numpy": np.__version__,
    }
    TARGET.write_text(json.dumps(document, indent=1))
    return int(ratio > AT_MOST)


if __name__ == "__main__":
    sys.exit(main())
