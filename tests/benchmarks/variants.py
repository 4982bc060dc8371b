"""Five variants in one search, at twice the simulations of a search for one of them: the best set of each against its own search.

Twelve scenarios are bowls with ripples. The variants weigh all of them (`weights`), or have seven in common and one each (`markets`). Exits
with 0 if the variants' best sets cost on average at most 1 % more than the sets of their own searches.
"""

import json
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
from tests.unit.optimizers.test_surrogate import COST, Played, begun, task_of

from drivecal.analysis.aims import WeightedScore
from drivecal.plugins.search import AskedCell

SIMULATIONS, SEEDS = 240, 10
SHAPE = SCENARIOS, PARAMETERS = 12, 4
SIZES = np.full(PARAMETERS, 101)


def best_of(kind: str, seed: int) -> list[tuple[float, float]]:
    """Returns the best cost of each variant by its own search, and by the search for all with twice the simulations."""
    draw = np.random.default_rng(100 + seed)
    centres, widths = 0.5 + 0.8 * (draw.random(SHAPE) - 0.5), draw.uniform(0.5, 2, SHAPE)
    weights = draw.uniform(0.2, 3, (5, SCENARIOS))
    weights[:, 7:] *= np.eye(5) if kind == "markets" else 1
    weights /= weights.sum(axis=1, keepdims=True)

    def search(rows: np.ndarray, cells: int) -> list[float]:
        held = np.flatnonzero(rows[0])
        aims = [WeightedScore(dict(zip(map(str, held), row[held].tolist(), strict=True)), COST) for row in rows]

        def cost(cell: AskedCell) -> tuple[float, bool]:
            away = (np.array(cell.indices) / 100 - centres[held[cell.scenario]]) * widths[held[cell.scenario]]
            return float((4 * away**2 + 0.15 * (1 - np.cos(6 * np.pi * away))).sum()), False

        task = replace(task_of(aims[0], cells, 4, SIZES, ["grid"] * PARAMETERS), variants=aims[1:])
        played, known = Played(task, cost, 4).play(begun(task, seed)), dict[tuple[int, ...], np.ndarray]()
        for answer in (answer for answers in played.answers for answer in answers):
            known.setdefault(answer.cell.indices, np.full((len(held), 1), np.nan))[answer.cell.scenario] = answer.values
        return [float(-np.nanmax(aim.judge(np.array(list(known.values())))[0])) for aim in aims[1:] or aims]

    together = search(np.vstack([weights.mean(axis=0), weights]), 2 * SIMULATIONS)
    return [(search(row[np.newaxis], SIMULATIONS)[0], other) for row, other in zip(weights, together, strict=True)]


if __name__ == "__main__":
    figures = {}
    with ProcessPoolExecutor() as processes:
        for kind in ("weights", "markets"):
            own, together = np.array(list(processes.map(best_of, [kind] * SEEDS, range(SEEDS)))).reshape(-1, 2).T
            more = together / own - 1
            figures[kind] = {"mean": more.mean(), "median": np.median(more), "not worse by 1 %": (more <= 0.01).mean()}
            print(kind, *(f"{name}: {100 * figure:+.2f} %" for name, figure in figures[kind].items()), sep="  ", flush=True)
    Path(".drivecal/bench").mkdir(parents=True, exist_ok=True)
    Path(".drivecal/bench/variants.json").write_text(json.dumps(figures, indent=1))
    sys.exit(any(each["mean"] > 0.01 for each in figures.values()))
