"""Best objective by the number of simulated cells, for optimizers on several problems: `run.py economy [--problems NAME ...]`.

More options: `--arms NAME ... --seeds N --cells N --cache FOLDER`. Optimizers search in this process; a cell is a set in a scenario. The
figures are the best objective that is simulated in all scenarios after 120, 300, 600 and 1,200 cells, for paired seeds, mean ranks, and
Wilcoxon's signed-rank tests of `surrogate` against each other optimizer. Finished runs are kept in `.drivecal/bench/economy.jsonl`,
answers in the folder of `--cache`. Ten seeds of 1,200 cells take some 90 minutes of a core. Other figures in their place:

- `--reach`: after how many cells, at most `--cells`, `surrogate` reaches what `genetic` finds with 200 sets x 15 iterations
- `--outlook`: how often a search with twice the cells, which begins with these answers, improved the best objective by no more than the
  first one expects at its end (`expected_gain`); rounds as in campaigns, first searches of a quarter and of half of `--cells`
- `--busy WORKERS`: how busy pretended workers are that take 10 s for a run
"""

import argparse
import heapq
import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import rankdata, wilcoxon
from tests.benchmarks._economy_problems import OTHERS, PROBLEMS, EconomyProblem, problem

from drivecal.analysis.convergence import expected_gain
from drivecal.campaigns.stages.asking import WINDOW, room_for
from drivecal.domain.parameters import Indices
from drivecal.optimizers.built_in import GENETIC, GeneticSettings
from drivecal.optimizers.repair import RepairingOptimizer
from drivecal.optimizers.surrogate.plugin import SURROGATE, SurrogateSettings
from drivecal.plugins.ports import OptimizerPlugin
from drivecal.plugins.search import AskedCell, CellAnswer

TARGET = Path(".drivecal/bench/economy.json")
BUDGETS = (120, 300, 600, 1200)
LEVEL = 0.05
FIRST_SEED = 1000


class Ended(Exception):  # noqa: N818  not an error: all cells are spent
    """The budget of a run is spent."""


class Run:
    """Simulates cells and follows the best objective; begins with the answers of the run `before` it."""

    def __init__(self, chosen: EconomyProblem, cells: int, before: "Run | None" = None) -> None:
        self.problem, self._cells = chosen, cells
        self._values: dict[tuple[int, ...], dict[int, float]] = {} if before is None else deepcopy(before._values)
        self._best = -np.inf if before is None else before.course[-1]
        self.answers: list[CellAnswer] = [] if before is None else list(before.answers)
        self.course: list[float] = []
        """The best objective after each cell; negative infinity before the first complete set."""

    def cell(self, cell: AskedCell) -> Any:
        """Returns the answer of a cell that was not asked before. Raises Ended when the budget is spent."""
        if len(self.course) >= self._cells:
            raise Ended
        answer = self.problem.answer(cell)
        self.answers.append(answer)
        values = self._values.setdefault(cell.indices, {})
        values[cell.scenario] = answer.values[0]
        if len(values) == len(self.problem.scenarios):
            self._best = max(self._best, self.problem.objective([values[place] for place in range(len(values))]))
        self.course.append(self._best)
        return answer

    def whole(self, row: Sequence[int]) -> tuple[float, float]:
        """Returns objective and mean rating of a set, higher is better."""
        indices = tuple(int(index) for index in row)
        known = self._values.setdefault(indices, {})
        for scenario in range(len(self.problem.scenarios)):
            if scenario not in known:
                self.cell(AskedCell(indices, scenario))
        ratings = [known[scenario] for scenario in range(len(known))]
        return self.problem.objective(ratings), self.problem.scale.sign * float(np.mean(ratings))


def random_sets(run: Run, seed: int) -> None:
    """Latin hypercubes, the baseline first."""
    generator, task = np.random.default_rng(seed), run.problem.task(None)
    for row in task.start.tolist():
        run.whole(row)
    while True:
        for row in task.sample(100, generator).tolist():
            run.whole(row)


def generations(plugin: OptimizerPlugin, settings: Any) -> Callable[[Run, int], None]:
    """A generational optimizer, whose infeasible sets are repaired."""

    def search(run: Run, seed: int) -> None:
        task = run.problem.task(None)
        own = settings.model_copy(update={"seed": seed})
        optimizer = RepairingOptimizer(plugin.create(own, task.n_values, task.start, task.kinds), task.repair)
        unchanged = 0
        for _ in range(settings.iterations):
            if unchanged == 200:  # populations that are equal would be asked for ever
                return
            before = len(run.course)
            answers = np.array([run.whole(row) for row in optimizer.ask().population.tolist()])
            optimizer.tell(answers[:, 0], answers[:, 1])
            unchanged = unchanged + 1 if len(run.course) == before else 0

    return search


