"""Curves and maps as parameters at equal simulations, with `surrogate`: `run.py curves [--seeds 10] [--cells 600]`.

The monotone curve of `economy` is declared as a curve, as eight numbers with a chain, and sorted inside the model, where any order
means the same. The map of `deploy/examples/problems/headway-map` has six coefficients. The best known map has any value at each of its
64 support points: CMA-ES starts at what each operating point needs.
"""

import argparse
import json
import runpy
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import cma
import numpy as np
import yaml
from tests.benchmarks._economy_problems import EXAMPLES, HERE, EconomyProblem, in_python, of_folder
from tests.benchmarks.economy import ARMS, FIRST_SEED, Ended, Run

from drivecal.plugins.ports import Floats

TARGET = Path(".drivecal/bench/curves.json")
CURVE, MAP = HERE / "monotone_curve", EXAMPLES / "headway-map"
POINTS = [f"k{place}" for place in range(8)]
GENERATIONS = 300
HEADWAY = {"headway": {"lower": 0.8, "upper": 2.6, "step": 0.05}}


def _as_points(folder: Path, _: Mapping[str, Any]) -> Callable[..., Any]:
    simulate = in_python(folder, yaml.safe_load((folder / "problem.yaml").read_text()))
    return lambda values, data: simulate({**values, **dict(zip(POINTS, values["curve"], strict=True))}, data)


def _sorted_inside(folder: Path, document: Mapping[str, Any]) -> Callable[..., Any]:
    simulate = in_python(folder, document)

    def inside(values: Mapping[str, Any], data: Mapping[str, Any]) -> Any:
        falling = sorted((values[name] for name in POINTS), reverse=True)
        return simulate({**values, **dict(zip(POINTS, falling, strict=True))}, data)

    return inside


def _declared(**course: Any) -> EconomyProblem:
    curve = {"curve": {"axis": list(range(8))}, "lower": 0, "upper": 2, "step": 0.02} | course
    return of_folder(CURVE, _as_points, parameters={"curve": curve} | HEADWAY, constraints=[])


CURVES: dict[str, Callable[[], EconomyProblem]] = {
    "curve": lambda: _declared(monotone="decreasing"),
    "chain of eight": lambda: of_folder(CURVE, in_python),
    "sorted inside": lambda: of_folder(CURVE, _sorted_inside, constraints=[]),
}


def best_cost(problem: EconomyProblem, seed: int, cells: int) -> float:
    """Returns the best cost after a number of cells."""
    run = Run(problem, cells)
    with suppress(Ended):
        ARMS["surrogate"](run, seed)
    return -run.course[-1]


def best_known(cost: float) -> float:
    """Returns the cost of the best map of 64 values that CMA-ES finds near the needed gaps, or of `cost` if that is better."""
    document = yaml.safe_load((MAP / "problem.yaml").read_text())
    axes = document["parameters"]["headway"]
    points = {"headway": {"map": axes["map"], "lower": axes["lower"], "upper": axes["upper"]}}
    free = of_folder(MAP, in_python, parameters=points, constraints=[])
    names = [parameter.name for parameter in free.space.searched]

    def cost_of(values: Floats) -> float:
        given = dict(zip(names, values.tolist(), strict=True))
        ratings = [free.run(given, scenario) for scenario in free.scenarios]
        return float(np.mean([free.scale.failed if each is None else each for each in ratings]))

    module = runpy.run_path(str(MAP / "following.py"))
    ideal = np.array([module["needed"](max(x, module["SPEEDS"][0]), y) for x in axes["map"]["x"] for y in axes["map"]["y"]])
    options = {"bounds": [axes["lower"], axes["upper"]], "seed": 1, "verbose": -9, "maxiter": GENERATIONS}
    _, search = cma.fmin2(cost_of, ideal.clip(axes["lower"], axes["upper"]), 0.03, options)
    return min(cost, float(search.result.fbest))


def main() -> int:
    """Prints the figures; 1 if a curve is worse than the same one sorted inside, or the map reaches less than 95 % of the gain."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--cells", type=int, default=600)
    chosen = parser.parse_args()
    seeds = range(FIRST_SEED, FIRST_SEED + chosen.seeds)
    costs = {name: [best_cost(make(), seed, chosen.cells) for seed in seeds] for name, make in CURVES.items()}
    for name, found in costs.items():
        print(f"{name:16}{np.mean(found):8.4f}  (largest {max(found):.4f})")
    six = of_folder(MAP, in_python)
    reached = [best_cost(six, seed, chosen.cells) for seed in seeds]
    start = float(np.mean([six.run(six.baseline or {}, scenario) or six.scale.failed for scenario in six.scenarios]))
    known = best_known(min(reached))
    shares = [(start - cost) / (start - known) for cost in reached]
    print(f"map: the baseline costs {start:.3f}, six coefficients {np.mean(reached):.3f}, the best known map {known:.3f}")
    print(f"share of the gain: {100 * np.mean(shares):.1f} % (least {100 * min(shares):.1f} %)")
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text(json.dumps({"curves": costs, "map": {"start": start, "reached": reached, "known": known}}, indent=1))
    return int(np.mean(costs["curve"]) > np.mean(costs["sorted inside"]) + 1e-9 or np.mean(shares) < 0.95)


if __name__ == "__main__":
    sys.exit(main())
