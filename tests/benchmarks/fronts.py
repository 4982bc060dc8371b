"""Fronts against pymoo's own NSGA-II at equal requested cells: `python tests/benchmarks/run.py fronts [--seeds 10] [--highway] [...]`.

ZDT1 and DTLZ2 on grids of 1,001 values, pymoo on continuous ones. With `--highway` also campaigns on the built-in problem, on a database
of their own each: comfort on straight roads against comfort in curves with predictions and certificates, and comfort against the largest
lateral jerk with certificates. Per seed: the hypervolume of all sets that were asked for, relative to pymoo's; on `highway` also the
simulations as a share of pymoo's, those of the confirmation included: until the mean over the seeds reaches a hypervolume that both
searches reach, the smaller one of the two last means (at most 0.6 wanted), up to pymoo's last hypervolume of the same seed in those that
reach it, and in all. Intervals are t intervals of the mean (95 %).

`--weightings 10` compares, for each weighting of the objectives, the best set that the first seed's search already has with that of a
fresh search of one objective and as many requested sets: at most one tolerance worse in at least nine of ten is wanted. The tolerance is
that of the score on `highway`, and 0.02, i.e. 2 % of an objective's range on the front, on ZDT1 and DTLZ2.

Finished searches of the same size on `highway` are kept in `.drivecal/bench/fronts.jsonl` and not made again.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
from pymoo.algorithms.moo import nsga2
from pymoo.core.problem import Problem
from pymoo.optimize import minimize
from scipy import stats
from tests.benchmarks._objective import SCENARIOS, runner, space
from tests.benchmarks._weightings import Weighted, on_functions, on_server
from tests.benchmarks.efficiency import wait_for_workers

from drivecal.analysis.front import hypervolume, non_dominated
from drivecal.cli.commands.demo.coordinator import coordinator, fresh_folder
from drivecal.client.client import Client
from drivecal.contracts.campaign import Campaign
from drivecal.optimizers.nsga import NSGA2
from drivecal.plugins.ports import Floats

HOME = Path(".drivecal/bench/fronts").absolute()
TARGET = Path(".drivecal/bench/fronts.json")
KEPT = Path(".drivecal/bench/fronts.jsonl")
VALUES = 1001
JERK, MOST_JERK = "peak_lateral_jerk_mps3", 20.0
STRAIGHT, CURVED = SCENARIOS[:3], SCENARIOS[3:]
MOST_SIMULATIONS = 0.6
"""Largest share of pymoo's simulations for the same hypervolume with reuse."""
GOOD_WEIGHTINGS = 0.9
"""Smallest share of weightings whose best set is at most one tolerance worse than a fresh search's."""
SAME = 1 - 1e-9
"""Share of a hypervolume that counts as all of it: objectives are compared to nine decimals."""
TOLERANCE = 0.02
FUNCTION_SEED, HIGHWAY_SEED = 1, 1
"""Seeds of the searches whose weightings are compared."""
FORMS: dict[str, dict[str, Any]] = {
    "split": {
        "objectives": [
            {"score": "comfort", "name": name, "scenarios": list(of)} for name, of in (("first", STRAIGHT), ("second", CURVED))
        ],
        "reduction": {"mode": "predicted"},
    },
    "jerk": {
        "objectives": [
            {"score": "comfort"},
            {"measure": JERK, "direction": "minimise", "aggregate": "max", "failed": MOST_JERK, "reference": MOST_JERK},
        ],
        "reduction": {"mode": "exact"},
    },
}
REFERENCES = {"split": np.array([0.0, 0.0]), "jerk": np.array([0.0, -MOST_JERK])}
"""Higher is better."""

Costs = Callable[[Floats], Floats]
"""Costs, shape (n, m), of shares of the ranges, shape (n, k)."""


@dataclass(frozen=True)
class Compared:
    """Hypervolumes by seed, ours and pymoo's; on the built-in problem also both after each iteration, and our share of pymoo's simulations:
    at pymoo's hypervolume, null where it was not reached, in all, and after each iteration."""

    problem: str
    seed: int
    population: int
    iterations: int
    ours: float
    theirs: float
    until: float | None = None
    simulated: float | None = None
    grown: Sequence[float] = ()
    grown_by_pymoo: Sequence[float] = ()
    spent: Sequence[float] = ()

    @property
    def relative(self) -> float:
        """Our hypervolume as a share of pymoo's."""
        return self.ours / self.theirs


