"""Benchmark of what a user would take instead: `python tests/benchmarks/run.py peers`.

The same search space and the same real evaluations on the same machine, one peer after the other: drivecal (reduction off, every result
durable), Optuna with a database (SQLite, two processes), Optuna with a journal file (two processes), Ray Tune, and pymoo's genetic
algorithm with a process pool, which stores nothing. Optuna and Ray Tune draw at random, which costs them least. Each is measured with
trials of one cell (one scenario, about 7 ms) and with trials of all six scenarios; drivecal's unit is always the cell.

Efficiency = cells x single-process cost of a cell / (wall x cores). The cost is that of a sample of the peer's own cells, in one process
on the otherwise idle machine; the wall runs from when every worker has loaded SUMO and compiled its kernels to the last stored result.
"""

import argparse
import json
import logging
import multiprocessing
import os
import random
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing.synchronize import Barrier
from pathlib import Path
from typing import Any

from tests.benchmarks._objective import SCENARIOS, decoded, objective, scenarios_of, space, warm_up
from tests.benchmarks.efficiency import SAMPLE, run_campaign, sample_of, single_process_cost, wait_for_workers

from drivecal.cli.commands.demo import coordinator, fresh_folder

HOME = Path(".drivecal/bench/peers")
TARGET = Path(".drivecal/bench/peers.json")
CORES = os.cpu_count() or 1
AT_LEAST = 0.93
"""drivecal's own efficiency."""
BEHIND_THE_POOL = 0.03
"""By how much it may be less efficient than a process pool that stores nothing."""
AHEAD_OF_STORES = 1.5
"""How many times more efficient it has to be than every peer that stores its results."""

Cells = list[tuple[str, list[float]]]


@dataclass(frozen=True)
class Measured:
    """Of one peer: its trials had `cells_per_trial` cells each."""

    peer: str
    stores: bool
    cells_per_trial: int
    cells: int
    wall_seconds: float
    milliseconds_per_cell: float

    @property
    def efficiency(self) -> float:
        """The part of the machine that simulated."""
        return self.cells * self.milliseconds_per_cell / 1000 / (self.wall_seconds * CORES)


def cells_of(trials: Sequence[tuple[int, Sequence[float]]], cells_per_trial: int) -> Cells:
    """The cells of trials, by number and parameters."""
    return [(scenario, list(values)) for number, values in trials for scenario in scenarios_of(number, cells_per_trial)]


def _optuna_storage(kind: str, folder: str) -> Any:
    import optuna
    from optuna.storages.journal import JournalFileBackend

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    if kind == "database":
        return optuna.storages.RDBStorage(f"sqlite:///{folder}/optuna.db", engine_kwargs={"connect_args": {"timeout": 120}})
    return optuna.storages.JournalStorage(JournalFileBackend(f"{folder}/optuna.log"))


def _optuna_worker(kind: str, folder: str, trials: int, cells_per_trial: int, seed: int, barrier: Barrier) -> None:
    import optuna

    def evaluate(trial: optuna.Trial) -> float:
        indices = {parameter.name: trial.suggest_int(parameter.name, 0, parameter.n_values - 1) for parameter in space()}
        return objective(trial.number, decoded(indices), cells_per_trial)

    warm_up()
    study = optuna.load_study(
        study_name="peer", storage=_optuna_storage(kind, folder), sampler=optuna.samplers.RandomSampler(seed)
    )
    barrier.wait()
    study.optimize(evaluate, n_trials=trials)


