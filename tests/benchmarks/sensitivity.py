"""Does design `lines` find what design `paper` finds? `python tests/benchmarks/run.py sensitivity [--samples 16] [--threshold auto] [...]`.

Both analyse S1..S6 with two sets of Sobol' points each. Two maps agree on a (scenario, parameter) pair where it is influential in both or
in neither and both bounds are within one interval. `lines` is good enough where it agrees with `paper` on as many pairs as `paper` with
itself under other points, less a tenth. Writes `.drivecal/bench/sensitivity.json`.

Of a radial design per interval the paper uses one of n_p effects. The runs of the others are counted, but not made here: they decide
nothing, and each set of points would take six times as long.
"""

import argparse
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from functools import cache
from itertools import combinations, product
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from tests.support.setups import driven
from tests.support.values import numbers

from drivecal.contracts.work import Batch, Cell
from drivecal.domain.influence import Influence
from drivecal.domain.parameters import Indices, Parameter, ParameterSpace, text
from drivecal.highway.planner.frenet import FRENET
from drivecal.highway.scenarios.highway import HIGHWAY
from drivecal.runtime.worker import Worker
from drivecal.sensitivity.analysis import Phase, SensitivityAnalysis
from drivecal.sensitivity.designs import Floats
from drivecal.sensitivity.scenario import ScenarioInfluence
from drivecal.sensitivity.thresholds import SensitivitySettings

TARGET = Path(".drivecal/bench/sensitivity.json")
SPACE = ParameterSpace(FRENET.spaces["highway"])
SCENARIOS = tuple(HIGHWAY.scenarios)
CHUNK = 40
"""Cells per task."""
TOLERANCE = 0.1


@cache
def worker() -> Worker:
    """The one of this process of the pool."""
    return Worker(f"process {os.getpid()}")


def simulate(scenario: str, sets: list[dict[str, float]]) -> list[float]:
    """Scores, NaN where there is no result."""
    cells = tuple(Cell(number, parameters) for number, parameters in enumerate(sets))
    results = worker().run(Batch(driven(scenario), cells)).results
    for result in results:
        if result.breakdown is not None:
            print(f"{scenario}: {result.detail}", file=sys.stderr)
    return [np.nan if result.score is None else float(result.score) for result in results]


@dataclass
class Memory:
    """The score of every cell simulated so far."""

    pool: Executor
    known: dict[tuple[str, bytes], float] = field(default_factory=dict)

    def scores(self, scenario: str, points: Indices) -> Floats:
        """Of grid points, shape (n,); simulates those that are not known yet."""
        keys = [(scenario, row.tobytes()) for row in points]
        new = {key: row for key, row in zip(keys, points, strict=True) if key not in self.known}
        sets = [numbers(one) for one in SPACE.parameter_sets(np.array(list(new.values())).reshape(-1, points.shape[1]))]
        chunks = [sets[start : start + CHUNK] for start in range(0, len(sets), CHUNK)]
        tasks = [self.pool.submit(simulate, scenario, chunk) for chunk in chunks]
        self.known.update(zip(new, (score for task in tasks for score in task.result()), strict=True))
        return np.array([self.known[key] for key in keys])


def needed(phase: Phase, settings: SensitivitySettings, count: int) -> npt.NDArray[np.bool_]:
    """Which of a phase's points decide something, shape (count,): see the module's docstring."""
    if settings.design != "paper" or phase.name != "intervals":
        return np.ones(count, dtype=bool)
    n_p = len(SPACE.searched)
    deciding = np.zeros((n_p, settings.intervals, n_p + 1, settings.samples), dtype=bool)
    deciding[:, :, 0] = True
    for column in range(n_p):
        deciding[column, :, column + 1] = True
    return deciding.ravel()


@dataclass(frozen=True)
class Analysed:
    """One analysis of all scenarios: `runs` as designed, of which `deciding` were made or known already."""

    name: str
    found: dict[str, ScenarioInfluence]
    runs: int
    deciding: int
    seconds: float

    def influence(self, scenario: str, parameter: Parameter) -> Influence:
        """Returns what it says about one pair."""
        return self.found[scenario].parameters[parameter.name].influence


def analyse(settings: SensitivitySettings, memory: Memory) -> Analysed:
    """Runs an analysis to its end."""
    begun, runs, deciding = time.perf_counter(), 0, 0
    analysis = SensitivityAnalysis(SPACE, SCENARIOS, settings)
    while (phase := analysis.ask()) is not None:
        told: dict[str, Floats] = {}
        for scenario, points in phase.points.items():
            wanted = needed(phase, settings, len(points))
            told[scenario] = np.full(len(points), np.nan)
            told[scenario][wanted] = memory.scores(scenario, points[wanted])
            runs, deciding = runs + len(points), deciding + int(wanted.sum())
            if sys.stderr.isatty():
                print(f"\r{settings.design} {settings.seed}: {phase.name} {scenario}   ", end="", file=sys.stderr)
        analysis.tell(told)
    return Analysed(f"{settings.design} {settings.seed}", analysis.result(), runs, deciding, time.perf_counter() - begun)


def shown(influence: Influence) -> str:
    """An influence in a table."""
    if not influence.influential:
        return "none"
    lower, upper = (("" if bound is None else text(bound)) for bound in (influence.lower, influence.upper))
    return f"{lower}..{upper}" if lower or upper else "all"