def zdt1(shares: Floats) -> Floats:
    """Zitzler, Deb and Thiele 2000."""
    slope = 1 + 9 * shares[:, 1:].mean(axis=1)
    return np.column_stack([shares[:, 0], slope * (1 - np.sqrt(shares[:, 0] / slope))])


def dtlz2(shares: Floats) -> Floats:
    """Deb, Thiele, Laumanns and Zitzler 2002, three objectives."""
    away = 1 + ((shares[:, 2:] - 0.5) ** 2).sum(axis=1)
    first, second = (shares[:, :2] * np.pi / 2).T
    columns = [np.cos(first) * np.cos(second), np.cos(first) * np.sin(second), np.sin(first)]
    costs: Floats = away[:, np.newaxis] * np.column_stack(columns)
    return costs


def volume(gains: Floats, reference: Floats) -> float:
    """The hypervolume of the non-dominated rows."""
    return hypervolume(gains[non_dominated(gains)], reference) or 0.0


def by_pymoo(costs: Costs, variables: int, population: int, iterations: int, seed: int) -> Floats:
    """Everything that pymoo's NSGA-II asked for, as gains."""
    asked: list[Floats] = []

    class Evaluated(Problem):  # type: ignore[misc]  # pymoo ships no types
        def __init__(self) -> None:
            shape = costs(np.full((1, variables), 0.5)).shape[1]
            super().__init__(n_var=variables, n_obj=shape, xl=np.zeros(variables), xu=np.ones(variables))

        def _evaluate(self, x: Floats, out: dict[str, Any], *_: Any, **__: Any) -> None:
            out["F"] = costs(x)
            asked.append(-out["F"])

    minimize(Evaluated(), nsga2.NSGA2(pop_size=population), ("n_gen", iterations), seed=seed)
    return np.concatenate(asked)


def by_drivecal(costs: Costs, variables: int, population: int, iterations: int, seed: int) -> Floats:
    """Everything that our optimizer asked for, as gains."""
    settings = NSGA2.settings.model_validate(
        {"kind": "nsga2", "population": population, "iterations": iterations, "seed": seed}
    )
    optimizer = NSGA2.create(settings, np.full(variables, VALUES))
    asked = []
    for _ in range(iterations):
        asked.append(-costs(optimizer.ask().population / (VALUES - 1)))
        optimizer.tell(asked[-1], np.zeros(population))
    return np.concatenate(asked)


def simulate(scenario: str, sets: Sequence[Sequence[float]]) -> list[tuple[float, float]]:
    """Score and jerk of sets, in a process of the pool."""
    results = [runner(scenario).run(parameters) for parameters in sets]
    return [(result.rating.score, MOST_JERK if result.failure else result.metrics[JERK]) for result in results]


def driven(pool: ProcessPoolExecutor, form: str) -> Costs:
    """The costs of the built-in problem, simulated."""
    lower = np.array([float(parameter.lower) for parameter in space()])
    upper = np.array([float(parameter.upper) for parameter in space()])

    def costs(shares: Floats) -> Floats:
        sets = (lower + shares * (upper - lower)).tolist()
        futures = [pool.submit(simulate, scenario, sets) for scenario in SCENARIOS]
        scores, jerks = np.array([future.result() for future in futures]).transpose(2, 0, 1)
        if form == "jerk":
            return np.column_stack([-scores.mean(axis=0), jerks.max(axis=0)])
        return -np.column_stack([scores[: len(STRAIGHT)].mean(axis=0), scores[len(STRAIGHT) :].mean(axis=0)])

    return costs


def searched(client: Client, form: str, population: int, iterations: int, seed: int) -> Campaign:
    """Carries a campaign out."""
    wait_for_workers(client)
    search = {"kind": "nsga2", "population": population, "iterations": iterations, "seed": seed}
    campaign = client.wait(client.submit({"optimizer": search, **FORMS[form]}).id)
    if campaign.state != "succeeded":
        raise RuntimeError(f"the campaign ended as {campaign.state}: {campaign.error}")
    return campaign