def tpe(run: Run, seed: int) -> None:
    """Optuna's multivariate TPE, told the objective and a little of the rating, a set at a time."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    task = run.problem.task(None)
    study = optuna.create_study(direction="maximize", sampler=optuna.samplers.TPESampler(multivariate=True, seed=seed))
    distributions: dict[str, Any] = {}
    for place, (kind, n) in enumerate(zip(task.kinds, task.n_values.tolist(), strict=True)):
        if kind == "choice":
            distributions[f"x{place}"] = optuna.distributions.CategoricalDistribution(tuple(range(n)))
        elif kind == "continuous":
            distributions[f"x{place}"] = optuna.distributions.FloatDistribution(0.0, 1.0)
        else:
            distributions[f"x{place}"] = optuna.distributions.IntDistribution(0, n - 1)

    def tell(rows: Indices, trial: Any) -> None:
        objective, rating = run.whole(task.repair(rows)[0].tolist())
        study.tell(trial, objective + 1e-3 * rating)

    for row in task.start:
        names = {
            name: float(index / (n - 1)) if kind == "continuous" else int(index)
            for name, index, kind, n in zip(distributions, row, task.kinds, task.n_values, strict=True)
        }
        study.enqueue_trial(names)
    while True:
        trial = study.ask(distributions)
        row = [
            round(trial.params[name] * (n - 1)) if kind == "continuous" else trial.params[name]
            for name, kind, n in zip(distributions, task.kinds, task.n_values.tolist(), strict=True)
        ]
        tell(np.array([row], dtype=np.int64), trial)


def cma_es(run: Run, seed: int) -> None:
    """The library cma with populations of 10 sets in the unit cube, from the first start set. It begins again elsewhere when it stops."""
    import cma

    task = run.problem.task(None)
    last = np.maximum(np.asarray(task.n_values) - 1, 1)
    generator, begin = np.random.default_rng(seed), task.start[0] / last if len(task.start) else np.full(len(last), 0.5)
    while True:
        options = {"bounds": [0, 1], "popsize": 10, "seed": int(generator.integers(1, 2**31)), "verbose": -9}
        strategy = cma.CMAEvolutionStrategy(begin, 0.25, options)
        while not strategy.stop():
            points = strategy.ask()
            rows = task.repair(np.rint(np.array(points) * last).astype(np.int64))
            answers = [run.whole(row) for row in rows.tolist()]
            strategy.tell(points, [-objective - 1e-3 * rating for objective, rating in answers])
        begin = task.sample(1, generator)[0] / last


def surrogate(room: int, window: int, **changes: Any) -> Callable[[Run, int], None]:
    """The search by the cell in rounds of `room` cells; `window` rounds are under way; `changes` of its task."""

    def search(run: Run, seed: int) -> None:
        asking = SURROGATE.begin(SurrogateSettings(seed=seed), replace(run.problem.task(run._cells, window), **changes))
        rounds: list[Sequence[AskedCell]] = []
        while True:
            asked = asking.ask(room)
            rounds += [asked] if asked else []
            if not rounds:
                return
            if not asked or len(rounds) >= window:
                asking.tell([run.cell(cell) for cell in rounds.pop(0)])

    return search


def _genetic(population: int, iterations: int = 10_000) -> Callable[[Run, int], None]:
    return generations(GENETIC, GeneticSettings(population=population, iterations=iterations))


ARMS: Mapping[str, Callable[[Run, int], None]] = {
    "random": random_sets,
    "genetic_10": _genetic(10),
    "genetic_20": _genetic(20),
    "genetic_50": _genetic(50),
    "cma_es": cma_es,
    "tpe": tpe,
    "surrogate": surrogate(1, 1),
    "surrogate_2x5": surrogate(2, WINDOW),
    "surrogate_16x5": surrogate(16, WINDOW),  # as for 32 workers
}


def measured(name: str, arm: str, seed: int, cells: int, cache: Path | None) -> dict[str, Any]:
    """Returns the figures of a run."""
    run, begin = Run(problem(name, cache), cells), time.process_time()
    with suppress(Ended):
        ARMS[arm](run, seed)
    best = {str(budget): run.course[min(budget, len(run.course)) - 1] for budget in BUDGETS if budget <= cells}
    levels = {str(level): _reached(run.course, level) for level in (6.333, 6.5)} if name == "motorway" else {}
    return {
        "problem": name,
        "arm": arm,
        "seed": seed,
        "cells": cells,
        "best": best,
        "reached": levels,
        "seconds": time.process_time() - begin,
    }


def reach(name: str, seed: int, cells: int, cache: Path | None) -> tuple[int, float, int | None]:
    """Returns the cells of `genetic` 200 x 15, its best objective, and after how many `surrogate` has an equal one (None: after none)."""
    genetic, ours = Run(problem(name, cache), sys.maxsize), Run(problem(name, cache), cells)
    _genetic(200, 15)(genetic, seed)
    with suppress(Ended):
        ARMS["surrogate"](ours, seed)
    return len(genetic.course), genetic.course[-1], _reached(ours.course, genetic.course[-1])


def reaching(names: Sequence[str], seeds: Sequence[int], cells: int, cache: Path | None) -> Iterator[str]:
    """Yields a line for each problem: medians over the seeds; a search that does not get there counts as longer than all others."""
    yield f"{'':16}{'genetic 200 x 15':>18}{'surrogate':>12}{'share':>8}   reached"
    for name in names:
        result = [reach(name, seed, cells, cache) for seed in seeds]
        needed = [np.inf if ours is None else ours for _, _, ours in result]
        theirs, ours = float(np.median([genetic for genetic, _, _ in result])), float(np.median(needed))
        yield f"{name:16}{theirs:>18,.0f}{ours:>12,.0f}{100 * ours / theirs:>6.1f} %   {int(np.isfinite(needed).sum())} of {len(seeds)}"


def outlooks(names: Sequence[str], seeds: Sequence[int], cells: int, cache: Path | None) -> Iterator[str]:
    """Yields a line for each problem and budget, and one for all: how often the expectation held."""
    yield f"{'':16}{'cells':>8}{'searches':>10}{'held':>8}"
    held: list[bool] = []
    for name, budget in ((name, budget) for name in names for budget in (cells // 4, cells // 2)):
        kept: list[bool] = []
        for seed in seeds:
            chosen = problem(name, cache)
            first = Run(chosen, budget)
            with suppress(Ended):
                surrogate(2, WINDOW)(first, seed)
            expected = expected_gain([best if np.isfinite(best) else None for best in first.course])
            if expected is None:
                continue
            second = Run(chosen, 2 * budget, first)
            with suppress(Ended):
                surrogate(2, WINDOW, known=tuple(first.answers))(second, seed)
            kept.append((second.course or first.course)[-1] - first.course[-1] <= expected + 1e-9)
        held += kept
        yield f"{name:16}{budget:>8}{len(kept):>10}{sum(kept):>8}"
    yield f"{'all':24}{len(held):>10}{sum(held):>8}"


def busy(name: str, workers: int, cells: int, seconds: float = 10.0) -> tuple[float, float]:
    """Returns how busy pretended workers are, as a share of the time from the first ask to the last answer of one campaign by `surrogate`,
    and the longest computation of a round (s). The clock is simulated; computing takes its CPU time. Runs take `seconds`, +- 10 %."""
    chosen, room, draws = problem(name), room_for(workers), np.random.default_rng(FIRST_SEED)
    asking = SURROGATE.begin(SurrogateSettings(seed=FIRST_SEED), chosen.task(cells, WINDOW))
    rounds: list[Sequence[AskedCell]] = []
    ends: list[float] = []
    free, now, work, longest = [0.0] * workers, 0.0, 0.0, 0.0
    while True:
        if len(rounds) >= WINDOW:
            now = max(now, ends[-WINDOW])
            asking.tell([chosen.answer(cell) for cell in rounds[-WINDOW]])
        began = time.process_time()
        asked = asking.ask(room)
        now, longest = now + time.process_time() - began, max(longest, time.process_time() - began)
        if not asked:
            return work / (workers * max(free)), longest
        rounds.append(asked)
        ends.append(now)
        for length in (seconds * draws.lognormal(0.0, 0.1, len(asked))).tolist():
            heapq.heapreplace(free, ended := max(now, free[0]) + length)
            work, ends[-1] = work + length, max(ends[-1], ended)


def _reached(course: Sequence[float], level: float) -> int | None:
    return next((place + 1 for place, best in enumerate(course) if best >= level - 1e-9), None)


def table(rows: Sequence[Mapping[str, Any]], arms: Sequence[str], names: Sequence[str]) -> Iterator[str]:
    """Yields mean objectives by problem and budget, mean ranks, and p-values of `surrogate` being worse or better."""
    for budget in map(str, BUDGETS):
        ranks: list[list[float]] = []
        yield f"\nafter {budget} cells{'':6}" + "".join(f"{arm:>16}" for arm in arms)
        for name in names:
            own = {(row["arm"], row["seed"]): row["best"].get(budget) for row in rows if row["problem"] == name}
            seeds = [n for n in sorted({n for _, n in own}) if all(own.get((arm, n)) is not None for arm in arms)]
            if not seeds:
                continue
            figures = np.array([[own[arm, seed] for arm in arms] for seed in seeds], dtype=np.float64)
            ranks += [list(rankdata(-row)) for row in figures]
            yield f"{name:20}" + "".join(f"{value:>16.4f}" for value in figures.mean(axis=0))
            if "surrogate" in arms and len(seeds) >= 6:
                ours = figures[:, list(arms).index("surrogate")]
                tests = [p_value(ours - figures[:, place]) for place in range(len(arms))]
                yield f"{'  p':20}" + "".join(f"{test:>16}" for test in tests)
        if ranks:
            yield f"{'mean rank':20}" + "".join(f"{value:>16.2f}" for value in np.mean(ranks, axis=0))


def p_value(differences: Any) -> str:
    """Returns the sign of the mean and the p-value of Wilcoxon's signed-rank test."""
    if not np.any(differences):
        return "-"
    p = float(wilcoxon(differences).pvalue)
    return f"{'better' if differences.mean() > 0 else 'worse'}{'*' if p < LEVEL else ''} {p:.3f}"


