"""How many cells have certificates, by the number of workers: `python tests/benchmarks/run.py certificates [--population N] [...]`.

The paper's genetic search on six scenarios, for each number of workers and each way to use what workers know:

- `off`: a setup belongs to the first worker that took it, and the setups of a generation are submitted one by one (the rule before);
- `sticky`: workers return to the setups that they have run most of, and the setups of a generation are submitted together;
- `shared`: workers of one setup get each other's recorded runs, too.

Pool, workers and certificates are real. The workers live in this process and take turns on virtual time (`RUN`, `WALK`, ... seconds), so
that figures do not depend on this machine, and no set is simulated twice. All searches must find the same scores.
"""

from __future__ import annotations

import argparse
import heapq
import itertools
import json
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from drivecal.contracts.work import Batch, Cell, DriveRequest, SetupKey
from drivecal.domain.evaluations import RunResult
from drivecal.execution.backend import Finished, Lost, Slot, WorkerInfo
from drivecal.execution.pool import WorkPool
from drivecal.execution.scheduling import scheduler
from drivecal.execution.scheduling.affinity import SetupAffinity
from drivecal.execution.scheduling.in_flight import Work
from drivecal.plugins import registry
from drivecal.plugins.setups import setup_of
from drivecal.runtime.runners import make_runner
from drivecal.runtime.worker import Worker

TARGET = Path(".drivecal/bench/certificates.json")
MEGABYTES = 256
"""Memory of a pretended worker for certificates."""
RUN, WALK, LEARN, LOAD, CALL = 7e-3, 0.7e-3, 0.1e-3, 4e-3, 1e-3
"""Seconds of a simulation, of an answer by a certificate, of a run of another worker, of another scenario than before, and of a batch
besides its cells."""
MODES = ("off", "sticky", "shared")


@dataclass(slots=True)
class Pretended:
    """A worker of this process."""

    worker: Worker
    name: str
    queue: deque[tuple[int, Batch]] = field(default_factory=deque)
    scenario: str = ""
    running: Finished | None = None


@dataclass(slots=True)
class Tally:
    """Counts of a search."""

    mode: str
    workers: int
    cells: int = 0
    certified: int = 0
    batches: int = 0
    moved: int = 0
    """Batches of another scenario than the worker's last."""
    learned: int = 0
    """Runs that workers got from others."""
    megabytes: float = 0.0
    """Planning states from and to workers."""
    seconds: float = 0.0
    """Virtual."""


RECORDED = ("_parameters", "_states", "_decisions", "_infeasible")
"""What a `RecordingPlanner` notes of a run."""
Runs = dict[tuple[str, tuple[float, ...]], tuple[RunResult, Mapping[str, Any]]]
"""Simulated runs of this process, with what was recorded of them."""


def replayed(
    runs: Runs, scenario: str, simulate: Callable[..., RunResult], parameters: Sequence[float], planner: Any
) -> RunResult:
    """Implements `EpisodeRunner.run`, but simulates no set of a scenario twice in this process."""
    place = scenario, tuple(parameters)
    if place not in runs:
        runs[place] = simulate(parameters, planner), {name: getattr(planner, name) for name in RECORDED}
    result, recorded = runs[place]
    for name, value in recorded.items():
        setattr(planner, name, value)
    return result


class FirstHome(SetupAffinity):
    """The rule before: a setup belongs to the worker that was the first to take it, and to no other worker."""

    def __init__(self) -> None:
        super().__init__()
        self._home: dict[SetupKey, str] = {}

    def load(self, worker: str, setup: SetupKey, cells: int = 1) -> None:
        super().load(worker, setup, cells)
        self._home.setdefault(setup, worker)

    def choose(self, worker: str, to_do: Mapping[SetupKey, float]) -> SetupKey | None:
        last = self._last.get(worker)
        if last is not None and last in to_do and (self._workers[last] == 1 or all(self._workers[setup] for setup in to_do)):
            return last
        own = [setup for setup in to_do if self._home.get(setup, worker) == worker]
        return max(own or to_do, key=lambda setup: to_do[setup] / (self._workers[setup] or 1e-9), default=None)


