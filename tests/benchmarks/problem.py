"""Is the built-in problem a real one? `python tests/benchmarks/run.py problem [--sets 600] [--lines 20] [--processes N]`.

Latin hypercube sets of Table 6's space give the spread of scores, one-at-a-time lines from other such sets show where each parameter
matters, and the features of all candidates show whether two terms say the same. Prints tables, checks what a calibration problem
needs (see `findings`), writes the figures to `.drivecal/bench/problem.json`.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.stats import qmc

from drivecal.domain.evaluations import Failure, RunResult
from drivecal.highway.comfort.reference import REFERENCE
from drivecal.highway.episode.runner import EpisodeRunner
from drivecal.highway.planner.frenet import FRENET
from drivecal.highway.scenarios.highway import HIGHWAY
from drivecal.highway.vehicle.single_track import SINGLE_TRACK

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

TARGET = Path(".drivecal/bench/problem.json")
SPACE = FRENET.spaces["highway"]
NAMES = [parameter.name for parameter in SPACE]
SCENARIOS = list(HIGHWAY.scenarios)
POINTS = 10
"""Values along each one-at-a-time line, from one end of the range to the other."""
CHUNK = 50


@cache
def runner_of(scenario: str) -> EpisodeRunner:
    """With the vehicle's nominal values."""
    vehicle = SINGLE_TRACK.create({parameter.name: parameter.nominal for parameter in SINGLE_TRACK.parameters})
    return EpisodeRunner(HIGHWAY.scenarios[scenario], FRENET, vehicle, REFERENCE)


def run(scenario: str, sets: list[list[float]]) -> list[tuple[float, float, str | None]]:
    """Score, rating and failure of each set."""
    results: list[RunResult] = [runner_of(scenario).run(parameters) for parameters in sets]
    return [(result.rating.score, result.rating.rating, result.failure) for result in results]


def run_all(pool: Executor, sets: list[list[float]]) -> tuple[Integers, Floats, dict[str, Counter[str]]]:
    """Scores and ratings, shape (n, n_scenarios), and the failures by scenario."""
    starts = range(0, len(sets), CHUNK)
    jobs = {name: [pool.submit(run, name, sets[start : start + CHUNK]) for start in starts] for name in SCENARIOS}
    rows = {name: [row for job in futures for row in job.result()] for name, futures in jobs.items()}
    scores = np.array([[row[0] for row in rows[name]] for name in SCENARIOS]).T
    ratings = np.array([[row[1] for row in rows[name]] for name in SCENARIOS]).T
    return scores, ratings, {name: Counter(row[2] for row in rows[name] if row[2]) for name in SCENARIOS}


def latin_hypercube(count: int, seed: int) -> Integers:
    """Grid indices, shape (count, n_parameters)."""
    unit = qmc.LatinHypercube(len(SPACE), seed=seed).random(count)
    return np.rint(unit * [parameter.n_values - 1 for parameter in SPACE]).astype(np.int64)


def values(indices: Integers) -> list[list[float]]:
    """Parameter values at grid indices."""
    return [[float(parameter.value(index)) for index, parameter in zip(row, SPACE, strict=True)] for row in indices.tolist()]


def lines(bases: Integers) -> Integers:
    """One line along each parameter through each base, shape (n_bases, n_parameters, POINTS, n_parameters)."""
    found = np.repeat(np.repeat(bases[:, None, None, :], len(SPACE), axis=1), POINTS, axis=2)
    for column, parameter in enumerate(SPACE):
        found[:, column, :, column] = np.rint(np.linspace(0, parameter.n_values - 1, POINTS)).astype(np.int64)
    return found


