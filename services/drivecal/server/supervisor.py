"""Supervision of the server's processes: restarts dead ones, ends and restarts silent ones, and leaves none behind."""

import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

from drivecal.cluster import pulse
from drivecal.server.guardian import end_session

GRACE_SECONDS = 8.0
"""Seconds for a child to end by itself; the server then ends within ten."""
TRIES_TO_START = 3
KILLED = {128 + signal.SIGKILL, -signal.SIGKILL}
"""Exit codes of a process that others killed, the system without memory among them: they say nothing about its settings."""
LOOK_SECONDS, ASK_SECONDS = 0.1, 1.0
"""Intervals between two looks at the children, and between two questions of what is not ready."""
PATIENCE_SECONDS = 30.0
FIRST_PAUSE_SECONDS, LONGEST_PAUSE_SECONDS, LONGEST_AFTER_KILL = 0.5, 30.0, 4.0
"""Pauses before restarts; after a kill, that of a silent process included, another has its place within 20 s however often it happens."""
HEALTHY_AFTER_SECONDS = 60.0
KEPT_BACK = {"DRIVECAL_TOKEN"}
"""Variables that the children do not inherit: they do not need the user's own token."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ChildProcess:
    """A command that shows signs of life (`cluster.pulse`). `keep`: inherited file descriptors. `environment` adds to this process's."""

    name: str
    command: Sequence[str]
    environment: Mapping[str, str] = field(default_factory=dict)
    keep: Sequence[int] = ()


@dataclass(slots=True)
class Pauses:
    """Pauses before restarts: doubled with every death, reset after a minute of health."""

    deaths: int = 0

    def next(self, lived: float, code: int) -> float:
        """Returns the seconds to wait after a process that lived for `lived` seconds and ended with an exit code."""
        self.deaths = 1 if lived >= HEALTHY_AFTER_SECONDS else self.deaths + 1
        longest = LONGEST_AFTER_KILL if code in KILLED else LONGEST_PAUSE_SECONDS
        return min(longest, FIRST_PAUSE_SECONDS * 2.0 ** min(self.deaths - 1, 10))  # a larger power overflows in the end


class _Child:
    def __init__(self, specification: ChildProcess) -> None:
        self.specification = specification
        self.pauses = Pauses()
        self.process: subprocess.Popen[bytes] | None = None
        self._pulse = pulse.Pipe()
        self.started_at = self.start_at = 0.0
        self.gave_up = 0
        """Ends that were its own doing, since it last lived for a minute."""

    def start(self) -> None:
        before, self._pulse = self._pulse, pulse.Pipe()
        before.close()
        kept = (*self.specification.keep, self._pulse.writer)
        keep = ",".join(map(str, kept))
        guardian = [sys.executable, "-P", "-m", "drivecal.server.guardian", str(GRACE_SECONDS), keep]
        self.process = subprocess.Popen(  # noqa: S603  # the server's own commands
            [*guardian, *self.specification.command],
            stdin=subprocess.PIPE,  # never written to; its end tells the guardian that we are gone
            env={name: value for name, value in os.environ.items() if name not in KEPT_BACK}
            | dict(self.specification.environment)
            | {pulse.VARIABLE: str(self._pulse.writer)},
            pass_fds=kept,
            start_new_session=True,  # Ctrl-C in a terminal reaches the supervisor alone
        )
        self.started_at = time.monotonic()

    def end_if_silent(self) -> None:
        """Kills a process that is stopped or hangs; its guardian ends what it leaves."""
        if self.process is not None and self._pulse.is_silent():
            log.warning("the %s shows no sign of life; it is ended and starts again", self.specification.name)
            with suppress(ProcessLookupError):
                os.kill(self._pulse.process if self._pulse.process > 0 else self.process.pid, signal.SIGKILL)

    def ended(self) -> int | None:
        """Cleans up after an ended process and returns its exit code; None while it runs or waits for its restart."""
        if self.process is None or self.process.poll() is None:
            return None
        process, self.process = self.process, None
        if process.returncode < 0:  # the guardian itself was killed and has not cleaned up
            end_session(process.pid)
        if process.stdin:
            process.stdin.close()
        lived = time.monotonic() - self.started_at
        self.start_at = time.monotonic() + self.pauses.next(lived, process.returncode)
        if lived >= HEALTHY_AFTER_SECONDS:
            self.gave_up = 0
        self.gave_up += process.returncode not in KILLED
        return process.returncode


class Supervisor:
    """The supervisor of `children` until SIGTERM, SIGINT or SIGHUP.

    `missing` returns what is not ready yet. `announce` is called when nothing is missing for the first time.
    """

    def __init__(
        self, children: Sequence[ChildProcess], missing: Callable[[], Sequence[str]], announce: Callable[[], None]
    ) -> None:
        self._children = [_Child(child) for child in children]
        self._missing, self._announce = missing, announce
        self._signals: list[int] = []
        self._ready = False

    def run(self) -> int:
        """Runs until a signal. Returns the exit code: 0, or 1 if a child cannot be started. Call it in the main thread."""
        before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)}
        for number, handler in before.items():
            if handler is not signal.SIG_IGN:  # nohup, or a background job
                signal.signal(number, lambda given, _: self._signals.append(given))
        try:
            for child in self._children:
                self._start(child)
            return self._watch()
        finally:
            self._stop()
            for number, handler in before.items():
                signal.signal(number, handler)

    def _watch(self) -> int:
        patience, next_question = time.monotonic() + PATIENCE_SECONDS, 0.0
        while not self._signals:
            for child in self._children:
                child.end_if_silent()
                code = child.ended()
                if code is not None and not self._signals:
                    name = child.specification.name
                    if not self._ready and child.gave_up >= TRIES_TO_START:
                        log.error("the %s does not start (exit code %d); its messages are above", name, code)
                        return 1
                    pause = max(0.0, child.start_at - time.monotonic())
                    log.warning("the %s ended unexpectedly (exit code %d); it starts again in %.1f s", name, code, pause)
                if child.process is None and time.monotonic() >= child.start_at:
                    self._start(child)
            if not self._ready and time.monotonic() >= next_question:
                missing = self._missing()
                next_question = time.monotonic() + ASK_SECONDS
                if not missing:
                    self._ready = True
                    self._announce()
                elif time.monotonic() >= patience:
                    log.warning("still waiting for %s", ", ".join(missing))
                    patience = time.monotonic() + PATIENCE_SECONDS
            time.sleep(LOOK_SECONDS)
        log.info("stopping (%s)", signal.Signals(self._signals[0]).name)
        return 0

    def _start(self, child: _Child) -> None:
        """Starts a child; after a pause if the machine has no room for a process or a descriptor."""
        try:
            child.start()
        except OSError as error:
            pause = child.pauses.next(0.0, 1)
            child.start_at = time.monotonic() + pause
            log.warning("the %s cannot be started: %s; it is tried again in %.1f s", child.specification.name, error, pause)

    def _stop(self) -> None:
        """Ends the children, by force after GRACE_SECONDS or a second signal."""
        running = [child.process for child in self._children if child.process is not None]
        for process in running:
            process.terminate()
        deadline = time.monotonic() + GRACE_SECONDS + 1.0
        while any(process.poll() is None for process in running) and time.monotonic() < deadline and len(self._signals) < 2:
            time.sleep(0.02)
        for process in running:
            if process.poll() is None:
                end_session(process.pid)
                process.kill()
                process.wait()
