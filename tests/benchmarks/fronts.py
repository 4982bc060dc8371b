"""Fronts of several objectives after equal numbers of simulations: `python tests/benchmarks/run.py fronts [--seeds 10]`.

The default search, random search and Optuna's TPE and NSGA-II on four functions of five parameters in two scenarios: a curved front, a
disconnected one, two spheres, and three objectives. Measured: the share of a box that the complete sets dominate after 120 and 300
simulations, in the mean and the worst of the seeds; and the p of Wilcoxon's test against the best of the others, by pairs of seeds. Exits
with 0 if no other has a significantly larger share after 300 simulations.
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import wilcoxon
from tests.unit.optimizers.test_surrogate import Played, begun, cost, task_of

from drivecal.analysis.aims import JudgedGoals
from drivecal.analysis.goals import Aggregate, CellValue, Goals, Objective
from drivecal.campaigns.stages.asking import WINDOW
from drivecal.plugins.search import AskedCell, CellAnswer

MARKS, SCENARIOS, SIZES = (120, 300), 2, np.full(5, 21)
SAMPLES = np.random.default_rng(0).random((20_000, 3))
"""Points of the box whose dominated share is counted."""
ARMS = ("surrogate", "random", "tpe", "nsga2")


def curved(x: Any, k: float) -> tuple[float, ...]:
    away = 1 + 4 * ((x[2:] - 0.3 - 0.1 * k) ** 2).sum() + 0.3 * (x[1] - 0.5) ** 2
    first = x[0] + 0.1 * k * x[1]
    return first, away * (1 - np.sqrt(first / away / 1.2))


def apart(x: Any, k: float) -> tuple[float, ...]:
    """ZDT3 (Zitzler, Deb and Thiele 2000), whose optimum lies elsewhere in each scenario."""
    away = 1 + 2 * ((x[1:] - 0.3 - 0.1 * k) ** 2).sum()
    return x[0], away * (1 - np.sqrt(x[0] / away) - x[0] / away * np.sin(10 * np.pi * x[0])) + 1


def spheres(x: Any, k: float) -> tuple[float, ...]:
    return ((x - 0.2 - 0.05 * k) ** 2).sum(), ((x - 0.8 + 0.05 * k) ** 2).sum()


def three(x: Any, k: float) -> tuple[float, ...]:
    """DTLZ1 (Deb and others 2002) without its ripples."""
    away = 1 + 3 * ((x[2:] - 0.4 - 0.1 * k) ** 2).sum()
    return away * x[0] * x[1], away * x[0] * (1 - x[1]), away * (1 - x[0])


PROBLEMS: dict[str, tuple[Callable[[Any, float], tuple[float, ...]], Sequence[float]]] = {
    "curved": (curved, (1.3, 2.0)),
    "apart": (apart, (1.2, 3.5)),
    "spheres": (spheres, (2.0, 2.0)),
    "three": (three, (1.5, 1.5, 1.5)),
}


def mean_of(problem: str, indices: Sequence[int]) -> list[float]:
    function = PROBLEMS[problem][0]
    values = [function(np.array(indices) / (SIZES - 1), scenario) for scenario in range(SCENARIOS)]
    return [float(value) for value in np.mean(values, axis=0)]


def searched(problem: str, seed: int, cells: int) -> list[tuple[int, ...]]:
    """Returns the complete sets of the default search."""
    function, reference = PROBLEMS[problem]
    shares = {f"S{place}": 1 / SCENARIOS for place in range(SCENARIOS)}
    goals = Goals(tuple(Objective(name, CellValue(measure=name), shares, Aggregate(), -1) for name in "abc"[: len(reference)]))

    @dataclass
    class Front(Played):
        def answered(self, cell: AskedCell) -> CellAnswer:
            return CellAnswer(cell, tuple(map(float, function(np.array(cell.indices) / (SIZES - 1), cell.scenario))))

    task = task_of(JudgedGoals(goals, tuple(shares)), cells, WINDOW, SIZES, ["grid"] * len(SIZES))
    return list(Front(task, cost, 2).play(begun(task, seed)).complete())


def outside(problem: str, arm: str, seed: int, cells: int) -> list[tuple[int, ...]]:
    """Returns the sets that another optimizer evaluates whole."""
    if arm == "random":
        return [tuple(row) for row in np.random.default_rng(seed).integers(0, SIZES, (cells // SCENARIOS, len(SIZES))).tolist()]
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    sampler = (
        optuna.samplers.TPESampler(seed=seed) if arm == "tpe" else optuna.samplers.NSGAIISampler(seed=seed, population_size=20)
    )
    study = optuna.create_study(directions=["minimize"] * len(PROBLEMS[problem][1]), sampler=sampler)

    def objectives(trial: Any) -> list[float]:
        return mean_of(problem, [trial.suggest_int(f"x{place}", 0, int(size) - 1) for place, size in enumerate(SIZES)])

    study.optimize(objectives, n_trials=cells // SCENARIOS)
    return [tuple(trial.params.values()) for trial in study.trials]


def share(problem: str, arm: str, seed: int, cells: int) -> float:
    """Returns the dominated share of the box from 0 to the reference."""
    sets = searched(problem, seed, cells) if arm == "surrogate" else outside(problem, arm, seed, cells)
    reference = np.array(PROBLEMS[problem][1])
    points = np.unique([mean_of(problem, each) for each in sets], axis=0) / reference
    return float((points[:, np.newaxis] <= SAMPLES[:, : len(reference)]).all(axis=2).any(axis=0).mean())


def rows(seeds: int) -> Iterator[tuple[str, int, dict[str, np.ndarray[Any, Any]]]]:
    """Yields problem, simulations, and the shares by arm and seed."""
    with ProcessPoolExecutor() as processes:
        for problem, cells in product(PROBLEMS, MARKS):
            wanted = list(product([problem], ARMS, range(seeds), [cells]))
            shares = np.array(list(processes.map(share, *zip(*wanted, strict=True)))).reshape(len(ARMS), seeds)
            yield problem, cells, dict(zip(ARMS, shares, strict=True))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    figures, lost = list[dict[str, Any]](), False
    print("| problem | simulations | " + " | ".join(f"{arm}, worst" for arm in ARMS) + " | p |")
    for problem, cells, by_arm in rows(parser.parse_args().seeds):
        own, others = by_arm["surrogate"], [by_arm[arm] for arm in ARMS[1:]]
        rival = max(others, key=lambda each: each.mean())
        p = float(wilcoxon(own, rival).pvalue) if (own != rival).any() else 1.0
        lost |= cells == MARKS[-1] and p < 0.05 and rival.mean() > own.mean()
        text = " | ".join(f"{each.mean():.3f}, {each.min():.3f}" for each in by_arm.values())
        print(f"| {problem} | {cells} | {text} | {p:.3f} |", flush=True)
        figures.append(
            {"problem": problem, "simulations": cells, "p": p} | {arm: each.tolist() for arm, each in by_arm.items()}
        )
    Path(".drivecal/bench").mkdir(parents=True, exist_ok=True)
    Path(".drivecal/bench/fronts.json").write_text(json.dumps(figures, indent=1))
    sys.exit(int(lost))
