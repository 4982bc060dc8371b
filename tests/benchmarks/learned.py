"""What the learned parts cost and change: `python tests/benchmarks/run.py learned [--population N] [--iterations N] [--rounds N]`.

First the demo's campaign on the expert map, without predictions, as it is and with both learned parts, one after the other on the same
coordinator, in turn; of each the fastest counts. Nothing that one has simulated serves the other, for their vehicles differ. Then single
evaluations with the hybrid vehicle and with the learned evaluator beside the plain ones, each the fastest of several rounds, and how far
the scores move on the same sets.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from importlib.resources import as_file, files
from itertools import product
from pathlib import Path
from time import thread_time
from typing import Any

import numpy as np
from scipy.stats import qmc

from drivecal.cli.commands.demo.command import CAMPAIGN
from drivecal.cli.commands.demo.coordinator import coordinator, fresh_folder
from drivecal.client.client import Client
from drivecal.client.documents import read_document
from drivecal.contracts.campaign import Campaign
from drivecal.highway.comfort.learned import LEARNED
from drivecal.highway.comfort.reference import REFERENCE
from drivecal.highway.episode.runner import EpisodeRunner
from drivecal.highway.planner.frenet import FRENET
from drivecal.highway.scenarios.highway import HIGHWAY
from drivecal.highway.vehicle.hybrid import HYBRID
from drivecal.highway.vehicle.single_track import SINGLE_TRACK

HOME = Path(".drivecal/bench/learned")
TARGET = Path(".drivecal/bench/learned.json")
AT_MOST = 1.5
"""Times the plain campaign, and times the plain evaluation summed over the scenarios, with both learned parts."""
PARTS: dict[str, dict[str, Any]] = {"plain": {}, "both": {"vehicle": {"model": "hybrid"}, "evaluator": "learned"}}
MAPPED: dict[str, Any] = {"reduction": {"mode": "influence", "max_error": 1}}
ROUNDS = 8
TIMED, SETS = 4, 24


def carried_out(client: Client, specification: dict[str, Any]) -> Campaign:
    """A campaign from its start to its end."""
    campaign = client.submit(specification)
    while campaign.state not in {"succeeded", "failed", "cancelled"}:
        time.sleep(0.5)
        campaign = client.campaign(campaign.id)
    if campaign.state != "succeeded":
        raise RuntimeError(f"the campaign ended as {campaign.state}: {campaign.error}")
    return campaign


def campaigns(population: int, iterations: int, rounds: int) -> dict[str, Campaign]:
    """The fastest of each kind, on databases that were empty."""
    optimizer = CAMPAIGN["optimizer"] | {"population": population, "iterations": iterations}
    found: dict[str, list[Campaign]] = {name: [] for name in PARTS}
    for _ in range(rounds):
        with fresh_folder(HOME), coordinator(HOME) as client:
            while not (workers := client.workers().items) or any(worker.state != "idle" for worker in workers):
                time.sleep(0.2)
            with as_file(files("drivecal.cli.commands.demo") / "expert_map.yaml") as file:
                known = client.post_influence_map(read_document(str(file)))
            for parts in PARTS.values():  # what a worker has to load and compile first is not measured
                warm = {"name": "warm", "sensitivity": None, "optimizer": {"kind": "random", "population": 12, "iterations": 1}}
                carried_out(client, warm | parts)
            for name, parts in PARTS.items():
                found[name].append(
                    carried_out(
                        client, {**CAMPAIGN, **MAPPED, "optimizer": optimizer, "sensitivity": {"map": known.id}, **parts}
                    )
                )
    return {name: min(listed, key=lambda one: one.seconds.wall) for name, listed in found.items()}


def compare_campaigns(population: int, iterations: int, rounds: int) -> dict[str, float]:
    """Prints the table of both campaigns; the figures."""
    found = campaigns(population, iterations, rounds)
    print(f"{'campaign':18}{'wall s':>12}{'worker s':>12}{'requested':>12}{'simulated':>12}{'certified':>12}{'best':>10}")
    for name, one in found.items():
        cells, best = one.cells, "-" if one.best is None else f"{one.best.objective:.3f}"
        seconds = f"{one.seconds.wall:12.1f}{one.seconds.simulating:12.1f}"
        print(f"{name:18}{seconds}{cells.requested:12,}{cells.simulated:12,}{cells.certified:12,}{best:>10}")
    wall = {name: one.seconds.wall for name, one in found.items()}
    each = {name: one.seconds.simulating / one.cells.simulated for name, one in found.items()}
    ratios = {"wall": wall["both"] / wall["plain"], "per_simulated_cell": each["both"] / each["plain"]}
    print(
        f"both take {ratios['wall']:.3f} times as long (at most {AT_MOST}), {ratios['per_simulated_cell']:.3f} per simulated cell\n"
    )
    return wall | ratios


def main() -> int:
    """Prints the tables, writes the figures; 1 where a campaign or an evaluation with both takes more than `AT_MOST` times a plain one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--population", type=int, default=CAMPAIGN["optimizer"]["population"])
    parser.add_argument("--iterations", type=int, default=CAMPAIGN["optimizer"]["iterations"])
    parser.add_argument("--rounds", type=int, default=2)
    chosen = parser.parse_args()
    compared = compare_campaigns(chosen.population, chosen.iterations, chosen.rounds)
    space = FRENET.spaces["highway"]
    unit = qmc.LatinHypercube(len(space), seed=1).random(SETS)
    sets = [[float(one.value(round(u * (one.n_values - 1)))) for u, one in zip(row, space, strict=True)] for row in unit]
    kinds = list(product((SINGLE_TRACK, HYBRID), (REFERENCE, LEARNED)))
    names = [f"{vehicle.name}, {evaluator.name}" for vehicle, evaluator in kinds]
    nominal = {parameter.name: parameter.nominal for parameter in SINGLE_TRACK.parameters}
    milliseconds, apart, outside = np.zeros((len(HIGHWAY.scenarios), len(kinds))), {}, {}
    for row, (name, scenario) in enumerate(HIGHWAY.scenarios.items()):
        runners = [EpisodeRunner(scenario, FRENET, vehicle.create(nominal), evaluator) for vehicle, evaluator in kinds]
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
        "campaigns": compared,
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
    return int(ratios[-1] > AT_MOST or compared["wall"] > AT_MOST)


if __name__ == "__main__":
    sys.exit(main())
