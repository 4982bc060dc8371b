"""A worker, which runs batches of cells in sequence and turns every error of a cell into plain data."""

import logging
import math
import os
import socket
import time
import traceback
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from drivecal.contracts.work import (
    Batch,
    BatchResult,
    BundleRequest,
    Cell,
    CellResult,
    DriveRequest,
    Probe,
    RecordedRun,
)
from drivecal.domain.errors import DrivecalError, UnavailableError
from drivecal.domain.evaluations import Breakdown
from drivecal.domain.scales import plain
from drivecal.plugins import registry
from drivecal.plugins.runners import Runner
from drivecal.plugins.simulators import UnsuitableError
from drivecal.runtime.bundles import BundleSessions
from drivecal.runtime.cache import BundleCache, cache_folder
from drivecal.runtime.compilation import prepare_cache
from drivecal.runtime.results import compressed, milliseconds_since
from drivecal.runtime.runners import RefusedError, make_runner
from drivecal.runtime.tools import OtherToolsError

log = logging.getLogger(__name__)

MOST_RUNNERS = 32
"""Size of the least-recently-used cache of runners. Studies of vehicle parameters use hundreds of setups."""
LONGEST_DETAIL = 500
"""Largest length of an error description in characters."""


@dataclass(frozen=True, slots=True)
class WorkerFacts:
    """Node and process of a worker."""

    node: str
    pid: int


class Worker:
    """Runs batches in its own process (a Ray actor), because a process can hold only one SUMO simulation."""

    def __init__(
        self,
        name: str,
        make: Callable[[DriveRequest], Runner] | None = None,
        certificates_mb: int | None = None,
        bundles: BundleSessions | None = None,
    ) -> None:
        """Creates a worker.

        `make`: creates runners of driving functions, by default from the registry; `certificates_mb`: memory limit of certificates;
        `bundles`: runs problem bundles, by default with the adapters.
        """
        self._name = name
        self._drives = registry.simulator("highway").open(certificates_mb)
        self._make = make or partial(make_runner, session=self._drives)
        self._bundles = bundles or BundleSessions(BundleCache(cache_folder()))
        self._runners: OrderedDict[tuple[object, ...], Runner] = OrderedDict()
        self._interrupted: set[tuple[object, ...]] = set()
        """Setups whose runner an exception interrupted."""

    def warm(self, trial: Batch) -> WorkerFacts:
        """Simulates `trial`, which loads and compiles everything for the first batch and tests this worker.

        Raises UnavailableError naming the reason if the trial fails.
        """
        prepare_cache()
        result = self.run(trial)
        for reason in (result.refusal, *(cell.detail for cell in result.results)):
            if reason is not None:
                raise UnavailableError(reason)
        return WorkerFacts(socket.gethostname(), os.getpid())

    def store(self, digest: str, archive: bytes) -> None:
        """Unpacks a problem bundle for the batches that need it. If that fails, these batches are refused with the reason."""
        try:
            self._bundles.store(digest, archive)
        except (DrivecalError, OSError) as error:
            log.warning("the bundle %s cannot be unpacked: %s", digest, error)

    def run(self, batch: Batch) -> BatchResult:
        """Simulates all cells. If this worker cannot run the setup, or its simulator no longer starts, simulates no further one and
        returns a `refusal`.

        Exceptions of a cell or a plug-in do not propagate: the cell's result has a `breakdown` instead.
        """
        start = time.perf_counter()
        results: list[CellResult] = []
        refusal = tools = None
        unsuitable = False
        try:
            if isinstance(batch.setup, BundleRequest) and not batch.cells:
                tools = self._bundles.probe(batch.setup)
            for result in self._run_all(batch):  # what an exception ends keeps its results
                results.append(result)  # noqa: PERF402  # not promised of `extend`
        except OtherToolsError as error:
            refusal, tools = describe(error), error.answer
        except (RefusedError, UnavailableError) as error:
            refusal, unsuitable = describe(error), isinstance(error, UnsuitableError)
        runner = self._runners.get(batch.setup.key) if batch.share else None
        learned = () if runner is None else runner.recorded(batch.share)
        seconds = time.perf_counter() - start
        return BatchResult(
            self._name, tuple(results), seconds, refusal, self._drives.remembered, learned, tools, unsuitable=unsuitable
        )

    def _run_all(self, batch: Batch) -> Iterator[CellResult]:
        setup = batch.setup
        if isinstance(setup, DriveRequest):
            if batch.share:
                self._learn(setup, batch.known)
            yield from (self._run_cell(setup, cell) for cell in batch.cells)
        else:
            yield from (self._bundles.run(setup, cell) for cell in batch.cells)

    def _learn(self, setup: DriveRequest, known: Sequence[RecordedRun]) -> None:
        """Records the runs of other workers. An exception does not propagate: the cells report it if it concerns them."""
        try:
            self._runner(setup).learn(known)
        except RefusedError:
            raise
        except (Exception, SystemExit):  # noqa: BLE001  # a plug-in may raise any exception; the worker must survive
            self._interrupt(setup)

    def _run_cell(self, setup: DriveRequest, cell: Cell) -> CellResult:
        start = time.thread_time_ns()
        try:
            runner = self._runner(setup)
            parameters = [cell.parameters[name] for name in runner.parameters]
            if cell.trace:
                return _traced(cell, runner.trace(parameters).to_json(), start)
            result = runner.answer(parameters, cell.id, check=cell.check) if cell.certify else runner.run(parameters)
            rating = _finite("the rating", result.rating.rating)
            metrics = {name: _finite(name, value) for name, value in result.metrics.items()}
            failure = result.failure.value if result.failure else None
            certifying = result.certifying
            probed: tuple[tuple[int, int], ...] = ()
            if cell.probes:
                probing = time.thread_time_ns()
                probed = _probed(runner, cell.probes)
                certifying += milliseconds_since(probing)
            return CellResult(
                id=cell.id,
                rating=rating,
                score=plain(_finite("the score", result.rating.score)),
                metrics=metrics,
                failure=failure,
                milliseconds=milliseconds_since(start),
                proven_by=result.proven_by,
                agrees=result.agrees,
                probed=probed,
                certifying=certifying,
            )
        except RefusedError:
            raise
        except MemoryError as error:
            return self._broken(setup, cell, Breakdown.MEMORY, error, start)
        except (Exception, SystemExit) as error:  # noqa: BLE001  # a plug-in may raise any exception; the worker must survive
            return self._broken(setup, cell, Breakdown.ERROR, error, start)

    def _runner(self, setup: DriveRequest) -> Runner:
        key = setup.key
        if key not in self._runners or key in self._interrupted:
            runner = self._make(setup)
            if key in self._interrupted:
                runner.take_over(self._runners[key])
                self._interrupted.remove(key)
            self._runners[key] = runner
            if len(self._runners) > MOST_RUNNERS:
                self._interrupted.discard(self._runners.popitem(last=False)[0])
        self._runners.move_to_end(key)
        return self._runners[key]

    def _interrupt(self, setup: DriveRequest) -> None:
        """Notes that an exception interrupted a runner, which may be in any state: the next cell gets a new one."""
        if setup.key in self._runners:
            self._interrupted.add(setup.key)

    def _broken(self, setup: DriveRequest, cell: Cell, cause: Breakdown, error: BaseException, start: int) -> CellResult:
        self._interrupt(setup)
        return CellResult(cell.id, None, None, {}, None, milliseconds_since(start), cause.value, describe(error))


