"""The open sessions of simulators on a worker."""

import gzip
import json
import logging
import math
import socket
import threading
import time
import weakref
from collections import OrderedDict
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from drivecal.adapters.command import run_probe
from drivecal.adapters.kinds import simulator_of
from drivecal.adapters.process import WATCH_SECONDS, ProcessSession
from drivecal.bundles.fingerprints import parts_of
from drivecal.bundles.shapes import Shape, with_points
from drivecal.contracts.work import Cell, CellResult, SetupRequest, runs_in_worker
from drivecal.domain.errors import ConflictError, DrivecalError, UnavailableError
from drivecal.domain.evaluations import Breakdown
from drivecal.domain.scales import plain
from drivecal.plugins import registry
from drivecal.plugins.simulators import (
    MOST_SESSIONS,
    BusyError,
    Declared,
    NoMeasuresError,
    RunOutcome,
    Simulator,
    SimulatorSession,
    UnsuitableError,
)
from drivecal.runtime.cache import BundleCache

ASK_AGAIN_SECONDS = 600.0
"""Age of an answer after which the probe runs again: tools may be upgraded while a worker lives."""
INPUTS_SECONDS = 10.0
"""The same for inputs that are read in no time."""
_SHOWN = 150
_REMEDIES = {"sumo": "the same version of libsumo"}
"""Package to install if a part of a setup (`fingerprints.parts_of`) differs; else the same drivecal and plug-ins."""


class OtherToolsError(UnavailableError):
    """This machine has other versions of tools than the campaign began with. `answer` is the answer of the probe here."""

    def __init__(self, answer: str, expected: str) -> None:
        own, others = (set(text.splitlines()) for text in (answer, expected))
        here, there = (
            _shown("\n".join(line for line in text.splitlines() if line in lines))
            for text, lines in ((answer, own - others), (expected, others - own))
        )
        super().__init__(
            f"tools or inputs outside of the problem's folder differ: {here} on {socket.gethostname()} and {there} in this campaign;"
            " install the same on all machines, or submit the campaign again"
        )
        self.answer = answer


