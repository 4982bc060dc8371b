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
from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tests.benchmarks.certified import carry_out

from drivecal.reduction.forest import Forest
from drivecal.reduction.lots import draw
from drivecal.reduction.prediction import Floats, ScenarioLearner, choose_lot

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


@dataclass(slots=True)
class Tally:
    """Counts of a scenario."""

    cells: int = 0
    released: int = 0
    different: int = 0
    lots: int = 0
    rejected: int = 0
    sampled: int = 0
    seconds: float = 0.0
    """CPU time of fits and predictions."""


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


def replay(cells: Scenario, tolerance: float, limit: float) -> Tally:
    """Predicts the cells of a scenario batch by batch."""
    tally, learner = Tally(cells=len(cells.scores)), ScenarioLearner(partial(Forest, tolerance), tolerance)
    for batch in np.unique(cells.batches):
        here = np.flatnonzero(cells.batches == batch)
        features, scores, ratings = cells.features[here], cells.scores[here], cells.ratings[here]
        began = time.process_time()
        told = learner.predict(features)
        if told is None:
            learner.learn(features, scores, ratings)
            continue
        predictions, error_rates = told
        lot = choose_lot(error_rates, limit)
        tally.seconds += time.process_time() - began
        wrong = learner.is_wrong(predictions.scores, scores)
        simulated, weight = np.arange(len(here)), np.ones(len(here))
        if lot is not None:
            identities = [int(here[member]).to_bytes(8) for member in lot.members]
            sampled = lot.members[draw(identities, lot.plan.sample, str(batch).encode())]
            tally.lots += 1
            tally.sampled += len(sampled)
            if lot.plan.releases(int(wrong[sampled].sum())):
                released = np.setdiff1d(lot.members, sampled)
                tally.released += len(released)
                tally.different += int(wrong[released].sum())
                simulated, weight[sampled] = np.setdiff1d(simulated, released), lot.plan.size / lot.plan.sample
            else:
                tally.rejected += 1
        learner.learn(features[simulated], scores[simulated], ratings[simulated])
        seen = predictions.scores[simulated], predictions.confidence[simulated]
        learner.observe(*seen, scores[simulated], weight[simulated])
    return tally


def table(tallies: dict[str, Tally]) -> Iterator[str]:
    """Yields a line per scenario and their sum."""
    yield f"{'':6}{'cells':>9}{'no simulation':>15}{'different':>11}{'lots':>6}{'rejected':>10}{'sampled':>9}{'fits, s':>9}"
    columns = zip(*(asdict(row).values() for row in tallies.values()), strict=True)
    rows = [*tallies.items(), ("all", Tally(*(sum(column) for column in columns)))]
    for name, row in rows:
        share = f"{row.different / row.released:.2%}" if row.released else "-"
        yield (
            f"{name:6}{row.cells:>9,}{row.released / row.cells:>15.1%}{share:>11}{row.lots:>6}{row.rejected:>10}{row.sampled:>9,}"
            f"{row.seconds:>9.1f}"
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
            sum(getattr(row, name) for row in tallies.values()) for name in ("cells", "released", "different")
        )
        good &= different <= limit * cells and (cells < 30_000 or released >= WANTED[tolerance, limit] * cells)
        figures[f"{tolerance:g}/{limit:g}"] = {name: asdict(row) for name, row in tallies.items()}
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text(json.dumps(figures, indent=2))
    return int(not good)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
