"""Runs that a sequential sensitivity analysis leaves out: `python tests/benchmarks/run.py sequential [--samples 20] [...]`.

Analyses S1..S6 with the design `lines` in full, then again with the runs chosen sequentially, which are among those of the full one and
so take no further simulation. Both must end with the same bounds. Writes `.drivecal/bench/sequential.json`.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import product
from typing import Any
from unittest.mock import patch

from tests.benchmarks.sensitivity import SCENARIOS, SPACE, TARGET, Memory

from drivecal.domain.influence import InfluenceMap
from drivecal.sensitivity import sequential
from drivecal.sensitivity.analysis import Phase, SensitivityAnalysis
from drivecal.sensitivity.settings import SensitivitySettings
from drivecal.sensitivity.thresholds import Threshold

PARTS = (1, 2, 4)
"""Looks at an interval; the product uses `sequential.PARTS`."""
WORKERS = (2, 8, 32, 128)


@dataclass(frozen=True)
class Analysis:
    """An analysis of all scenarios: its map, and the runs of its rounds of intervals and of all later rounds."""

    influence_map: InfluenceMap
    by_scenario: dict[str, int]
    rounds: list[int]
    later: int

    def turns(self, workers: int) -> int:
        """Runs one after the other if workers wait for the end of each round of intervals, all runs counted alike."""
        return sum(-(-runs // workers) for runs in self.rounds)


def analyse(settings: SensitivitySettings, memory: Memory) -> Analysis:
    """Runs an analysis to its end."""
    analysis = SensitivityAnalysis(SPACE, SCENARIOS, settings)
    by_scenario, rounds, later = dict.fromkeys(SCENARIOS, 0), [], 0
    while (phase := analysis.ask()) is not None:
        if phase.name == "intervals":
            rounds.append(phase.runs)
            for scenario, points in phase.points.items():
                by_scenario[scenario] += len(points)
        else:
            later += phase.runs
        analysis.tell(answers(phase, memory))
    return Analysis(analysis.influence_map(), by_scenario, rounds, later)


def answers(phase: Phase, memory: Memory) -> dict[str, Any]:
    """The scores of a phase."""
    return {scenario: memory.scores(scenario, points) for scenario, points in phase.points.items()}


def measure(options: argparse.Namespace, threshold: Threshold, seed: int, memory: Memory) -> dict[str, Any]:
    """The runs of an analysis in full and sequential, by looks at an interval."""
    settings = SensitivitySettings("lines", options.intervals, options.samples, threshold, seed, sequential=False)
    full = analyse(settings, memory)
    simulated, chosen = len(memory.known), {}
    for parts in PARTS:
        with patch.object(sequential, "PARTS", parts):
            chosen[parts] = analyse(replace(settings, sequential=True), memory)
    return {
        "threshold": threshold,
        "seed": seed,
        "full": figures(full),
        "sequential": {parts: figures(analysis) for parts, analysis in chosen.items()},
        "same_bounds": all(analysis.influence_map == full.influence_map for analysis in chosen.values()),
        "none_new": len(memory.known) == simulated,
    }


def figures(analysis: Analysis) -> dict[str, Any]:
    """What is counted of an analysis."""
    return {
        "runs": sum(analysis.rounds),
        "rounds": len(analysis.rounds),
        "smallest_round": min(analysis.rounds),
        "by_scenario": analysis.by_scenario,
        "later": analysis.later,
        "turns": {workers: analysis.turns(workers) for workers in WORKERS},
    }


def line(name: str, counted: dict[str, Any], whole: int) -> str:
    """A row of the table."""
    turns = "".join(f"{turns:>9,}" for turns in counted["turns"].values())
    scenarios = "".join(f"{runs:>7,}" for runs in counted["by_scenario"].values())
    share = f"{counted['runs'] / whole - 1:+.1%}" if counted["runs"] != whole else ""
    return f"{name:24}{counted['runs']:>8,}{share:>8}{counted['rounds']:>7}{turns}   {scenarios}"


def show(entry: dict[str, Any]) -> None:
    """Prints the rows of an analysis."""
    whole = entry["full"]["runs"]
    print(line(f"{entry['threshold']}, seed {entry['seed']}: all", entry["full"], whole))
    for parts, counted in entry["sequential"].items():
        print(line(f"  sequential, {parts} looks", counted, whole))
    print(f"  the same bounds: {entry['same_bounds']}; {entry['full']['later']:,} later runs", flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints a table, writes the figures; 1 if bounds differ or a run is not among those of the full analysis."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=20)
    parser.add_argument("--intervals", type=int, default=10)
    parser.add_argument("--thresholds", nargs="+", default=["auto", "0.02"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[1])
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args(arguments)
    begun = time.perf_counter()
    with ProcessPoolExecutor(options.processes, multiprocessing.get_context("spawn")) as pool:
        memory = Memory(pool)
        measured = []
        head = "".join(f"{f'{workers} work.':>9}" for workers in WORKERS)
        print(f"{'runs of the intervals':32}{'':8}{'rounds':>7}{head}   " + "".join(f"{name:>7}" for name in SCENARIOS))
        for seed, threshold in product(options.seeds, options.thresholds):
            measured.append(measure(options, "auto" if threshold == "auto" else float(threshold), seed, memory))
            show(measured[-1])
    print(f"{len(memory.known):,} cells simulated in {time.perf_counter() - begun:.0f} s")
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.with_name("sequential.json").write_text(json.dumps(measured, indent=1))
    return int(not all(entry["same_bounds"] and entry["none_new"] for entry in measured))


if __name__ == "__main__":
    sys.exit(main())
