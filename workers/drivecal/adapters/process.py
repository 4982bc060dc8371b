"""Simulator kind `process`: a program that answers JSON lines, started once per session. Also the base of `python` and `fmu`."""

import json
import logging
import math
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from drivecal.adapters import answers, inputs
from drivecal.adapters.children import Children
from drivecal.adapters.environment import Scratch
from drivecal.adapters.pipes import RUN_LIMIT, Pipes
from drivecal.domain.errors import UnavailableError
from drivecal.domain.evaluations import Breakdown
from drivecal.domain.values import Argument
from drivecal.plugins.simulators import SEED, Declared, NoMeasuresError, RunOutcome, UnsuitableError, start_limit

START_LIMIT = (
    "the limit of a start (`simulator.timeout` in problem.yaml, s, or 60 if that is less); raise it if starts may take longer"
)
"""Origin of that limit, for the message of a hang."""
QUIT_SECONDS = 1.0
"""Time that a program has to end after `quit`."""
WATCH_SECONDS, WATCH_SHARE = 1.0, 0.002
"""Shortest time between two looks at a session between its runs, and their largest share of a core."""
_QUIT = b'{"quit": true}\n'

log = logging.getLogger(__name__)


class ProcessSession:
    """A child that answers one request per run. Any fault of the protocol ends it; the next run starts another."""

    def __init__(
        self,
        command: Sequence[str],
        section: Mapping[str, Any],
        scratch: Scratch,
        declared: Declared,
        *,
        scenario: str,
        data: Mapping[str, Any],
        most_runs: float = math.inf,
        advice: str = "",
        writable: Sequence[str] = (),
        replays: bool = False,
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        """Starts the child. Raises UnavailableError if it cannot be started or reports an error instead of being ready, and
        UnsuitableError if that error blames the problem's files.

        Args:
            command: starts the child.
            section: the manifest's section `simulator`.
            scratch: its folders, which the session removes.
            declared: declarations of the manifest.
            scenario: name of the scenario.
            data: its data.
            most_runs: number of runs after which another child is started.
            advice: further help if an answer is late.
            writable: folders outside of the scratch folder that the child may change.
            replays: the child reports replays with its time series.
            settings: what one of drivecal's own drivers gets with the first line. Its errors may blame the problem's files.
        """
        self._scratch, self._declared, self._timeout, self._most_runs = scratch, declared, section["timeout"], most_runs
        self._advice, self._replays, self._is_driver = advice, replays, settings is not None
        greeting = {"drivecal": 1, "problem": declared.problem} | ({} if settings is None else {"settings": settings})
        self._greeting = json.dumps(greeting, allow_nan=False).encode() + b"\n"
        self._children = Children(command, section, scratch, writable)
        self._pipes: Pipes | None = None
        self._number = self._runs = 0
        self._head = json.dumps({"scenario": scenario, "data": data}, allow_nan=False).removesuffix("}")
        self._failed_start: NoMeasuresError | None = None
        self._lock = threading.Lock()
        self._next_watch = 0.0
        try:
            self._start()
        except NoMeasuresError as error:
            self._failed_start = error
        except BaseException:
            self.close()
            raise

    @property
    def has_failed(self) -> bool:
        """The first start has failed, which the next run will report."""
        return self._failed_start is not None

    def opened(self) -> set[str]:
        """Returns paths of files that the child has opened, as far as they are seen."""
        return inputs.seen(self._scratch.folder / inputs.NAME, self._children.family)

    def evaluate(self, parameters: Mapping[str, Argument], *, series: bool = False, seed: int = SEED) -> RunOutcome:
        """Runs one parameter set under a seed. Raises UnavailableError if a new child reports an error instead of being ready."""
        with self._lock:
            return self._children.timed(lambda: self._evaluate(parameters, series=series, seed=seed))

    def watch(self) -> None:
        """Ends the child if it exceeds a limit between two runs. Does nothing during a run, and soon after the last look. Thread-safe."""
        start = time.monotonic()
        if start < self._next_watch or not self._lock.acquire(blocking=False):
            return
        try:
            if self._pipes is not None:
                self._children.look()
        except (NoMeasuresError, OSError) as error:
            log.warning("a simulator of %s is ended between two runs: %s", self._declared.problem, error)
            self._stop()
        finally:
            now = time.monotonic()
            self._next_watch = now + max(WATCH_SECONDS, (now - start) / WATCH_SHARE)
            self._lock.release()

    def close(self) -> None:
        """Asks the child to end and ends it."""
        with self._lock:
            self._stop(_QUIT)
            self._children.close()
            self._scratch.remove()

    def _evaluate(self, parameters: Mapping[str, Argument], *, series: bool, seed: int) -> RunOutcome:
        if self._failed_start is not None:
            failed, self._failed_start = self._failed_start, None
            raise failed
        pipes = self._pipes
        wall_seconds = cpu_seconds = 0.0
        if pipes is None or self._runs >= self._most_runs or not pipes.is_fresh():
            wall, cpu = time.perf_counter(), self._children.cpu_seconds()
            pipes = self._start_again()
            wall_seconds, cpu_seconds = time.perf_counter() - wall, self._children.cpu_seconds() - cpu
        self._number, self._runs = self._number + 1, self._runs + 1
        request = f'{{"id": {self._number}, {self._head[1:]}, "seed": {seed}'
        request += f', "parameters": {json.dumps(dict(parameters), allow_nan=False)}'
        request += ', "series": true}\n' if series else "}\n"
        try:
            answer = answers.document(pipes.ask(request.encode(), self._timeout, RUN_LIMIT + self._advice), "the answer")
            if answer.get("id") != self._number or answer["id"] is True:
                raise NoMeasuresError(Breakdown.ERROR, f"the answer's id is {answer.get('id')!r:.100}, not {self._number}")
            if pipes.has_more:
                raise NoMeasuresError(Breakdown.ERROR, "it wrote more than one line in answer to one request")
        except NoMeasuresError:
            self._stop()
            raise
        outcome = answers.outcome(answer, self._declared, series=series, replay=self._replays)
        return replace(outcome, cpu_seconds=-cpu_seconds, start_seconds=wall_seconds)  # `timed` adds the CPU time of both

    def _start_again(self) -> Pipes:
        self._stop(_QUIT)
        self._scratch.clear()
        try:
            return self._start()
        except UnsuitableError as error:  # it has started with these files: they have changed, or this machine has
            raise UnavailableError(str(error)) from None

    def _start(self) -> Pipes:
        self._pipes, self._runs = Pipes(self._children), 0
        try:
            answer = answers.document(
                self._pipes.ask(self._greeting, start_limit(self._timeout), START_LIMIT + self._advice), "the answer"
            )
            answers.refuse_busy(answer)
            if answer.get("error") not in (None, False, ""):
                kind = UnsuitableError if self._is_driver and answer.get("unsuitable") is True else UnavailableError
                raise kind(f"the simulator is not ready: {self._scratch.shown(str(answer['error']))[:300]}")
            if answer.get("ready") is not True:
                raise NoMeasuresError(Breakdown.ERROR, f'the first answer is not {{"ready": true}}: {answer!r:.200}')
            self._children.look()  # a program behind a shell script has its own CPU time
        except NoMeasuresError as error:
            self._stop()
            raise NoMeasuresError(error.breakdown, f"the simulator does not start: {error.detail}") from None
        except UnavailableError:
            self._stop()
            raise
        return self._pipes

    def _stop(self, farewell: bytes = b"") -> None:
        pipes, self._pipes = self._pipes, None
        if pipes is not None:
            pipes.stop(farewell, QUIT_SECONDS)