def optuna_study(kind: str, trials: int, cells_per_trial: int) -> tuple[float, Cells]:
    """As many processes as cores optimise one study."""
    import optuna

    context = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as folder:
        study = optuna.create_study(study_name="peer", storage=_optuna_storage(kind, folder), direction="maximize")
        barrier = context.Barrier(CORES + 1)
        workers = [
            context.Process(target=_optuna_worker, args=(kind, folder, trials // CORES, cells_per_trial, seed, barrier))
            for seed in range(CORES)
        ]
        for worker in workers:
            worker.start()
        barrier.wait()
        begin = time.perf_counter()
        for worker in workers:
            worker.join()
        wall = time.perf_counter() - begin
        if any(worker.exitcode for worker in workers):
            raise RuntimeError("a process of Optuna's failed")
        done = [(trial.number, decoded(trial.params)) for trial in study.get_trials(deepcopy=False)]
    return wall, cells_of(done, cells_per_trial)


def ray_tune(trials: int, cells_per_trial: int) -> tuple[float, Cells]:
    """Actors are used again from trial to trial, and no trial is checkpointed."""
    import ray
    from ray import tune

    class Evaluation(tune.Trainable):
        def setup(self, config: dict[str, int]) -> None:
            warm_up()
            self.reset_config(config)

        def step(self) -> dict[str, Any]:
            begin = time.time()
            score = objective(self.config["number"], decoded(self.config), cells_per_trial)
            return {"score": score, "began": begin, "ended": time.time(), "done": True}

        def reset_config(self, new_config: dict[str, int]) -> bool:
            self.config = new_config
            return True

        def save_checkpoint(self, _folder: str) -> dict[str, Any]:
            return {}  # it asks for one before it gives an actor to the next trial

        def load_checkpoint(self, _checkpoint: dict[str, Any] | None) -> None:
            pass

    domains: dict[str, Any] = {parameter.name: tune.randint(0, parameter.n_values) for parameter in space()}
    domains["number"] = tune.grid_search(list(range(trials)))
    with tempfile.TemporaryDirectory() as folder:
        ray.init(address="local", num_cpus=CORES, include_dashboard=False, log_to_driver=False, logging_level=logging.ERROR)
        try:
            results = tune.Tuner(
                Evaluation,
                param_space=domains,
                tune_config=tune.TuneConfig(metric="score", mode="max", reuse_actors=True),
                run_config=tune.RunConfig(storage_path=folder, verbose=0),
            ).fit()
        finally:
            ray.shutdown()
    rows: list[dict[str, Any]] = [results[number].metrics or {} for number in range(len(results))]
    wall = max(row["ended"] for row in rows) - min(row["began"] for row in rows)
    return wall, cells_of([(row["config"]["number"], decoded(row["config"])) for row in rows], cells_per_trial)


def pymoo_pool(trials: int, cells_per_trial: int) -> tuple[float, Cells]:
    """A genetic algorithm of 200 individuals over a pool of processes. Nothing is stored."""
    import numpy as np
    from pymoo.algorithms.soo.nonconvex.ga import GA
    from pymoo.core.problem import Problem
    from pymoo.operators.crossover.sbx import SBX
    from pymoo.operators.mutation.pm import PM
    from pymoo.operators.repair.rounding import RoundingRepair
    from pymoo.operators.sampling.rnd import IntegerRandomSampling
    from pymoo.optimize import minimize

    done: list[tuple[int, list[float]]] = []
    names = [parameter.name for parameter in space()]

    class Calibration(Problem):  # type: ignore[misc]  # pymoo ships no types
        def __init__(self) -> None:
            super().__init__(
                n_var=len(names), n_obj=1, xl=0, xu=np.array([parameter.n_values - 1 for parameter in space()]), vtype=int
            )

        def _evaluate(self, rows: Any, out: dict[str, Any], *_: Any, **__: Any) -> None:
            chosen = [(len(done) + place, decoded(dict(zip(names, row, strict=True)))) for place, row in enumerate(rows)]
            done.extend(chosen)
            tasks = [(number, values, cells_per_trial) for number, values in chosen]
            out["F"] = -np.array(pool.starmap(objective, tasks, chunksize=max(1, len(tasks) // (8 * CORES))))

    operators = {"vtype": float, "repair": RoundingRepair()}
    algorithm = GA(
        pop_size=200,
        sampling=IntegerRandomSampling(),
        crossover=SBX(**operators),
        mutation=PM(**operators),
        eliminate_duplicates=True,
    )
    with multiprocessing.get_context("spawn").Pool(CORES, initializer=warm_up) as pool:
        pool.starmap(objective, [(0, decoded(dict.fromkeys(names, 0)), 1)] * CORES, chunksize=1)
        begin = time.perf_counter()
        minimize(Calibration(), algorithm, ("n_eval", trials), seed=1)
        wall = time.perf_counter() - begin
    return wall, cells_of(done, cells_per_trial)


PEERS: Mapping[str, tuple[bool, Callable[[int, int], tuple[float, Cells]]]] = {
    "Optuna, SQLite": (True, partial(optuna_study, "database")),
    "Optuna, journal": (True, partial(optuna_study, "journal")),
    "Ray Tune": (True, ray_tune),
    "pymoo, pool": (False, pymoo_pool),
}
"""By name: whether it stores its results, and how it is run."""


def measured(peer: str, stores: bool, cells_per_trial: int, wall: float, cells: Cells) -> Measured:
    """Measures what the peer's cells cost in one process, now that it is gone."""
    sample = random.Random(1).sample(cells, min(SAMPLE, len(cells)))
    return Measured(peer, stores, cells_per_trial, len(cells), wall, 1000 * single_process_cost(sample))


def drivecal_campaign(sets: int) -> Measured:
    """A campaign of some six iterations, as a user starts it."""
    population = max(50, sets // 3)  # of six iterations, the later ones change part of the population only
    with fresh_folder(HOME), coordinator(HOME) as client:
        wait_for_workers(client)
        campaign = run_campaign(client, population, 6)
        cells = sample_of(client, campaign)
    cost = 1000 * single_process_cost(cells)
    return Measured("drivecal", True, 1, campaign.cells.simulated, campaign.seconds.wall, cost)


def show(rows: Sequence[Measured]) -> None:
    """The table."""
    print(f"{'peer':18}{'cells/trial':>12}{'cells':>9}{'wall, s':>10}{'ms/cell':>9}{'cells/s':>9}{'efficiency':>12}")
    for row in rows:
        print(
            f"{row.peer:18}{row.cells_per_trial:12}{row.cells:9,}{row.wall_seconds:10.1f}{row.milliseconds_per_cell:9.2f}"
            f"{row.cells / row.wall_seconds:9.0f}{row.efficiency:12.3f}"
        )


def good_enough(rows: Sequence[Measured]) -> bool:
    """Returns whether drivecal is as efficient as promised, next to the peers that were measured."""
    ours = next((row.efficiency for row in rows if row.peer == "drivecal"), 0.0)
    pool = max((row.efficiency for row in rows if row.peer != "drivecal" and not row.stores), default=0.0)
    stores = max(
        (row.efficiency for row in rows if row.peer != "drivecal" and row.stores and row.cells_per_trial == 1), default=0.0
    )
    print(
        f"drivecal {ours:.3f}: at least {AT_LEAST}, {pool - BEHIND_THE_POOL:.3f} and {AHEAD_OF_STORES * stores:.3f} are wanted"
    )
    return ours >= max(AT_LEAST, pool - BEHIND_THE_POOL, AHEAD_OF_STORES * stores)


def main() -> int:
    """Measures, prints, writes; 0 where drivecal is as efficient as promised."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=900, help="parameter sets that each peer evaluates; drivecal some more")
    parser.add_argument("--only", nargs="*", choices=["drivecal", *PEERS], help="measure these alone")
    chosen = parser.parse_args()
    warnings.filterwarnings("ignore")
    logging.disable(logging.WARNING)
    rows: list[Measured] = []
    for peer, (stores, run) in PEERS.items():
        for cells_per_trial in (1, len(SCENARIOS)):
            if chosen.only is None or peer in chosen.only:
                trials = chosen.sets * len(SCENARIOS) // cells_per_trial
                rows.append(measured(peer, stores, cells_per_trial, *run(trials, cells_per_trial)))
                show(rows[-1:])
    if chosen.only is None or "drivecal" in chosen.only:
        rows.append(drivecal_campaign(chosen.sets))
    print()
    show(rows)
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    figures = [{**asdict(row), "efficiency": row.efficiency} for row in rows]
    TARGET.write_text(json.dumps({"cores": CORES, "sets": chosen.sets, "peers": figures}, indent=2) + "\n")
    return 0 if good_enough(rows) else 1


if __name__ == "__main__":
    sys.exit(main())
