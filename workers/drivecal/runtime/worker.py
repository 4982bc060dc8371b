"""A worker: runs batches of cells, one after the other, and turns whatever goes wrong in a cell into plain data."""

from __future__ import annotations

import gzip
import json
import math
import os
import socket
import time
import traceback
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from drivecal.certification.memory import Memory
from drivecal.contracts.work import Batch, BatchResult, Cell, CellResult, CertificateMemory, Probe, SetupRequest
from drivecal.domain.errors import ConflictError, DrivecalError, UnavailableError
from drivecal.domain.evaluations import Answered, Breakdown
from drivecal.runtime.compilation import prepare_cache
from drivecal.runtime.runners import RefusedError, Runner, make_runner

MOST_RUNNERS = 32
"""Runners kept at a time; the least recently used goes first. Studies of vehicle parameters go through hundreds of setups."""
LARGEST_TRACE = 8_000_000
"""Bytes; the built-in scenarios stay far below."""
LONGEST_DETAIL = 500
"""Characters."""


@dataclass(frozen=True, slots=True)
class WorkerFacts:
    """Where a worker runs."""

    node: str
    pid: int


class Worker:
    """Lives in a process of its own (a Ray actor), because a process can hold one SUMO simulation only."""

    def __init__(
        self,
        name: str,
        make: Callable[[SetupRequest], Runner] | None = None,
        certificates_mb: int | None = None,
    ) -> None:
        """`make` makes runners, those of the registry where it is not given; `certificates_mb`: memory for what certifies other runs."""
        self._name = name
        self._memory = Memory(certificates_mb)
        self._make = make or partial(make_runner, memory=self._memory)
        self._runners: OrderedDict[tuple[object, ...], Runner] = OrderedDict()

    def warm(self, trial: Batch) -> WorkerFacts:
        """Simulates `trial`: loads and compiles what the first batch would have to pay for, and shows that this worker can work.

        Raises UnavailableError saying why where it cannot.
        """
        prepare_cache()
        result = self.run(trial)
        for reason in (result.refusal, *(one.detail for one in result.results)):
            if reason is not None:
                raise UnavailableError(reason)
        return WorkerFacts(socket.gethostname(), os.getpid())

    def run(self, batch: Batch) -> BatchResult:
        """Simulates every cell, or none where this worker cannot run the setup: the result has a `refusal` then. Raises nothing that
        a cell or a plug-in is to blame for: the cell's result has a `breakdown` then."""
        start = time.perf_counter()
        results: tuple[CellResult, ...] = ()
        refusal = None
        try:
            results = tuple(self._run_cell(batch.setup, cell) for cell in batch.cells)
        except RefusedError as error:
            refusal = describe(error)
        seconds, memory = time.perf_counter() - start, self._memory
        return BatchResult(self._name, results, seconds, refusal, CertificateMemory(memory.states, memory.bytes, memory.limit))

    def _run_cell(self, setup: SetupRequest, cell: Cell) -> CellResult:
        start = time.thread_time_ns()
        try:
            runner = self._runner(setup)
            parameters = [cell.parameters[name] for name in runner.parameters]
            if cell.trace:
                return _traced(cell, runner.trace(parameters), start)
            done = runner.answer(parameters, cell.id, check=cell.check) if cell.certify else Answered(runner.run(parameters))
            rating = _finite("the rating", done.result.rating.rating)
            metrics = {name: _finite(name, value) for name, value in done.result.metrics.items()}
            failure = done.result.failure.value if done.result.failure else None
            milliseconds = _milliseconds(start)
            return CellResult(
                id=cell.id,
                rating=rating,
                score=int(done.result.rating.score),
                metrics=metrics,
                failure=failure,
                milliseconds=milliseconds,
                proven_by=done.proven_by,
                agrees=done.agrees,
                probed=_probed(runner, cell.probes),
            )
        except RefusedError:
            raise
        except MemoryError as error:
            return self._broken(setup, cell, Breakdown.MEMORY, error, start)
        except (Exception, SystemExit) as error:  # noqa: BLE001  # a plug-in may raise anything; it must not cost the worker
            return self._broken(setup, cell, Breakdown.ERROR, error, start)

    def _runner(self, setup: SetupRequest) -> Runner:
        key = _key(setup)
        if key not in self._runners:
            self._runners[key] = self._make(setup)
            if len(self._runners) > MOST_RUNNERS:
                self._runners.popitem(last=False)
        self._runners.move_to_end(key)
        return self._runners[key]

    def _broken(self, setup: SetupRequest, cell: Cell, cause: Breakdown, error: BaseException, start: int) -> CellResult:
        self._runners.pop(_key(setup), None)  # what was interrupted may be in any state
        return CellResult(cell.id, None, None, {}, None, _milliseconds(start), cause.value, describe(error))


def describe(error: BaseException) -> str:
    """An error in one printable line: drivecal's own in its words, others with their kind and the place in the code."""
    frames = traceback.extract_tb(error.__traceback__)
    if isinstance(error, DrivecalError) or not frames:
        words, place = str(error), ""
    else:
        words, place = (
            "".join(traceback.format_exception_only(error)),
            f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})",
        )
    words = " ".join(words.split())
    text = words[: LONGEST_DETAIL - len(place)] + place
    return "".join(character if character.isprintable() else "?" for character in text)


def _traced(cell: Cell, document: Mapping[str, Any], start: int) -> CellResult:
    """The result of a run with its time series."""
    content = gzip.compress(json.dumps(document, separators=(",", ":"), allow_nan=False).encode(), mtime=0)
    if len(content) > LARGEST_TRACE:
        raise ConflictError(
            f"the time series take {len(content):,} bytes, more than the {LARGEST_TRACE:,} that are kept of a run"
        )
    rating, score, metrics, failure = (document[name] for name in ("rating", "score", "metrics", "failure"))
    return CellResult(cell.id, rating, score, metrics, failure, _milliseconds(start), trace=content)


def _probed(runner: Runner, probes: Sequence[Probe]) -> tuple[tuple[int, int], ...]:
    """What is known of the probes."""
    found = ((one.id, runner.prove([one.parameters[name] for name in runner.parameters])) for one in probes)
    return tuple((probe, proof) for probe, proof in found if proof is not None)


def _key(setup: SetupRequest) -> tuple[object, ...]:
    return (setup.run_fingerprint, setup.catalogue, setup.scenario, setup.evaluator, *_sorted(setup.vehicle_parameters))


def _sorted(values: Mapping[str, float]) -> list[tuple[str, float]]:
    return sorted(values.items())


def _milliseconds(start: int) -> float:
    """CPU time of this thread since `start` (of `time.thread_time_ns`); Ray's own threads do not count."""
    return (time.thread_time_ns() - start) / 1e6


def _finite(name: str, value: float) -> float:
    value = float(value)
    if not math.isfinite(value):
        raise ValueError(f"{name} is {value}, which no result may be")
    return value