def remembered(key: Sequence[object], make: Callable[[], Any]) -> Any:
    """The value that an earlier run kept for a key, else the one that is made and kept now; JSON."""
    known = [json.loads(line) for line in KEPT.read_text().splitlines()] if KEPT.exists() else []
    for entry in known:
        if entry["key"] == list(key):
            return entry["value"]
    value = make()
    KEPT.parent.mkdir(parents=True, exist_ok=True)
    with KEPT.open("a") as file:
        file.write(json.dumps({"key": list(key), "value": value}) + "\n")
    print(*key, value, flush=True)
    return value


def pymoo_on_highway(pool: ProcessPoolExecutor, form: str, population: int, iterations: int, seed: int) -> list[float]:
    """The hypervolume of all sets that pymoo asked for up to each iteration."""
    gains = by_pymoo(driven(pool, form), len(space()), population, iterations, seed)
    return [volume(gains[: population * number], REFERENCES[form]) for number in range(1, iterations + 1)]


def drivecal_on_highway(form: str, population: int, iterations: int, seed: int) -> dict[str, Any]:
    """The hypervolume after each iteration of a campaign, the simulations up to it, and those of the whole campaign."""
    with fresh_folder(HOME), coordinator(HOME) as client:
        campaign = searched(client, form, population, iterations, seed)
        growth = client.front_summary(campaign.id).growth
        simulated = np.cumsum([row["simulated"] + row["failed"] for row in client.rows(campaign.id, "generations")])
    return {
        "iterations": [each.iteration for each in growth],
        "hypervolumes": [each.hypervolume or 0.0 for each in growth],
        "simulated": simulated.tolist(),
        "in all": campaign.cells.simulated + campaign.cells.failed,
    }


def on_highway(pool: ProcessPoolExecutor, form: str, population: int, iterations: int, seed: int) -> Compared:
    """A campaign, and pymoo on the same problem."""
    size = population, iterations
    theirs = remembered(["pymoo, by iteration", form, *size, seed], lambda: pymoo_on_highway(pool, form, *size, seed))
    ours = remembered(["drivecal", form, *size, seed], lambda: drivecal_on_highway(form, *size, seed))
    cells = population * iterations * len(SCENARIOS)
    known = dict(zip(ours["iterations"], ours["hypervolumes"], strict=True))
    grown = list(accumulate((known.get(iteration, 0.0) for iteration in range(iterations)), max))
    confirmed = ours["in all"] - ours["simulated"][-1]
    spent = [(simulated + confirmed) / cells for simulated in ours["simulated"]]
    until = next((share for share, reaches in zip(spent, grown, strict=True) if reaches >= SAME * theirs[-1]), None)
    return Compared(f"highway {form}", seed, *size, grown[-1], theirs[-1], until, ours["in all"] / cells, grown, theirs, spent)


def weightings_on_highway(population: int, iterations: int, count: int) -> list[Weighted]:
    """Compares weightings of comfort on straight roads and in curves."""
    shares = [dict.fromkeys(of, 1 / len(of)) for of in (STRAIGHT, CURVED)]
    with fresh_folder(HOME), coordinator(HOME) as client:
        campaign = searched(client, "split", population, iterations, HIGHWAY_SEED)
        return list(on_server(client, "highway split", campaign, shares, HIGHWAY_SEED, count))


def interval(values: Sequence[float]) -> tuple[float, float]:
    """The t interval of the mean."""
    mean, error = float(np.mean(values)), float(stats.sem(values)) if len(values) > 1 else float("nan")
    width = float(stats.t.ppf(0.975, len(values) - 1)) * error if error else 0.0
    return mean - width, mean + width


def with_interval(values: Sequence[float]) -> str:
    """The mean and its interval."""
    lower, upper = interval(values)
    return f"{float(np.mean(values)):.3f} [{lower:.3f}, {upper:.3f}]"


def until_both_means_are_reached(rows: Sequence[Compared]) -> float:
    """Our mean simulations until our mean hypervolume is at least the smaller one of the two last means, as a share of pymoo's until its
    mean is."""
    grown, by_pymoo = (np.mean([getattr(row, name) for row in rows], axis=0) for name in ("grown", "grown_by_pymoo"))
    level = SAME * min(grown[-1], by_pymoo[-1])
    theirs = (int(np.argmax(by_pymoo >= level)) + 1) / rows[0].iterations
    return float(np.mean([row.spent for row in rows], axis=0)[np.argmax(grown >= level)]) / theirs