def describe(error: BaseException) -> str:
    """Returns an error as one printable line: only the message of drivecal's own errors, type and location of others."""
    frames = traceback.extract_tb(error.__traceback__)
    if isinstance(error, DrivecalError) or not frames:
        message, location = str(error), ""
    else:
        message = "".join(traceback.format_exception_only(error))
        location = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})"
    message = " ".join(message.split())
    text = message[: LONGEST_DETAIL - len(location)] + location
    return "".join(character if character.isprintable() else "?" for character in text)


def _traced(cell: Cell, document: Mapping[str, Any], start: int) -> CellResult:
    """Returns the result of a run with its compressed time series."""
    content = compressed(document)
    rating, score, metrics, failure = (document[name] for name in ("rating", "score", "metrics", "failure"))
    return CellResult(cell.id, rating, score, metrics, failure, milliseconds_since(start), trace=content)


def _probed(runner: Runner, probes: Sequence[Probe]) -> tuple[tuple[int, int], ...]:
    """Returns the ids of proven probes with the numbers of their runs."""
    runs = ((probe.id, runner.prove([probe.parameters[name] for name in runner.parameters])) for probe in probes)
    return tuple((probe, run) for probe, run in runs if run is not None)


def _finite(name: str, value: float) -> float:
    value = float(value)
    if not math.isfinite(value):
        raise ValueError(f"{name} is {value}; results must be finite")
    return value