class PretendedBackend:
    """Workers that take turns, and answer on virtual time."""

    def __init__(self, mode: str, workers: int, runs: Runs) -> None:
        """Creates idle workers. `runs`: what was simulated before, and is simulated from now on."""
        self._runs, self._sharing = runs, mode == "shared"
        names = [f"worker-{number}" for number in range(1, workers + 1)]
        self._workers = [Pretended(self._worker(name), name) for name in names]
        self._events: list[tuple[float, int, int]] = []
        self.tally = Tally(mode, workers)

    def _worker(self, name: str) -> Worker:
        session = registry.simulator("highway").open(MEGABYTES)

        def make(request: DriveRequest) -> Any:
            runner: Any = make_runner(request, session)
            runner.run = partial(replayed, self._runs, request.scenario, runner.run)
            return runner

        return Worker(name, make)

    def submit(self, worker: str, batch_id: int, batch: Batch, expected_seconds: float | None, *, alone: bool = False) -> None:
        del expected_seconds, alone
        if not self._sharing:
            batch = replace(batch, known=(), share=0)
        place = next(place for place, pretended in enumerate(self._workers) if pretended.name == worker)
        self._workers[place].queue.append((batch_id, batch))
        if self._workers[place].running is None:
            self._begin(place)

    def wait(self, timeout: float) -> list[Finished | Lost]:
        del timeout
        if not self._events:
            return []
        self.tally.seconds, _, place = heapq.heappop(self._events)
        pretended = self._workers[place]
        finished, pretended.running = pretended.running, None
        if pretended.queue:
            self._begin(place)
        return [] if finished is None else [finished]

    def slots(self) -> list[Slot]:
        slots = [
            Slot(pretended.name, pretended.running is None) for pretended in self._workers if len(pretended.queue) < 1
        ]  # one waits behind the running batch
        return sorted(slots, key=lambda slot: not slot.idle)

    def workers(self) -> list[WorkerInfo]:
        return [WorkerInfo(pretended.name, "here", None, "idle", 0) for pretended in self._workers]

    def replace(self, worker: str, fault: str | None) -> None:
        raise RuntimeError(f"{worker}: {fault}")

    def trouble(self) -> str | None:
        return None

    def close(self) -> None:
        self._workers.clear()

    def _begin(self, place: int) -> None:
        pretended, tally = self._workers[place], self.tally
        batch_id, batch = pretended.queue.popleft()
        result = pretended.worker.run(batch)
        certified = sum(answer.proven_by is not None for answer in result.results)
        moved = batch.setup.scenario != pretended.scenario
        seconds = CALL + LOAD * moved + WALK * certified + RUN * (len(result.results) - certified) + LEARN * len(batch.known)
        pretended.scenario = batch.setup.scenario
        pretended.running = Finished(batch_id, replace(result, seconds=seconds))
        heapq.heappush(self._events, (tally.seconds + seconds, batch_id, place))
        tally.cells += len(result.results)
        tally.certified += certified
        tally.batches += 1
        tally.moved += moved
        tally.learned += len(batch.known)
        tally.megabytes += sum(len(run.states) for run in (*batch.known, *result.learned)) / 1e6


def requests() -> dict[str, DriveRequest]:
    """The setups of the built-in scenarios."""
    catalogue, function = registry.catalogue("highway"), registry.driving_function("frenet")
    vehicle = registry.vehicle("single_track")
    setups = {name: setup_of(scenario, function, vehicle, {}) for name, scenario in catalogue.scenarios.items()}
    return {
        name: DriveRequest(
            catalogue.name, name, function.name, vehicle.name, setup.vehicle_parameters, "reference", setup.fingerprint
        )
        for name, setup in setups.items()
    }


Scores = dict[tuple[str, tuple[int, ...]], tuple[float, float]]
"""Score and rating by scenario and grid indices."""


