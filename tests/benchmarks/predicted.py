"""What predictions could save on the paper's settings, by a replay: `python tests/benchmarks/run.py predicted [--database FILE] [...]`.

A campaign simulates every cell (1,000 individuals, 20 iterations, six scenarios; four minutes on two cores), or `--database` names the
SQLite database of such a campaign. Then its cells come once more, batch by batch: the start population in slices of 250 sets, then each
generation. Per scenario a forest learns the scores known so far and predicts the next batch; a lot is chosen, its sample drawn and
compared. The replay knows the answers of rejected lots and of cells outside a lot, and never those of released ones.

A replay is no closed loop: the search does not see the predicted scores. Smaller with the arguments, which changes the shares.
"""

import argparse
import json
import sqlite3
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tests.benchmarks.certified import carry_out
from tests.support.inspected_lots import Tally, inspect

from drivecal.reduction.forest import Forest
from drivecal.reduction.prediction import Floats, ScenarioLearner

HOME = Path(".drivecal/bench/predicted").absolute()
TARGET = Path(".drivecal/bench/predicted.json")
SLICE = 250
"""Parameter sets of the start population in one batch."""
SETTINGS = ((0.0, 0.05), (1.0, 0.01))
"""(tolerance, limit)."""
WANTED = {(0.0, 0.05): 0.40, (1.0, 0.01): 0.50}
"""Smallest share of cells without a simulation in the replay, at the paper's size."""
CELLS = """
    SELECT scenario, iteration, individual, parameter_set_id, parameter_values, score, rating FROM evaluations
    JOIN parameter_sets ON parameter_sets.id = parameter_set_id WHERE stage = 2 AND score IS NOT NULL ORDER BY iteration, individual"""


@dataclass(frozen=True, slots=True)
class Scenario:
    """Distinct cells of a scenario in the order of their request: features (n, k); scores, ratings, batches (n,)."""

    features: Floats
    scores: Floats
    ratings: Floats
    batches: Floats


def scenarios(database: Path) -> dict[str, Scenario]:
    """Reads the cells of the calibration stage; each parameter set counts at its first request."""
    with closing(sqlite3.connect(database)) as connection:
        rows = connection.execute(CELLS).fetchall()
    read: dict[str, dict[int, tuple[list[float], float, float, int]]] = {}
    for scenario, iteration, individual, number, values, score, rating in rows:
        batch = individual // SLICE if iteration == 0 else 1_000_000 + iteration
        read.setdefault(scenario, {}).setdefault(number, (list(json.loads(values).values()), score, rating, batch))
    ordered = {}
    for scenario, cells in sorted(read.items()):
        features, scores, ratings, batches = (
            np.array(column, dtype=np.float64) for column in zip(*cells.values(), strict=True)
        )
        spread = np.ptp(features, axis=0)
        ordered[scenario] = Scenario(
            (features - features.min(axis=0)) / np.where(spread > 0, spread, 1.0), scores, ratings, batches
        )
    return ordered


def replay(cells: Scenario, tolerance: float, limit: float) -> tuple[Tally, float]:
    """Answers the cells of a scenario batch by batch; returns the counts, and the CPU time of fits and predictions."""
    total, learner = Tally(), ScenarioLearner(partial(Forest, tolerance), tolerance)
    began = time.process_time()
    for batch in np.unique(cells.batches):
        here = np.flatnonzero(cells.batches == batch)
        columns = cells.features[here], cells.scores[here], cells.ratings[here]
        total = added([total, inspect(learner, *columns, limit, str(batch).encode())])
    return total, time.process_time() - began


def added(tallies: Iterable[Tally]) -> Tally:
    """Returns the sums."""
    return Tally(*map(sum, zip(*(asdict(tally).values() for tally in tallies), strict=True)))


def table(tallies: dict[str, tuple[Tally, float]]) -> Iterator[str]:
    """Yields a line per scenario and their sum."""
    yield f"{'':6}{'cells':>9}{'no simulation':>15}{'different':>11}{'lots':>6}{'rejected':>10}{'sampled':>9}{'fits, s':>9}"
    whole = added(row for row, _ in tallies.values()), sum(seconds for _, seconds in tallies.values())
    for name, (row, seconds) in [*tallies.items(), ("all", whole)]:
        share = f"{row.different / row.released:.2%}" if row.released else "-"
        yield (
            f"{name:6}{row.cells:>9,}{row.released / row.cells:>15.1%}{share:>11}{row.lots:>6}{row.rejected:>10}{row.sampled:>9,}"
            f"{seconds:>9.1f}"
        )


def main(arguments: list[str]) -> int:
    """Prints the tables; 1 if a share is below what is wanted, or more than the limit differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--database", type=Path)
    parser.add_argument("--population", type=int, default=1000)
    parser.add_argument("--iterations", type=int, default=20)
    given = parser.parse_args(arguments)
    database = given.database
    if database is None:
        optimizer = {"kind": "genetic", "population": given.population, "iterations": given.iterations, "seed": 1}
        reduction = {"mode": "off", "certified": False, "confirm": 0}
        specification = {"name": "predicted", "sensitivity": None, "optimizer": optimizer, "reduction": reduction}
        database = carry_out(specification, HOME).home / "drivecal.db"
    read, good, figures = scenarios(database), True, dict[str, Any]()
    for tolerance, limit in SETTINGS:
        print(f"\ntolerance {tolerance:g}, limit {limit:.0%}: {database}")
        tallies = {name: replay(cells, tolerance, limit) for name, cells in read.items()}
        print("\n".join(table(tallies)))
        cells, released, different = (
            sum(getattr(row, name) for row, _ in tallies.values()) for name in ("cells", "released", "different")
        )
        good &= different <= limit * cells and (cells < 30_000 or released >= WANTED[tolerance, limit] * cells)
        figures[f"{tolerance:g}/{limit:g}"] = {
            name: asdict(row) | {"seconds": seconds} for name, (row, seconds) in tallies.items()
        }
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text(json.dumps(figures, indent=2))
    return int(not good)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