def print_compared(rows: Sequence[Compared]) -> tuple[bool, list[dict[str, Any]]]:
    """Prints a line per problem. Returns whether something is not as wanted, and the figures."""
    worse, figures = False, []
    print("problem           hypervolume / pymoo's    simulated / pymoo's: at equal means, at pymoo's of each seed; in all")
    for problem in dict.fromkeys(row.problem for row in rows):
        own = [row for row in rows if row.problem == problem]
        lower, upper = interval([row.relative for row in own])
        worse |= upper < 1.0
        line = f"{problem:16}  {np.mean([row.relative for row in own]):.4f} [{lower:.4f}, {upper:.4f}]"
        until = [row.until for row in own if row.until is not None]
        if own[0].simulated is not None:
            mean = until_both_means_are_reached(own)
            worse |= mean > MOST_SIMULATIONS
            ends = with_interval(until) if until else "none"
            whole = with_interval([row.simulated or 0.0 for row in own])
            line += f"  {mean:.3f}  {ends} in {len(until)} of {len(own)}; {whole}"
        print(line)
        figures.append({"problem": problem, "interval": [lower, upper], "rows": [asdict(row) for row in own]})
    return worse, figures


def print_weighted(rows: Sequence[Weighted]) -> bool:
    """Prints a line per problem. Returns whether something is not as wanted."""
    worse = False
    print("\nproblem           at most one tolerance worse    known - fresh: mean, worst (tolerance)    longest wait")
    for problem in dict.fromkeys(row.problem for row in rows):
        own = [row for row in rows if row.problem == problem]
        good = sum(row.is_good for row in own)
        worse |= good < GOOD_WEIGHTINGS * len(own)
        apart = [row.known - row.fresh for row in own]
        wait = max(row.seconds for row in own)
        figures = f"{np.mean(apart):+.4f}, {min(apart):+.4f} ({own[0].tolerance:g})"
        print(f"{problem:16}  {good} of {len(own):<24}  {figures:40}  {wait * 1000:.0f} ms")
    return worse


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the tables, writes the figures; 1 if something is not as wanted: a mean hypervolume below pymoo's by more than its interval
    allows, more simulations, or worse weightings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--population", type=int, default=60)
    parser.add_argument("--iterations", type=int, default=60)
    parser.add_argument("--weightings", type=int, default=0, metavar="N", help="compare N weightings of the objectives")
    parser.add_argument("--highway", action="store_true", help="minutes per seed")
    parser.add_argument("--form", action="append", choices=list(FORMS), help="on highway, instead of all")
    parser.add_argument("--highway-seeds", type=int, default=10)
    parser.add_argument("--highway-population", type=int, default=60)
    parser.add_argument("--highway-iterations", type=int, default=10)
    options = parser.parse_args(arguments)
    rows: list[Compared] = []
    weighted: list[Weighted] = []
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    size = options.population, options.iterations
    for name, costs, variables, reference in (
        ("zdt1", zdt1, 10, np.array([-1.1, -1.1])),
        ("dtlz2", dtlz2, 7, np.array([-1.1, -1.1, -1.1])),
    ):
        for seed in range(1, options.seeds + 1):
            gains, others = (search(costs, variables, *size, seed) for search in (by_drivecal, by_pymoo))
            rows.append(Compared(name, seed, *size, volume(gains, reference), volume(others, reference)))
            if seed == FUNCTION_SEED and options.weightings:
                shape = variables, VALUES, options.population
                weighted += on_functions(name, costs, gains, shape, seed, options.weightings, TOLERANCE)
    if options.highway:
        size = options.highway_population, options.highway_iterations
        with ProcessPoolExecutor(os.cpu_count() or 1, mp_context=multiprocessing.get_context("spawn")) as pool:
            for form in options.form or FORMS:
                rows += [on_highway(pool, form, *size, seed) for seed in range(1, options.highway_seeds + 1)]
        if options.weightings:
            weighted += weightings_on_highway(*size, options.weightings)
    worse, figures = print_compared(rows)
    if weighted:
        worse |= print_weighted(weighted)
    document = vars(options) | {"problems": figures, "weightings": [asdict(row) for row in weighted]}
    TARGET.write_text(json.dumps(document, indent=1))
    return int(worse)


if __name__ == "__main__":
    sys.exit(main())