def search(backend: PretendedBackend, population: int, iterations: int, seed: int) -> Scores:
    """Runs the genetic search and returns the scores of all its sets."""
    plugin, space = registry.optimizer("genetic"), next(iter(registry.driving_function("frenet").spaces.values()))
    settings = plugin.settings.model_validate(
        {"kind": "genetic", "population": population, "iterations": iterations, "seed": seed}
    )
    optimizer = plugin.create(settings, np.array([parameter.n_values for parameter in space]))
    setups, known = requests(), Scores()
    off = backend.tally.mode == "off"
    with patch.object(scheduler, "SetupAffinity", FirstHome if off else SetupAffinity):
        pool = WorkPool(backend)
    for _ in range(iterations):
        individuals = [tuple(row) for row in optimizer.ask().population.tolist()]
        asked = {
            scenario: [indices for indices in dict.fromkeys(individuals) if (scenario, indices) not in known]
            for scenario in setups
        }
        known |= simulated(pool, setups, asked, len(known), together=not off)
        scores, ratings = (
            np.array([sum(known[scenario, indices][part] for scenario in setups) / len(setups) for indices in individuals])
            for part in (0, 1)
        )
        optimizer.tell(scores, ratings)
    return known


def simulated(
    pool: WorkPool,
    setups: Mapping[str, DriveRequest],
    asked: Mapping[str, Sequence[tuple[int, ...]]],
    first: int,
    *,
    together: bool,
) -> Scores:
    """Returns the results of a generation's new cells."""
    space = next(iter(registry.driving_function("frenet").spaces.values()))
    cells: dict[int, tuple[str, tuple[int, ...]]] = {}
    works = []
    for scenario, sets in asked.items():
        listed = []
        for indices in sets:
            values = {parameter.name: float(parameter.value(index)) for parameter, index in zip(space, indices, strict=True)}
            number = first + len(cells) + 1
            cells[number] = scenario, indices
            listed.append(Cell(number, values, certify=True))
        if listed:
            works.append(Work(setups[scenario], listed))
    for part in [works] if together else [[work] for work in works]:
        pool.submit(*part, tag="search")
    scores: Scores = {}
    while pool.held("search"):
        for completed in pool.poll(1.0):
            result = completed.result
            if result.score is None or result.rating is None:
                raise RuntimeError(f"cell {result.id} has no result: {result.detail}")
            scores[cells[result.id]] = result.score, result.rating
    return scores


def table(tallies: Sequence[Tally]) -> Iterator[str]:
    """Yields a line per mode and number of workers."""
    yield f"{'':>8}{'workers':>8}{'cells':>8}{'certified':>11}{'batches':>9}{'moved':>7}{'learned':>9}{'MB':>7}{'seconds':>9}"
    for row in tallies:
        yield (
            f"{row.mode:>8}{row.workers:>8}{row.cells:>8,}{row.certified / row.cells:>11.1%}{row.batches:>9,}{row.moved:>7,}"
            f"{row.learned:>9,}{row.megabytes:>7.0f}{row.seconds:>9.2f}"
        )


def main(arguments: Sequence[str]) -> int:
    """Prints the table; 1 if a search found other scores."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--population", type=int, default=100)
    parser.add_argument("--iterations", type=int, default=8)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2, 8, 32])
    parser.add_argument("--modes", choices=MODES, nargs="+", default=MODES)
    given = parser.parse_args(arguments)
    runs: Runs = {}
    tallies, scores = [], []
    for mode, workers in itertools.product(given.modes, given.workers):
        began = time.perf_counter()
        backend = PretendedBackend(mode, workers, runs)
        scores.append(search(backend, given.population, given.iterations, given.seed))
        tallies.append(backend.tally)
        print(f"{mode}, {workers} workers: {time.perf_counter() - began:.1f} s", file=sys.stderr)
    print("\n".join(table(tallies)))
    same = all(other == scores[0] for other in scores)
    print("the searches found", "the same scores" if same else "DIFFERENT SCORES")
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text(json.dumps({"settings": vars(given), "rows": [asdict(row) for row in tallies]}, indent=1))
    return int(not same)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
