"""Use of a cluster that this machine does not have: `python tests/benchmarks/run.py scale [--workers N]`.

The real dispatcher and database serve pretended workers that take the paper's 10 s for an evaluation. Time is the machine's own while the
dispatcher works and jumps while it waits: its cost counts in full, and a quarter of an hour takes seconds.
"""

import argparse
import heapq
import json
import random
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from tests.support.computed import computed
from tests.support.postgres import create_database, running_postgres

from drivecal.contracts.specification import CampaignSpecification
from drivecal.contracts.work import Batch, BatchResult
from drivecal.dispatch.dispatcher import Dispatcher
from drivecal.execution.backend import Finished, Lost, Slot, WorkerInfo
from drivecal.execution.pool import StoredLeases, WorkPool
from drivecal.storage import campaigns
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database

TARGET = Path(".drivecal/bench/scale.json")
BACKENDS = ("sqlite", "postgresql")
PAPER_SECONDS = 10.0
BUSY_AT_LEAST = 0.95
TOGETHER = "four campaigns"


@dataclass
class PretendedTime:
    """Goes by itself, and jumps."""

    skipped: float = 0.0

    def __call__(self) -> float:
        return time.monotonic() + self.skipped


@dataclass
class PretendedWorkers:
    """`count` workers of a cluster: one evaluation takes `seconds`, give or take a fifth, and has a formula's result."""

    count: int
    seconds: float
    now: PretendedTime
    busy_seconds: float = 0.0
    _queues: list[deque[tuple[int, Batch]]] = field(init=False)
    _told: list[WorkerInfo] = field(init=False)
    _ends: list[tuple[float, int, float]] = field(default_factory=list)
    """When a worker ends what it does, which, and when it began."""

    def __post_init__(self) -> None:
        self._queues = [deque() for _ in range(self.count)]
        self._told = [WorkerInfo(str(place), "pretended", None, "idle", 0) for place in range(self.count)]
        self._random = random.Random(1)

    def submit(self, worker: str, batch_id: int, batch: Batch, expected_seconds: float | None, *, alone: bool = False) -> None:
        """Begins at once, or behind the batch that runs."""
        del expected_seconds, alone
        place = int(worker)
        self._queues[place].append((batch_id, batch))
        if len(self._queues[place]) == 1:
            self._begin(place, self.now())

    def wait(self, timeout: float) -> list[Finished | Lost]:
        """Jumps to the next result."""
        if not self._ends:
            self.now.skipped += timeout
            return []
        ahead = self._ends[0][0] - self.now()
        if ahead > 0:
            self.now.skipped += min(ahead, timeout)
        found: list[Finished | Lost] = []
        while self._ends and self._ends[0][0] <= self.now():
            found.append(self._end(*heapq.heappop(self._ends)))
        return found

    def slots(self) -> list[Slot]:
        """Every worker has room for one batch behind the one that runs."""
        idle = [Slot(str(place), idle=True) for place, queue in enumerate(self._queues) if not queue]
        return idle + [Slot(str(place), idle=False) for place, queue in enumerate(self._queues) if len(queue) == 1]

    def workers(self) -> list[WorkerInfo]:
        """All of them."""
        return list(self._told)

    def replace(self, worker: str, fault: str | None) -> None:
        """Nothing breaks here."""
        raise AssertionError(f"{worker} was to be replaced: {fault}")

    def trouble(self) -> str | None:
        """Never any."""
        return None

    def close(self) -> None:
        """Nothing to end."""

    def _begin(self, place: int, when: float) -> None:
        batch = self._queues[place][0][1]
        self._told[place] = replace(self._told[place], state="busy")
        seconds = sum(self.seconds * self._random.uniform(0.8, 1.2) for _ in batch.cells)
        heapq.heappush(self._ends, (when + seconds, place, when))

    def _end(self, when: float, place: int, begun: float) -> Finished:
        batch_id, batch = self._queues[place].popleft()
        self.busy_seconds += when - begun
        self._told[place] = replace(self._told[place], state="idle", cells=self._told[place].cells + len(batch.cells))
        if self._queues[place]:
            self._begin(place, when)
        results = tuple(computed(batch.setup.scenario, cell) for cell in batch.cells)
        return Finished(batch_id, BatchResult(str(place), results, when - begun))


