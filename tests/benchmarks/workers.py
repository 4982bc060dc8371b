"""Throughput by number of workers, next to the ideal: `python tests/benchmarks/run.py workers [--workers 1 2 4] [--compose]`.

The same campaign, reduction off and without certificates, on a new coordinator with each number of workers. Ideal is what so many
processes would simulate that do nothing else, at the cost of a cell in one process alone; they share the machine's cores, where the paper's
four machines had some each. With `--compose` each worker is a node of the cluster in containers, which needs a Docker engine.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.benchmarks.efficiency import run_campaign, sample_of, single_process_cost, wait_for_workers
from tests.support.compose import Cluster, cluster_on_engine, engine

from drivecal.cli.commands.demo.coordinator import coordinator, fresh_folder
from drivecal.client.client import Client

HOME = Path(".drivecal/bench/workers")
TARGET = Path(".drivecal/bench/workers.json")
AT_LEAST = 0.85
"""Of the ideal, where each worker has a core and another one is left for the coordinator."""


@contextmanager
def embedded(workers: int) -> Iterator[Client]:
    """`drivecal serve` with so many workers, all of them ready."""
    os.environ["DRIVECAL_WORKERS"] = str(workers)
    with fresh_folder(HOME), coordinator(HOME) as client:
        wait_for_workers(client)
        yield client


@contextmanager
def nodes(cluster: Cluster, workers: int) -> Iterator[Client]:
    """The cluster in containers with so many nodes of one worker each, all of them ready."""
    cluster.compose("up", "-d", "--no-recreate", "--scale", f"ray-worker={workers}")
    with Client(cluster.url, token=cluster.token) as client:
        cluster.until(lambda: len(cluster.workers()) == len(cluster.ready_nodes()) == workers, f"{workers} nodes")
        yield client


def main() -> int:
    """Measures, prints, writes; 0 where workers with a core of their own came near the ideal."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--population", type=int, default=500)
    parser.add_argument("--iterations", type=int, default=6)
    parser.add_argument("--compose", action="store_true", help="nodes in containers in place of workers of one coordinator")
    chosen = parser.parse_args()
    if not chosen.compose:
        return measure(chosen, None)
    if engine() is None:
        print("there is no Docker engine with Compose 2: start one, or name one by DOCKER_HOST", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as folder, cluster_on_engine(Path(folder)) as cluster:
        return measure(chosen, cluster)


def measure(chosen: argparse.Namespace, cluster: Cluster | None) -> int:
    """With each number of workers."""
    cores = os.cpu_count() or 1
    rates: dict[int, float] = {}
    cost = 0.0
    for workers in chosen.workers:
        with embedded(workers) if cluster is None else nodes(cluster, workers) as client:
            campaign = run_campaign(client, chosen.population, chosen.iterations)
            sample = sample_of(client, campaign)
        rates[workers] = campaign.cells.simulated / campaign.seconds.wall
        cost = cost or single_process_cost(sample)  # of the same cells each time
    ideal = {workers: min(workers, cores) / cost for workers in rates}
    print(f"{campaign.cells.simulated:,} cells, {1000 * cost:.2f} ms each in one process alone, {cores} cores")
    kind = "workers" if cluster is None else "nodes"
    print(f"{kind:>8} {'cells/s':>8} {'ideal':>8} {'share':>6}")
    for workers, rate in rates.items():
        print(f"{workers:8} {rate:8.0f} {ideal[workers]:8.0f} {rate / ideal[workers]:6.2f}")
    figures = {
        "cores": cores,
        "compose": cluster is not None,
        "simulated": campaign.cells.simulated,
        "single_process_milliseconds_per_cell": 1000 * cost,
        "cells_per_second": rates,
        "ideal_cells_per_second": ideal,
    }
    target = TARGET if cluster is None else TARGET.with_stem("workers_compose")
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(json.dumps(figures, indent=2) + "\n")
    return 0 if all(rate >= AT_LEAST * ideal[workers] for workers, rate in rates.items() if workers < cores) else 1


if __name__ == "__main__":
    sys.exit(main())