def main(arguments: Sequence[str]) -> int:
    """Prints the table; 1 if an optimizer is significantly better than `surrogate`."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", nargs="+", choices=[*PROBLEMS, *OTHERS], default=list(PROBLEMS))
    parser.add_argument("--arms", nargs="+", choices=list(ARMS), default=[arm for arm in ARMS if "x" not in arm])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--cells", type=int, default=BUDGETS[1])
    parser.add_argument("--cache", type=Path, help="folder of simulated answers")
    parser.add_argument("--reach", action="store_true")
    parser.add_argument("--outlook", action="store_true")
    parser.add_argument("--busy", type=int, metavar="WORKERS")
    chosen = parser.parse_args(arguments)
    seeds = range(FIRST_SEED, FIRST_SEED + chosen.seeds)
    if chosen.reach:
        for line in reaching(chosen.problems, seeds, chosen.cells, chosen.cache):
            print(line, flush=True)
        return 0
    if chosen.busy is not None:
        for name in chosen.problems:
            share, longest = busy(name, chosen.busy, chosen.cells)
            print(
                f"{name:16}{chosen.busy:,} workers busy for {100 * share:.1f} %; a round is computed in at most {longest:.1f} s",
                flush=True,
            )
        return 0
    if chosen.outlook:
        for line in outlooks(chosen.problems, seeds, chosen.cells, chosen.cache):
            print(line, flush=True)
        return 0
    rows: list[dict[str, Any]] = []
    lines = TARGET.with_suffix(".jsonl")
    lines.parent.mkdir(parents=True, exist_ok=True)
    kept = [json.loads(line) for line in lines.read_text(encoding="utf-8").splitlines()] if lines.exists() else []
    known = {(row["problem"], row["arm"], row["seed"], row["cells"]): row for row in kept}
    for seed in seeds:
        for name in chosen.problems:
            for arm in chosen.arms:
                row = known.get((name, arm, seed, chosen.cells))
                if row is None:
                    row = measured(name, arm, seed, chosen.cells, chosen.cache)
                    with lines.open("a", encoding="utf-8") as file:
                        file.write(json.dumps(row) + "\n")
                    print(f"{name} {arm} {seed}: {row['best']} {row['reached'] or ''} {row['seconds']:.1f} s", flush=True)
                rows.append(row)
    shown = list(table(rows, chosen.arms, chosen.problems))
    print("\n".join(shown))
    TARGET.write_text(json.dumps(rows, indent=1), encoding="utf-8")
    return int(any("worse*" in line for line in shown))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
