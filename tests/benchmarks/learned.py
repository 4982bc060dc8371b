"""What the learned parts cost and change: `python tests/benchmarks/learned.py`.

Evaluations with the hybrid vehicle and with the learned evaluator, beside the plain ones; of each run the fastest of several rounds counts.
Then how far the scores move, on the same parameter sets.
"""

from __future__ import annotations

import json
import sys
from itertools import product
from pathlib import Path
from time import thread_time

import numpy as np
from scipy.stats import qmc

from drivecal.comfort.learned import LEARNED
from drivecal.comfort.plugin import REFERENCE
from drivecal.episode.runner import Runner
from drivecal.planner.plugin import FRENET
from drivecal.scenarios.plugin import HIGHWAY
from drivecal.vehicle.hybrid import HYBRID
from drivecal.vehicle.plugin import SINGLE_TRACK

TARGET = Path(".drivecal/bench/learned.json")
AT_MOST = 1.5
"""Times the plain evaluation, with both learned parts, summed over the scenarios."""
ROUNDS = 8
TIMED, SETS = 4, 24


def main() -> int:
    """Prints the tables, writes the figures; 1 where an evaluation with both costs more than `AT_MOST` times the plain one."""
    space = FRENET.spaces["highway"]
    unit = qmc.LatinHypercube(len(space), seed=1).random(SETS)
    sets = [[float(one.value(round(u * (one.n_values - 1)))) for u, one in zip(row, space, strict=True)] for row in unit]
    kinds = list(product((SINGLE_TRACK, HYBRID), (REFERENCE, LEARNED)))
    names = [f"{vehicle.name}, {evaluator.name}" for vehicle, evaluator in kinds]
    nominal = {parameter.name: parameter.nominal for parameter in SINGLE_TRACK.parameters}
    milliseconds, apart, outside = np.zeros((len(HIGHWAY.scenarios), len(kinds))), {}, {}
    for row, (name, scenario) in enumerate(HIGHWAY.scenarios.items()):
        runners = [Runner(scenario, FRENET, vehicle.create(nominal), evaluator) for vehicle, evaluator in kinds]
        fastest = np.full((TIMED, len(kinds)), np.inf)
        for _, number, column in product(range(ROUNDS), range(TIMED), range(len(kinds))):
            begin = thread_time()
            runners[column].run(sets[number])
            fastest[number, column] = min(fastest[number, column], thread_time() - begin)
        milliseconds[row] = 1e3 * fastest.mean(axis=0)
        results = [[runner.run(parameters) for runner in runners] for parameters in sets]
        scores = np.array([[result.rating.score for result in line] for line in results])
        apart[name] = np.abs(scores - scores[:, :1])
        outside[name] = float(np.mean([line[2].metrics["outside_training_range_s"] for line in results]))
    print(f"{'ms per evaluation':18}" + "".join(f"{name:>26}" for name in names))
    for name, line in zip(HIGHWAY.scenarios, milliseconds, strict=True):
        print(f"{name:18}" + "".join(f"{value:26.2f}" for value in line))
    ratios = milliseconds.sum(axis=0) / milliseconds[:, 0].sum()
    print(f"{'ratio':18}" + "".join(f"{value:26.3f}" for value in ratios) + f"   at most {AT_MOST}\n")
    print(f"scores apart from those of the plain evaluation, {SETS} parameter sets: equal / at most one apart")
    for name, steps in apart.items():
        shares = [f"{(column == 0).mean():.2f} / {(column <= 1).mean():.2f}" for column in steps.T]
        print(f"{name:18}" + "".join(f"{share:>26}" for share in shares) + f"   hybrid outside its range {outside[name]:.2f} s")
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    figures = {
        "milliseconds": {
            name: dict(zip(names, line, strict=True)) for name, line in zip(apart, milliseconds.tolist(), strict=True)
        },
        "ratio": dict(zip(names, ratios.tolist(), strict=True)),
        "at_most": AT_MOST,
        "within_one": {
            name: dict(zip(names, (steps <= 1).mean(axis=0).tolist(), strict=True)) for name, steps in apart.items()
        },
    }
    TARGET.write_text(json.dumps(figures, indent=1))
    return int(ratios[-1] > AT_MOST)


if __name__ == "__main__":
    sys.exit(main())
