"""Problem bundles on a worker: a cache of unpacked files by digest, and the open sessions of their simulators."""

import os
import tempfile
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from drivecal.adapters.kinds import simulator
from drivecal.bundles.archives import unpack
from drivecal.contracts.work import BundleRequest, Cell, CellResult
from drivecal.domain.errors import ConflictError, UnavailableError
from drivecal.domain.evaluations import Breakdown
from drivecal.plugins.simulators import Declared, NoMeasuresError, RunOutcome, Simulator, SimulatorSession
from drivecal.runtime.results import compressed, milliseconds_since
from drivecal.runtime.tools import Tools

MOST_SESSIONS = 8
"""Open sessions of a worker, least recently used first to go: each may hold a process of the user's."""

CACHE = "DRIVECAL_BUNDLE_CACHE"
"""Environment variable: folder of unpacked bundles."""


def cache_folder() -> Path:
    """Returns the folder of unpacked bundles: `DRIVECAL_BUNDLE_CACHE`, or the user's cache, or a new temporary folder."""
    given = os.environ.get(CACHE)
    folder = Path(given) if given else Path("~/.cache/drivecal/bundles").expanduser()
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    except OSError:
        writable = False
    else:
        writable = os.access(folder, os.W_OK)
    return folder if writable else Path(tempfile.mkdtemp(prefix="drivecal-bundles-"))


class BundleCache:
    """Unpacked bundles of a node, shared by its workers: a folder for each digest, complete or absent."""

    def __init__(self, folder: Path) -> None:
        """`folder`: is created if it does not exist."""
        self._folder = folder

    def has(self, digest: str) -> bool:
        """Whether a bundle is there."""
        return (self._folder / digest).is_dir()

    def folder(self, digest: str) -> Path:
        """Returns the folder of a bundle that is there."""
        return self._folder / digest

    def store(self, digest: str, archive: bytes) -> None:
        """Unpacks a bundle unless it is there. Raises InvalidInputError if the archive is unsafe or has another digest.

        Atomic, because workers of a node share the folder.
        """
        if self.has(digest):
            return
        self._folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        try:
            unpack(archive, self._folder / digest, digest)
        except OSError:
            if not self.has(digest):  # else another worker was faster
                raise


class BundleSessions:
    """Runs cells of bundles in sessions that stay open."""

    def __init__(
        self, cache: BundleCache, simulators: Callable[[str], Simulator] = simulator, tools: Tools | None = None
    ) -> None:
        """`simulators`: returns a simulator by its kind; `tools`: runs probes, by default in child processes."""
        self._cache = cache
        self._tools = tools or Tools()
        self._simulators = simulators
        self._sessions: OrderedDict[tuple[str, ...], SimulatorSession] = OrderedDict()

    def run(self, setup: BundleRequest, cell: Cell) -> CellResult:
        """Simulates a cell. A run without measures is a result with a `breakdown`.

        Raises UnavailableError if this machine cannot run the simulator.
        """
        start = time.thread_time_ns()
        session = self._session(setup)
        parameters = {name: cell.parameters[name] for name in setup.parameters}
        parameters |= {name: int(parameters[name]) for name in setup.integers}
        try:
            outcome = session.evaluate(parameters, series=cell.trace)
            trace = _series(outcome) if cell.trace else None
        except NoMeasuresError as error:
            milliseconds = milliseconds_since(start) + 1000 * error.cpu_seconds
            return CellResult(cell.id, None, None, {}, None, milliseconds, error.breakdown.value, str(error), contained=True)
        milliseconds = milliseconds_since(start) + 1000 * outcome.cpu_seconds
        repeats, spent = self._repeated(session, parameters, outcome) if cell.check else (None, 0.0)
        return CellResult(
            id=cell.id,
            rating=None,
            score=None,
            metrics=dict(outcome.measures),
            failure=outcome.failure,
            milliseconds=milliseconds + spent,
            repeats=repeats,
            trace=trace,
            certifying=spent,
        )

    def _repeated(self, session: SimulatorSession, parameters: Mapping[str, Any], outcome: RunOutcome) -> tuple[bool, float]:
        """Runs a cell again. Returns whether the outcome is the same, and the CPU time (ms)."""
        start = time.thread_time_ns()
        try:
            again = session.evaluate(parameters)
        except NoMeasuresError as error:
            return False, milliseconds_since(start) + 1000 * error.cpu_seconds
        same = (again.failure, dict(again.measures)) == (outcome.failure, dict(outcome.measures))
        return same, milliseconds_since(start) + 1000 * again.cpu_seconds

    def probe(self, setup: BundleRequest) -> str:
        """Returns what the bundle's `probe` answers. Raises UnavailableError if it gives no answer."""
        return self._tools.ask(setup, self._folder(setup))

    def store(self, digest: str, archive: bytes) -> None:
        """Unpacks a bundle unless it is there. Raises InvalidInputError if the archive is unsafe or has another digest."""
        self._cache.store(digest, archive)

    def close(self) -> None:
        """Closes all sessions."""
        while self._sessions:
            self._sessions.popitem()[1].close()

    def _session(self, setup: BundleRequest) -> SimulatorSession:
        if setup.tools is not None:
            self._tools.check(setup, self._folder(setup))
        if setup.key not in self._sessions:
            folder = self._folder(setup)
            chosen = self._simulators(setup.simulator["kind"])
            declared = Declared(setup.problem, setup.measures, setup.failures, setup.series)
            self._sessions[setup.key] = chosen.open(setup.simulator, setup.scenario, setup.data, folder, declared)
            if len(self._sessions) > MOST_SESSIONS:
                self._sessions.popitem(last=False)[1].close()
        self._sessions.move_to_end(setup.key)
        return self._sessions[setup.key]

    def _folder(self, setup: BundleRequest) -> Path:
        """Returns the folder of a bundle. Raises UnavailableError if it is not there."""
        if not self._cache.has(setup.bundle):
            raise UnavailableError(f"the files of the bundle {setup.bundle} are not on this machine")
        return self._cache.folder(setup.bundle)


def _series(outcome: RunOutcome) -> bytes:
    """Returns a run with its time series. Raises NoMeasuresError if they are too large or not finite."""
    series = {name: list(values) for name, values in outcome.series.items()}
    try:
        return compressed({"measures": dict(outcome.measures), "failure": outcome.failure, "series": series})
    except (ConflictError, ValueError) as error:
        raise NoMeasuresError(Breakdown.ERROR, f"its time series cannot be kept: {error}", outcome.cpu_seconds) from error
