"""Does the genetic algorithm beat random search on the built-in problem? `python tests/benchmarks/run.py optimizer [--seeds 12] [...]`.

Both start from the same Latin hypercube, request equally many cells in every iteration and rate a set by the mean score over all
scenarios. Per seed: the best objective, and how many different sets reach the better of the two. Of two one-sided Mann-Whitney tests over
the seeds one must hold at 2.5 % (they share the 5 %). Writes `.drivecal/bench/optimizer.json`.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from tests.support.values import numbers

from drivecal.domain.parameters import ParameterSet, ParameterSpace
from drivecal.highway.comfort.reference import REFERENCE
from drivecal.highway.episode.runner import EpisodeRunner
from drivecal.highway.planner.frenet import FRENET
from drivecal.highway.scenarios.highway import HIGHWAY
from drivecal.highway.vehicle.single_track import SINGLE_TRACK
from drivecal.optimizers.built_in import GENETIC, RANDOM, GeneticSettings
from drivecal.plugins.ports import Optimizer, OptimizerPlugin

TARGET = Path(".drivecal/bench/optimizer.json")
SPACE = ParameterSpace(FRENET.spaces["highway"])
SCENARIOS = list(HIGHWAY.scenarios)
CHUNK = 40
"""Cells of one scenario per task."""
EQUAL = 1e-9

Score = tuple[float, float]
"""Score and rating of one cell."""


@cache
def runner_of(scenario: str) -> EpisodeRunner:
    """With the vehicle's nominal values."""
    vehicle = SINGLE_TRACK.create({parameter.name: parameter.nominal for parameter in SINGLE_TRACK.parameters})
    return EpisodeRunner(HIGHWAY.scenarios[scenario], FRENET, vehicle, REFERENCE)


def run(scenario: str, sets: list[list[float]]) -> list[Score]:
    """Simulates sets in one scenario, in a process of the pool."""
    ratings = [runner_of(scenario).run(parameters).rating for parameters in sets]
    return [(rating.score, rating.rating) for rating in ratings]


@dataclass
class Memory:
    """Mean score and rating over all scenarios of every set simulated so far."""

    pool: Executor
    known: dict[ParameterSet, tuple[float, float]] = field(default_factory=dict)

    def learn(self, sets: Sequence[ParameterSet]) -> None:
        """Simulates those that are not known yet."""
        new = [one for one in dict.fromkeys(sets) if one not in self.known]
        chunks = [new[start : start + CHUNK] for start in range(0, len(new), CHUNK)]
        tasks = [
            [self.pool.submit(run, scenario, [list(numbers(one).values()) for one in chunk]) for scenario in SCENARIOS]
            for chunk in chunks
        ]
        for chunk, task in zip(chunks, tasks, strict=True):
            means = np.mean([future.result() for future in task], axis=0)  # (sets, 2)
            self.known.update(zip(chunk, map(tuple, means.tolist()), strict=True))


@dataclass
class Search:
    """One optimizer with one seed, and what it has requested."""

    name: str
    seed: int
    optimizer: Optimizer
    requested: int = 0
    found: dict[ParameterSet, float] = field(default_factory=dict)
    curve: list[float] = field(default_factory=list)
    """The best objective after each iteration."""

    @property
    def best(self) -> float:
        """The best objective found."""
        return max(self.found.values())

    def sets_at(self, level: float) -> int:
        """How many different sets reach an objective."""
        return sum(objective >= level - EQUAL for objective in self.found.values())


def search(searches: Sequence[Search], iterations: int, memory: Memory) -> None:
    """All searches side by side, so that the pool is never idle and nothing is simulated twice."""
    for iteration in range(1, iterations + 1):
        proposals = [one.optimizer.ask() for one in searches]
        populations = [SPACE.parameter_sets(proposal.population) for proposal in proposals]
        memory.learn([parameter_set for population in populations for parameter_set in population])
        for one, proposal, population in zip(searches, proposals, populations, strict=True):
            answers = np.array([memory.known[parameter_set] for parameter_set in population])
            one.optimizer.tell(answers[:, 0], answers[:, 1])
            one.requested += int(proposal.changed.sum()) * len(SCENARIOS)
            one.found.update(zip(population, answers[:, 0].tolist(), strict=True))
            one.curve.append(one.best)
        if sys.stderr.isatty():
            print(f"\riteration {iteration} of {iterations}", end="\n" if iteration == iterations else "", file=sys.stderr)


def started(plugin: OptimizerPlugin, seed: int, settings: Mapping[str, Any]) -> Search:
    """A search at its start."""
    options = plugin.settings.model_validate({"kind": plugin.name, "seed": seed, **settings})
    return Search(plugin.name, seed, plugin.create(options, SPACE.n_values))


def greater(pairs: Sequence[Sequence[float]]) -> float:
    """The p-value of the first of all pairs being greater than the second by chance."""
    first, second = np.array(pairs, dtype=np.float64).T
    return float(stats.mannwhitneyu(first, second, alternative="greater").pvalue)


def measure(seeds: int, population: int, iterations: int, processes: int) -> dict[str, Any]:
    """Runs both optimizers with every seed and compares them."""
    common = {"population": population, "iterations": iterations}
    per_generation = GENETIC.requested_individuals(GeneticSettings(population=population, iterations=2)) - population
    renewal = {"renewal": per_generation / population}
    begun = time.perf_counter()
    genetic = [started(GENETIC, seed, common) for seed in range(1, seeds + 1)]
    floor = [started(RANDOM, seed, common | renewal) for seed in range(1, seeds + 1)]
    with ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool:
        memory = Memory(pool)
        search([*genetic, *floor], iterations, memory)
    if {one.requested for one in genetic} != {one.requested for one in floor}:
        raise RuntimeError("the two did not request equally many cells")
    rows: list[dict[str, Any]] = []
    for ours, theirs in zip(genetic, floor, strict=True):
        level = max(ours.best, theirs.best)
        at_level = [ours.sets_at(level), theirs.sets_at(level)]
        rows.append(
            {"seed": ours.seed, "best": [ours.best, theirs.best], "sets": at_level, "curves": [ours.curve, theirs.curve]}
        )
    p_values = {key: greater([row[key] for row in rows]) for key in ("best", "sets")}
    return {
        **common,
        "requested_cells": genetic[0].requested,
        "simulated_cells": len(memory.known) * len(SCENARIOS),
        "seconds": time.perf_counter() - begun,
        "p_values": p_values,
        "rows": rows,
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the table, writes the figures; 1 where random search is as good."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--population", type=int, default=100)
    parser.add_argument("--iterations", type=int, default=15)
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args(arguments)
    figures = measure(options.seeds, options.population, options.iterations, options.processes)
    print(
        f"{options.population} individuals, {options.iterations} iterations, {figures['requested_cells']} cells requested by each"
    )
    print(f"{figures['simulated_cells']} cells simulated in {figures['seconds']:.0f} s\n")
    print("seed   best objective    sets at the better best")
    print("       genetic random    genetic random")
    for row in figures["rows"]:
        (ours, theirs), (count, other) = row["best"], row["sets"]
        print(f"{row['seed']:4}   {ours:7.3f} {theirs:6.3f}    {count:7} {other:6}")
    p_values = figures["p_values"]
    print(f"\none-sided Mann-Whitney: best p = {p_values['best']:.2g}, sets p = {p_values['sets']:.2g}")
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text(json.dumps(figures, indent=1))
    return int(min(p_values.values()) >= 0.025)


if __name__ == "__main__":
    sys.exit(main())