def features_of(scenario: str, sets: list[list[float]]) -> Floats:
    """Features P1..P11 of all candidates at all planning instants less their mean at that instant, shape (n, 11): a choice between
    candidates only sees differences between them."""
    loop: Any = runner_of(scenario)._loop
    planner = loop._planner
    found: list[Floats] = []

    class Watched:
        period = planner.period
        reset = staticmethod(planner.reset)

        @staticmethod
        def plan(observation: Any) -> Any:
            trajectory = planner.plan(observation)
            terms = planner.features()[:, 1:]
            found.append(terms - terms.mean(axis=0))
            return trajectory

    loop._planner = Watched
    try:
        for parameters in sets:
            loop.drive(parameters)
    finally:
        loop._planner = planner
    return np.concatenate(found)


def correlation(features: Floats) -> Floats:
    """Pearson's r, shape (11, 11); 0 where a feature never differs."""
    with np.errstate(invalid="ignore"):
        matrix: Floats = np.nan_to_num(np.asarray(np.corrcoef(features.T)))
    return matrix


def regions(changes: Floats) -> str:
    """How much a parameter matters along its range: one character per interval, '.' where no line changes the score, else the share
    of lines in tenths (9 = 90 % or more)."""
    return "".join("." if share == 0 else str(min(9, int(share * 10))) for share in changes)


def has_dead_end(changes: Floats) -> bool:
    """True where a region that begins at either end of the range has no influence."""
    return bool(changes[0] == 0 or changes[-1] == 0)


def findings(figures: dict[str, Any]) -> list[str]:
    """What is wrong with the problem; empty where it is a real one."""
    wrong = []
    for name, row in figures["scenarios"].items():
        if row["distinct_scores"] < 5:
            wrong.append(f"{name}: only {row['distinct_scores']} of the eight scores occur")
        if row["share_best"] >= 0.30:
            wrong.append(f"{name}: {row['share_best']:.0%} of the sets score 7")
        if row["share_failed"] >= 0.40:
            wrong.append(f"{name}: {row['share_failed']:.0%} of the sets fail")
    for parameter, row in figures["influence"].items():
        if not any(max(changes) > 0 for changes in row.values()):
            wrong.append(f"{parameter} changes no score")
        if not any(has_dead_end(np.array(changes)) for changes in row.values()):
            wrong.append(f"{parameter} has no region without influence")
    maps = {name: str([row[name] for row in figures["influence"].values()]) for name in SCENARIOS}
    if len(set(maps.values())) < len(SCENARIOS):
        wrong.append("two scenarios have the same sensitive regions")
    if figures["largest_correlation"] >= 0.98:
        wrong.append(f"two features are copies of each other: |r| = {figures['largest_correlation']:.3f}")
    if figures["objective"]["at_best"] < 2:
        wrong.append("the best objective is found by one set only")
    if figures["objective"]["at_best"] > 0.02 * figures["sets"]:
        wrong.append("the best objective is found at once")
    return wrong


def print_scores(figures: dict[str, Any]) -> None:
    """Histograms of the scores."""
    print(f"{figures['sets']} Latin hypercube sets: share (%) of each score")
    print("     " + "".join(f"{score:>7}" for score in range(8)) + "   failed  (collision, off road, task missed, unstable)")
    for name, row in figures["scenarios"].items():
        kinds = ", ".join(str(row["failures"].get(kind, 0)) for kind in Failure)
        shares = "".join(f"{100 * share:7.1f}" for share in row["shares"])
        print(f"{name:5}{shares}{100 * row['share_failed']:9.1f}  ({kinds})")
    objective = figures["objective"]
    quantiles = ", ".join(f"{value:.2f}" for value in objective["quantiles"])
    print(
        f"objective: best {objective['best']:.3f} by {objective['at_best']} sets; 1, 25, 50, 75, 99 % quantiles {quantiles}\n"
    )


