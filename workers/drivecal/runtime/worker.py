"""A worker, which runs batches of cells in sequence and turns every error of a cell into plain data."""

import logging
import math
import os
import socket
import time
import traceback
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from drivecal.cluster import tracing
from drivecal.contracts.work import Batch, BatchResult, Cell, CellResult, SetupRequest
from drivecal.domain.errors import DrivecalError, UnavailableError
from drivecal.domain.evaluations import Breakdown
from drivecal.domain.scales import plain
from drivecal.plugins.runners import Runner
from drivecal.plugins.simulators import BusyError, UnsuitableError
from drivecal.runtime.bundles import BundleSessions, OtherToolsError, compressed, milliseconds_since
from drivecal.runtime.cache import BundleCache, cache_folder
from drivecal.runtime.compilation import prepare_cache
from drivecal.runtime.runners import RefusedError, make_runner

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
    """Runs batches in its own process, because a process can hold only one SUMO simulation."""

    def __init__(
        self,
        name: str,
        make: Callable[[SetupRequest, Path], Runner] = make_runner,
        bundles: BundleSessions | None = None,
        begins: Callable[[int], None] = lambda _: None,
    ) -> None:
        """Creates a worker.

        Args:
            name: Its name in results and messages.
            make: Creates runners of driving functions from a setup and its files.
            bundles: Runs problem bundles, by default with the adapters.
            begins: Called with a cell's id before each start of the simulator for it.
        """
        self._name = name
        self._make = make
        self._begins = begins
        self._bundles = bundles or BundleSessions(BundleCache(cache_folder()), begins=begins)
        self._runners: OrderedDict[tuple[object, ...], Runner] = OrderedDict()

    def warm(self, trial: Batch) -> WorkerFacts:
        """Simulates `trial`, which loads and compiles everything for the first batch and tests this worker.

        Raises UnavailableError naming the reason if the trial fails.
        """
        tracing.configure("worker")
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
        returns a `refusal`; likewise if its simulator is `busy`. `Batch.closes`: ends the setup's session.

        Exceptions of a cell or a plug-in do not propagate: the cell's result has a `breakdown` instead.
        """
        start = time.perf_counter()
        results: list[CellResult] = []
        refusal = busy = tools = None
        unsuitable = False
        try:
            if batch.closes:
                self._bundles.close(batch.setup)
            elif not batch.cells and not batch.setup.is_driven:
                tools = self._bundles.probe(batch.setup)
            begin = time.time_ns()
            for result in self._run_all(batch):  # what an exception ends keeps its results
                results.append(result)
                if batch.trace is not None:
                    known = {
                        "campaign": tracing.campaign_of(batch.trace),
                        "scenario": batch.setup.scenario,
                        "worker": self._name,
                    }
                    tracing.record("run", tracing.child(batch.trace), begin, batch.trace, **known, breakdown=result.breakdown)
                    begin = time.time_ns()
        except OtherToolsError as error:
            refusal, tools = describe(error), error.answer
        except BusyError as error:
            busy = describe(error)
        except (RefusedError, UnavailableError) as error:
            refusal, unsuitable = describe(error), isinstance(error, UnsuitableError)
        seconds = time.perf_counter() - start
        return BatchResult(self._name, tuple(results), seconds, refusal, tools, busy, unsuitable=unsuitable)

    def _run_all(self, batch: Batch) -> Iterator[CellResult]:
        setup = batch.setup
        if setup.is_driven:
            yield from (self._run_cell(setup, cell) for cell in batch.cells)
        else:
            yield from (self._bundles.run(setup, cell) for cell in batch.cells)

    def _run_cell(self, setup: SetupRequest, cell: Cell) -> CellResult:
        start = time.thread_time_ns()
        try:
            runner = self._runner(setup)
            self._begins(cell.id)
            values = {**setup.simulator["controller"].get("values", {}), **cell.parameters}
            parameters = [values[name] for name in runner.parameters]
            result, series = runner.trace(parameters) if cell.trace else (runner.run(parameters), None)
            rating = _finite("the rating", result.rating.rating)
            metrics = {name: _finite(name, value) for name, value in result.metrics.items()}
            failure = result.failure.value if result.failure else None
            return CellResult(
                id=cell.id,
                rating=rating,
                score=plain(_finite("the score", result.rating.score)),
                metrics=metrics,
                failure=failure,
                trace=None if series is None else compressed(series.model_dump(mode="json")),
                milliseconds=milliseconds_since(start),
            )
        except RefusedError:
            raise
        except MemoryError as error:
            return self._broken(setup, cell, Breakdown.MEMORY, error, start)
        except (Exception, SystemExit) as error:  # noqa: BLE001  # a plug-in may raise any exception; the worker must survive
            return self._broken(setup, cell, Breakdown.ERROR, error, start)

    def _runner(self, setup: SetupRequest) -> Runner:
        key = setup.key
        if key not in self._runners:
            try:
                with self._bundles.files(setup.bundle) as folder:
                    self._runners[key] = self._make(setup, folder)
            except UnavailableError as error:  # the cells are not to blame for missing files
                raise RefusedError(str(error)) from error
            if len(self._runners) > MOST_RUNNERS:
                self._runners.popitem(last=False)
        self._runners.move_to_end(key)
        return self._runners[key]

    def _broken(self, setup: SetupRequest, cell: Cell, cause: Breakdown, error: BaseException, start: int) -> CellResult:
        self._runners.pop(setup.key, None)  # it may be in any state
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


def _finite(name: str, value: float) -> float:
    value = float(value)
    if not math.isfinite(value):
        raise ValueError(f"{name} is {value}; results must be finite")
    return value