def submit(database: Database, population: int, iterations: int, seed: int) -> StoredCampaign:
    """Queues a campaign on S1..S6 without analysis and map."""
    specification = CampaignSpecification.model_validate(
        {
            "name": f"scale {seed}",
            "sensitivity": None,
            "optimizer": {"kind": "genetic", "population": population, "iterations": iterations, "seed": seed},
            "reduction": {"mode": "exact"},
        }
    )
    with database.transaction() as connection:
        return campaigns.insert(connection, name=specification.name, spec=specification.model_dump(mode="json"))


def carry_out(database: Database, submitted: Sequence[StoredCampaign], workers: PretendedWorkers) -> tuple[float, float, int]:
    """All campaigns at once, to their end: pretended seconds, seconds of the dispatcher, cells."""
    pool = WorkPool(workers, StoredLeases(database), clock=workers.now)
    dispatcher = Dispatcher(database, pool, clock=workers.now)
    begun, processor, step = workers.now(), time.perf_counter(), 0
    while True:
        dispatcher.step()
        step += 1
        if step % 20 == 0 or not workers._ends:
            with database.read() as connection:
                found = [campaigns.get(connection, campaign.id) for campaign in submitted]
            if all(one.state.ended for one in found):
                break
    if any(one.state != "succeeded" for one in found):
        raise RuntimeError(f"a campaign ended as {[one.error for one in found]}")
    return workers.now() - begun, time.perf_counter() - processor, sum(one.cells.simulated for one in found)


def cluster(backend: str, count: int) -> dict[str, Any]:
    """Returns whether `count` workers are kept busy, by one campaign of the paper's size and by four at a time; two iterations each."""
    rows: dict[str, Any] = {}
    for name, campaigns_at_once in (("one campaign", 1), (TOGETHER, 4)):
        with new(backend) as database:
            workers = PretendedWorkers(count, PAPER_SECONDS, PretendedTime())
            submitted = [submit(database, 1_000, 2, seed) for seed in range(campaigns_at_once)]
            pretended, real, done = carry_out(database, submitted, workers)
        rows[name] = {
            "cells": done,
            "pretended_seconds": pretended,
            "dispatcher_seconds": real,
            "busy": workers.busy_seconds / (count * pretended),
        }
    return rows


@contextmanager
def new(backend: str) -> Iterator[Database]:
    """Yields an empty database."""
    with ExitStack() as stack:
        if backend == "sqlite":
            url = f"sqlite:///{stack.enter_context(tempfile.TemporaryDirectory(prefix='drivecal-scale-'))}/drivecal.db"
        else:
            url = create_database(stack.enter_context(running_postgres()), "scale")
        database = Database.open(url)
        stack.callback(database.dispose)
        database.upgrade()
        yield database


def main() -> int:
    """Measures, prints, writes; returns 0 if the workers are kept busy."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--workers", type=int, default=1000)
    parser.add_argument("--backends", nargs="+", choices=BACKENDS, default=BACKENDS)
    chosen = parser.parse_args()
    figures: dict[str, Any] = {"workers": chosen.workers, "cluster": {}}
    good = True
    for backend in chosen.backends:
        rows = figures["cluster"][backend] = cluster(backend, chosen.workers)
        for name, row in rows.items():
            print(
                f"{backend}: {chosen.workers:,} workers of {PAPER_SECONDS:.0f} s, {name}: {row['cells']:,} cells in"
                f" {row['pretended_seconds']:.0f} pretended s, busy {row['busy']:.3f}, dispatcher {row['dispatcher_seconds']:.1f} s"
            )
        good &= rows[TOGETHER]["busy"] >= BUSY_AT_LEAST
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text(json.dumps(figures, indent=2) + "\n")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