def print_influence(figures: dict[str, Any]) -> None:
    """Where each parameter changes the score."""
    print(
        f"share of {figures['lines']} lines whose score changes from each of {POINTS} values to the next ('.': none, 9: 90 %)"
    )
    print("     " + "".join(f"{name:>12}" for name in SCENARIOS) + "   changed lines (%)")
    for parameter, row in figures["influence"].items():
        changed = " ".join(f"{100 * figures['changed'][parameter][name]:3.0f}" for name in SCENARIOS)
        print(f"{parameter:5}" + "".join(f"{regions(np.array(row[name])):>12}" for name in SCENARIOS) + f"   {changed}")
    print("\ncorrelation of the features over candidates, all scenarios")
    print("     " + "".join(f"{name:>7}" for name in NAMES))
    for name, row in zip(NAMES, figures["correlation"], strict=True):
        print(f"{name:5}" + "".join(f"{value:7.2f}" for value in row))
    print(f"largest |r| of two features in one scenario: {figures['largest_correlation_in_a_scenario']}\n")


def measure(n_sets: int, n_lines: int, processes: int) -> dict[str, Any]:
    """All figures."""
    with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn")) as pool:
        sets = latin_hypercube(n_sets, seed=1)
        scores, ratings, failures = run_all(pool, values(sets))
        bases = latin_hypercube(n_lines, seed=2)
        along = lines(bases)
        shape = (*along.shape[:3], len(SCENARIOS))
        line_scores = run_all(pool, values(along.reshape(-1, len(SPACE))))[0].reshape(shape)
        jobs = [pool.submit(features_of, name, values(sets[:4])) for name in SCENARIOS]
        features = [job.result() for job in jobs]
    changes = (np.diff(line_scores, axis=2) != 0).mean(axis=0)
    changed = (np.ptp(line_scores, axis=2) > 0).mean(axis=0)
    objective = scores.mean(axis=1)
    together = correlation(np.concatenate(features))
    off_diagonal = ~np.eye(len(SPACE), dtype=bool)
    each = [np.abs(correlation(rows)) * off_diagonal for rows in features]
    pairs = [np.unravel_index(int(matrix.argmax()), matrix.shape) for matrix in each]
    return {
        "sets": n_sets,
        "lines": n_lines,
        "scenarios": {
            name: {
                "shares": [float((scores[:, column] == score).mean()) for score in range(8)],
                "distinct_scores": len(set(scores[:, column].tolist())),
                "share_best": float((scores[:, column] == 7).mean()),
                "share_failed": failures[name].total() / n_sets,
                "failures": dict(failures[name]),
                "mean_rating": float(ratings[:, column].mean()),
            }
            for column, name in enumerate(SCENARIOS)
        },
        "objective": {
            "best": float(objective.max()),
            "at_best": int((objective > objective.max() - 1e-9).sum()),
            "best_set": dict(zip(NAMES, values(sets[[int(objective.argmax())]])[0], strict=True)),
            "best_scores": scores[int(objective.argmax())].tolist(),
            "quantiles": np.quantile(objective, [0.01, 0.25, 0.5, 0.75, 0.99]).tolist(),
        },
        "influence": {
            name: {scenario: changes[row, :, column].tolist() for column, scenario in enumerate(SCENARIOS)}
            for row, name in enumerate(NAMES)
        },
        "changed": {
            name: {scenario: float(changed[row, column]) for column, scenario in enumerate(SCENARIOS)}
            for row, name in enumerate(NAMES)
        },
        "correlation": together.tolist(),
        "largest_correlation": float(np.abs(together * off_diagonal).max()),
        "largest_correlation_in_a_scenario": {
            name: f"{matrix.max():.2f} ({NAMES[pair[0]]}, {NAMES[pair[1]]})"
            for name, matrix, pair in zip(SCENARIOS, each, pairs, strict=True)
        },
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the tables and what is wrong, writes the figures; 1 where something is wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=600)
    parser.add_argument("--lines", type=int, default=20)
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--output", type=Path, default=TARGET)
    options = parser.parse_args(arguments)
    figures = measure(options.sets, options.lines, options.processes)
    print_scores(figures)
    print_influence(figures)
    wrong = findings(figures)
    figures["wrong"] = wrong
    print("\n".join(wrong) if wrong else "a real problem: every condition holds")
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(json.dumps(figures, indent=1))
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
