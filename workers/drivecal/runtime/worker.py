"""A worker, which runs batches of cells in sequence and turns every error of a cell into plain data."""

import logging
import os
import socket
import time
from dataclasses import dataclass

from drivecal.contracts.work import Batch, BatchResult, CellResult
from drivecal.domain.errors import DrivecalError, UnavailableError, describe
from drivecal.plugins.simulators import BusyError, UnsuitableError
from drivecal.runtime.bundles import BundleSessions, OtherToolsError
from drivecal.runtime.cache import BundleCache, cache_folder
from drivecal.runtime.compilation import prepare_cache

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class WorkerFacts:
    """Node and process of a worker."""

    node: str
    pid: int


class Worker:
    """Runs batches in its own process, because a process can hold only one SUMO simulation."""

    def __init__(self, name: str, bundles: BundleSessions | None = None) -> None:
        """Creates a worker.

        Args:
            name: Its name in results and messages.
            bundles: Runs the cells, by default with the installed simulators.
        """
        self._name = name
        self._bundles = bundles or BundleSessions(BundleCache(cache_folder()))

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
            elif not batch.cells:
                tools = self._bundles.probe(batch.setup)
            for cell in batch.cells:  # an exception keeps the results before it
                results.append(self._bundles.run(batch.setup, cell))  # noqa: PERF401  # `extend` hides that
        except OtherToolsError as error:
            refusal, tools = describe(error), error.answer
        except BusyError as error:
            busy = describe(error)
        except UnavailableError as error:
            refusal, unsuitable = describe(error), isinstance(error, UnsuitableError)
        seconds = time.perf_counter() - start
        return BatchResult(self._name, tuple(results), seconds, refusal, tools, busy, unsuitable=unsuitable)