def agree(one: Influence, other: Influence, parameter: Parameter, intervals: int) -> bool:
    """Equal P_sens, and bounds within one interval (and half a grid step, by which its edge may be snapped)."""
    if not (one.influential and other.influential):
        return one.influential == other.influential
    one_end, other_end = [
        (
            0 if influence.lower is None else parameter.index(influence.lower),
            parameter.n_values - 1 if influence.upper is None else parameter.index(influence.upper),
        )
        for influence in (one, other)
    ]
    return bool(np.abs(np.subtract(one_end, other_end)).max() <= (parameter.n_values - 1) / intervals + 0.5)


def compare(one: Analysed, other: Analysed, intervals: int) -> dict[str, Any]:
    """The share of pairs on which two analyses agree, and the pairs on which they do not."""
    differences = []
    pairs = list(product(SCENARIOS, SPACE.searched))
    for scenario, parameter in pairs:
        ours, theirs = (analysed.influence(scenario, parameter) for analysed in (one, other))
        if not agree(ours, theirs, parameter, intervals):
            differences.append(f"{scenario} {parameter.name}: {shown(ours)} | {shown(theirs)}")
    return {"of": [one.name, other.name], "share": 1 - len(differences) / len(pairs), "differences": differences}


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """All figures."""
    threshold = "auto" if options.threshold == "auto" else float(options.threshold)
    begun = time.perf_counter()
    with ProcessPoolExecutor(options.processes, multiprocessing.get_context("spawn")) as pool:
        memory = Memory(pool)
        analysed = {
            (design, seed): analyse(
                SensitivitySettings(design, options.intervals, options.samples, threshold, seed, sequential=False),  # type: ignore[arg-type]  # `design` is any string here
                memory,
            )
            for design, seed in product(("paper", "lines"), (1, 2))
        }
    comparisons = [compare(one, other, options.intervals) for one, other in combinations(analysed.values(), 2)]
    papers, mixed, lines = comparisons[0], comparisons[1:5], comparisons[5]
    first = SensitivityAnalysis(SPACE, SCENARIOS, SensitivitySettings("lines", options.intervals, options.samples, "auto", 1))
    return {
        **{name: getattr(options, name) for name in ("samples", "intervals", "threshold")},
        "paper_with_itself": papers["share"],
        "lines_with_paper": float(np.mean([one["share"] for one in mixed])),
        "lines_with_itself": lines["share"],
        "runs": {one.name: one.runs for one in analysed.values()},
        "deciding_runs": {one.name: one.deciding for one in analysed.values()},
        "interval_runs_per_scenario": {
            "lines": first.expected_runs()["intervals"],
            "paper": len(SPACE.searched) * options.intervals * options.samples * (len(SPACE.searched) + 1),
        },
        "simulated_cells": len(memory.known),
        "seconds": time.perf_counter() - begun,
        "comparisons": comparisons,
        "maps": {
            one.name: {
                scenario: {
                    name: asdict(parameter.influence)
                    | {"s_rel_intervals": [None if isnan(s_rel) else s_rel for s_rel in parameter.s_rel_intervals]}
                    for name, parameter in found.parameters.items()
                }
                for scenario, found in one.found.items()
            }
            for one in analysed.values()
        },
        "unknown": {one.name: [name for name, found in one.found.items() if found.unknown] for one in analysed.values()},
        "table": table(list(analysed.values())),
    }


def table(analysed: Sequence[Analysed]) -> list[str]:
    """Returns what each analysis found, one line per pair."""
    rows = [f"{'':9}" + "".join(f"{one.name:>16}" for one in analysed)]
    for scenario, parameter in product(SCENARIOS, SPACE.searched):
        found = "".join(f"{shown(one.influence(scenario, parameter)):>16}" for one in analysed)
        rows.append(f"{scenario} {parameter.name:6}{found}")
    return rows


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the tables, writes the figures; 1 where `lines` agrees less than it should."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=16)
    parser.add_argument("--intervals", type=int, default=10)
    parser.add_argument("--threshold", default="auto")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args(arguments)
    figures = measure(options)
    print("\n".join(figures["table"]))
    for comparison in figures["comparisons"]:
        print(f"\n{' and '.join(comparison['of'])} agree on {comparison['share']:.1%} of the pairs")
        print("\n".join(f"    {difference}" for difference in comparison["differences"]))
    print("\nruns      as designed  deciding")
    for name, runs in figures["runs"].items():
        print(f"{name:8} {runs:12,} {figures['deciding_runs'][name]:9,}")
    factor = figures["interval_runs_per_scenario"]["paper"] / figures["interval_runs_per_scenario"]["lines"]
    print(f"interval analyses: `lines` takes {factor:.2f} times fewer runs at equal r = {figures['samples']}")
    print(f"{figures['simulated_cells']:,} cells simulated in {figures['seconds']:.0f} s")
    print(f"paper with itself {figures['paper_with_itself']:.1%}, lines with paper {figures['lines_with_paper']:.1%}", end=", ")
    print(f"lines with itself {figures['lines_with_itself']:.1%}")
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text(json.dumps(figures, indent=1, default=str))
    return int(figures["lines_with_paper"] < figures["paper_with_itself"] - TOLERANCE)


if __name__ == "__main__":
    sys.exit(main())