class Tools:
    """Answers of probes, by bundle."""

    def __init__(
        self, run: Callable[[Mapping[str, Any], Path], str] = run_probe, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._run, self._clock = run, clock
        self._answers: dict[str, tuple[str, float]] = {}
        """Answers and the times at which they are too old."""

    def ask(self, setup: SetupRequest, folder: Path) -> str:
        """Runs the probe of a bundle in `folder`. Raises UnavailableError if it gives no answer."""
        began = self._clock()
        answer = self._run(setup.simulator, folder)
        seconds = self._clock() - began
        age = ASK_AGAIN_SECONDS
        if setup.simulator.get("inputs"):  # files change sooner than tools; a look takes at most a hundredth of the time
            age = min(age, max(INPUTS_SECONDS, 100 * seconds))
        self._answers[setup.bundle] = answer, began + age
        return answer

    def check(self, setup: SetupRequest, folder: Callable[[], Path], *, again: bool = False) -> None:
        """Raises OtherToolsError if the setup has other tools. The probe runs `again`, or if its last answer is old or differs."""
        if setup.tools is None:
            return
        answer, until = self._answers.get(setup.bundle, ("", 0.0))
        if again or answer != setup.tools or self._clock() >= until:
            answer = self.ask(setup, folder())
        if answer != setup.tools:
            raise OtherToolsError(answer, setup.tools)


def _shown(answer: str) -> str:
    text = " ".join(answer.split())
    return repr(text if len(text) <= _SHOWN else f"{text[:_SHOWN]}...")


LARGEST_SERIES = 8_000_000
"""Largest size of compressed time series in bytes; the built-in scenarios stay far below."""


def milliseconds_since(start: int) -> float:
    """Returns the CPU time of this thread since `start` (of `time.thread_time_ns`), without Ray's own threads."""
    return (time.thread_time_ns() - start) / 1e6


def compressed(document: Mapping[str, Any]) -> bytes:
    """Returns a run with its time series as compressed JSON.

    Raises ConflictError if it is too large, and ValueError if a number is not finite.
    """
    content = gzip.compress(json.dumps(document, separators=(",", ":"), allow_nan=False).encode(), mtime=0)
    if len(content) > LARGEST_SERIES:
        raise ConflictError(f"the time series of the run take {len(content):,} bytes, beyond the limit of {LARGEST_SERIES:,}")
    return content


log = logging.getLogger(__name__)

MOST_IN_WORKER = 32
"""Open sessions that hold no process. Studies of vehicle parameters use hundreds of setups."""
IDLE_SECONDS = 600.0
"""Time without a run after which a session is closed: it may hold memory and a licence."""


class BundleSessions:
    """Runs cells of bundles in sessions that stay open."""

    def __init__(
        self,
        cache: BundleCache,
        simulators: Callable[[Mapping[str, Any]], Simulator] = simulator_of,
        tools: Tools | None = None,
        clock: Callable[[], float] = time.monotonic,
        begins: Callable[[int], None] = lambda _: None,
    ) -> None:
        """`simulators`: returns the simulator of a section; `tools`: runs probes, by default in child processes; `begins`:
        called with a cell's id before each start of the simulator for it."""
        self._begins = begins
        self._cache = cache
        self._tools = tools or Tools()
        self._simulators = simulators
        self._sessions: OrderedDict[tuple[str, ...], SimulatorSession] = OrderedDict()
        self._in_worker: set[tuple[str, ...]] = set()
        """Sessions that hold no process."""
        self._used: dict[tuple[str, ...], float] = {}
        """Time of the last run of each session."""
        self._failed_alone: dict[tuple[str, ...], float] = {}
        """Time at which a start failed without other sessions: it lacks something else than what those hold."""
        self._clock = clock
        self._running = threading.Lock()
        self._starts = 0
        """Runs that were begun for the current cell."""
        self._watched = False

    def run(self, setup: SetupRequest, cell: Cell) -> CellResult:
        """Simulates a cell. A run without measures is a result with a `breakdown`.

        Raises UnavailableError if this machine cannot run the simulator, UnsuitableError if none can.
        """
        with self._running:
            self._starts = 0
            try:
                try:
                    return self._run(setup, cell)
                except OSError as error:  # a full disk, or what the simulator did to its folder: a new session has another
                    self._starts -= isinstance(error, ChildProcessError)  # it was not started
                    self._drop(setup.session_key)
                    return self._run(setup, cell)
            except OSError as error:
                self._drop(setup.session_key)
                raise _unable(error) from error
            except BusyError:  # the program waits for a licence, say: it is asked again as it is
                raise
            except UnavailableError:
                # Of a new child, for example: the next attempt begins with all checks, and without other sessions if need be.
                self._drop(setup.session_key)
                raise
            finally:
                if setup.session_key in self._sessions:
                    self._used[setup.session_key] = self._clock()
                self._close_idle()

    def watch(self) -> None:
        """Holds the sessions to their limits between their runs, and closes sessions that are unused for long. Thread-safe."""
        for session in list(self._sessions.values()):
            if isinstance(session, ProcessSession):
                session.watch()
        if self._running.acquire(blocking=False):  # else the end of the run looks after it
            try:
                self._close_idle()
            finally:
                self._running.release()

    def _close_idle(self) -> None:
        for key in [key for key, used in self._used.items() if self._clock() >= used + IDLE_SECONDS]:
            self._drop(key)

    def _run(self, setup: SetupRequest, cell: Cell) -> CellResult:
        start = time.thread_time_ns()
        session = self._session(setup)
        began = time.perf_counter()  # a start's time is no run's
        settings = {name: cell.parameters[name] for name in setup.parameters} | dict(setup.varied)
        # a campaign's planner may lack some
        settings |= {name: int(settings[name]) for name in setup.integers if name in settings}
        shapes = {name: Shape.from_document(name, document) for name, document in setup.shapes.items()}
        parameters = with_points(settings, shapes, setup.simulator)
        self._starts += 1
        self._begins(cell.id)
        try:
            outcome = session.evaluate(parameters, series=cell.trace, seed=setup.seed)
            trace = _series(outcome) if cell.trace else None
        except NoMeasuresError as error:
            milliseconds = milliseconds_since(start) + 1000 * error.cpu_seconds
            return CellResult(
                *(cell.id, None, None, {}, None, milliseconds, error.breakdown.value, str(error)),
                contained=error.is_contained,
                starts=self._starts,
            )
        milliseconds = milliseconds_since(start) + 1000 * outcome.cpu_seconds
        wall = 1000 * (time.perf_counter() - began - outcome.start_seconds - outcome.queued_seconds)
        if cell.check:
            self._begins(cell.id)
        repeats, spent = self._repeated(setup, parameters, outcome) if cell.check else (None, 0.0)
        return CellResult(
            id=cell.id,
            rating=None if outcome.rating is None else float(outcome.rating.rating),
            score=None if outcome.rating is None else plain(float(outcome.rating.score)),
            metrics=dict(outcome.measures),
            failure=outcome.failure,
            milliseconds=milliseconds + spent,
            repeats=repeats,
            trace=trace,
            checking=spent,
            wall_milliseconds=None if runs_in_worker(setup.simulator) else wall,
            starts=self._starts,
        )

    def _repeated(self, setup: SetupRequest, parameters: Mapping[str, Any], outcome: RunOutcome) -> tuple[bool | None, float]:
        """Runs a cell again. Returns whether the outcome is the same, None if there is no second one, and the CPU time (ms)."""
        start = time.thread_time_ns()
        self._starts += 1
        try:
            again = self._sessions[setup.session_key].evaluate(parameters, seed=setup.seed)
        except NoMeasuresError as error:  # a crash says nothing about what a whole run would give
            log.warning("a run of %s that was repeated has no result: %s", setup.problem, error)
            return None, milliseconds_since(start) + 1000 * error.cpu_seconds
        except (UnavailableError, OSError) as error:
            # The first outcome counts all the same, or the cell would come back again and again. The next one begins with all checks.
            log.warning("a run of %s cannot be repeated: %s", setup.problem, error)
            self._drop(setup.session_key)
            self._starts -= 1
            return None, milliseconds_since(start)
        same = (again.failure, dict(again.measures)) == (outcome.failure, dict(outcome.measures))
        return same, milliseconds_since(start) + 1000 * again.cpu_seconds

    def probe(self, setup: SetupRequest) -> str:
        """Returns what the bundle's `probe` answers. Raises UnavailableError if it gives no answer."""
        try:
            return self._tools.ask(setup, self._cache.folder(setup.bundle))
        except OSError as error:
            raise _unable(error) from error

    def close(self, setup: SetupRequest) -> None:
        """Ends the session of a setup, whose processes may hold licences."""
        with self._running:
            self._drop(setup.session_key)

    def store(self, digest: str, archive: bytes) -> None:
        """Unpacks a bundle unless it is there. Raises InvalidInputError if the archive is unsafe or has another digest."""
        self._cache.store(digest, archive)

    def _session(self, setup: SetupRequest) -> SimulatorSession:
        self._tools.check(setup, lambda: self._cache.folder(setup.bundle))
        if setup.session_key not in self._sessions:
            self._sessions[setup.session_key] = self._opened_alone(setup)
            if is_here := runs_in_worker(setup.simulator):
                self._in_worker.add(setup.session_key)
            alike = [key for key in self._sessions if (key in self._in_worker) is is_here]
            if len(alike) > (MOST_IN_WORKER if is_here else MOST_SESSIONS):
                self._drop(alike[0])
        self._sessions.move_to_end(setup.session_key)
        if not self._watched:
            self._watched = True
            threading.Thread(target=_watch, args=(weakref.ref(self),), daemon=True).start()
        return self._sessions[setup.session_key]

    def _opened_alone(self, setup: SetupRequest) -> SimulatorSession:
        """Opens a session, if need be without the others, which may hold the licence or the memory that it lacks. That is tried again only
        after IDLE_SECONDS: refused cells are asked for often, and the others would start again each time."""
        _refuse_other_parts(setup, lambda: self._simulators(setup.simulator).version)
        tried = self._clock() - self._failed_alone.get(setup.session_key, -math.inf) < IDLE_SECONDS
        try:
            session = self._opened(setup)
        except UnsuitableError:
            raise
        except (UnavailableError, OSError):
            if not self._sessions or tried:
                raise
        else:
            if not self._sessions or tried or not _has_failed(session):
                return session
            _close(session)
        for key in list(self._sessions):
            self._drop(key)
        self._failed_alone[setup.session_key] = self._clock()
        session = self._opened(setup)
        if not _has_failed(session):
            del self._failed_alone[setup.session_key]
        return session

    def _opened(self, setup: SetupRequest) -> SimulatorSession:
        folder = self._cache.folder(setup.bundle)
        simulator = self._simulators(setup.simulator)
        session = simulator.open(setup.simulator, setup.scenario, setup.data, folder, Declared.of(setup))
        if setup.tools is not None and setup.simulator.get("inputs"):
            try:
                self._tools.check(setup, lambda: folder, again=True)  # it may have read a file that was another for a moment
            except BaseException:
                _close(session)
                raise
        return session

    def _drop(self, key: tuple[str, ...]) -> None:
        """Closes a session, which may be in any state."""
        self._used.pop(key, None)
        self._in_worker.discard(key)
        session = self._sessions.pop(key, None)
        if session is not None:
            _close(session)


def _close(session: SimulatorSession) -> None:
    """Closes a session. Its error would cost the run of another problem, so that it is logged only."""
    try:
        session.close()
    except Exception:
        log.exception("the session of a simulator cannot be closed")


def _has_failed(session: SimulatorSession) -> bool:
    """Returns whether a program crashed or hung at its start; a start that it refuses raises an error."""
    return isinstance(session, ProcessSession) and session.has_failed


def _watch(sessions: weakref.ref[BundleSessions]) -> None:
    """Watches sessions until nothing uses them any more."""
    while (watched := sessions()) is not None:
        try:
            watched.watch()
        except Exception:  # a thread that ends would leave all sessions without limits between runs
            log.exception("the sessions of simulators cannot be watched")
        del watched
        time.sleep(WATCH_SECONDS)


def _unable(error: OSError) -> UnavailableError:
    """Returns the refusal of a machine that lacks disk, processes or files: its cells are not to blame, so they wait."""
    return UnavailableError(f"this machine cannot run simulators: {error}")


def _refuse_other_parts(setup: SetupRequest, adapter: Callable[[], str]) -> None:
    """Raises UnavailableError if the adapter, SUMO or a plug-in of a setup is another one here, or fails to load: results would differ."""
    if not setup.document:
        return
    try:
        installed: dict[str, str | None] = {"adapter": adapter(), **parts_of(setup.simulator, setup.data)}
        if setup.evaluator is not None:  # its version makes an evaluator check its shipped files
            evaluator = registry.evaluator(setup.evaluator.split()[0])
            installed["evaluator"] = f"{evaluator.name} {evaluator.version}"
    except DrivecalError as error:
        raise UnavailableError(str(error)) from error
    except Exception as error:  # a badly installed package may raise any exception
        raise UnavailableError(f"a plug-in cannot be loaded: {type(error).__name__}: {error}") from error
    for name, version in installed.items():
        requested = setup.evaluator if name == "evaluator" else setup.document.get(name)
        if version != requested:
            raise UnavailableError(
                f"coordinator and worker differ: the {name} of kind {setup.simulator['kind']} is {requested} at the coordinator"
                f" and {version} at the worker; install {_REMEDIES.get(name, 'the same drivecal and plug-ins')} on both"
            )


def _series(outcome: RunOutcome) -> bytes:
    """Returns a run with its time series, without its replay if that is too large or not finite. Raises NoMeasuresError if they are."""
    series = {name: list(values) for name, values in outcome.series.items()}
    document: dict[str, Any] = {"measures": dict(outcome.measures), "failure": outcome.failure, "series": series}
    if outcome.replay is not None:
        with suppress(ConflictError, ValueError):
            return compressed(document | {"replay": outcome.replay.model_dump()})
    try:
        return compressed(document)
    except (ConflictError, ValueError) as error:
        raise NoMeasuresError(Breakdown.ERROR, f"its time series cannot be kept: {error}", outcome.cpu_seconds) from error
