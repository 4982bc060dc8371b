"""Child processes of a session: one at a time, with its descendants, started and ended by a keeper (see `keeper`)."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from drivecal.adapters import files as usage
from drivecal.adapters import keeper
from drivecal.adapters.environment import DRIVER, Scratch, environment
from drivecal.adapters.files import Disk
from drivecal.domain.errors import UnavailableError
from drivecal.domain.evaluations import Breakdown
from drivecal.plugins.simulators import NoMeasuresError, RunOutcome

MOST_THREADS = 4096
MOST_PROCESSES = 256
"""Limits of a child and its descendants; beyond one all are killed.

RLIMIT_NPROC is not used: it counts all processes of the user, so that others' processes would fail the child's, and it does not hold root.
"""
LOOK_SECONDS = 1.0
"""Shortest time between two looks at all processes of the machine for descendants; a look takes 15 microseconds for each process."""
FIRST_LINE = 256
"""Bytes of a script's first line that the system reads."""
REPLY_SECONDS = 30.0
"""Time after which a keeper that does not answer is taken as lost."""


class Children:
    """The children of one session. Not thread-safe."""

    def __init__(
        self, command: Sequence[str], section: Mapping[str, Any], scratch: Scratch, writable: Sequence[str] = ()
    ) -> None:
        """Stores the settings; `start` starts processes.

        Args:
            command: of each child, found among the bundle's files or on PATH.
            section: the manifest's section `simulator`, with the limit of the memory and names of variables that children inherit.
            scratch: the session's folders.
            writable: folders outside of the scratch folder that children may change.
        """
        self._command, self._memory_mb, self._scratch = command, section["memory_mb"], scratch
        self._environment, self._writable = section.get("environment") or (), writable
        self.seed: int | None = None
        """Seed of the next child, if its command depends on one."""
        self._keeper: int | None = None
        self._control: socket.socket | None = None
        self._pid: int | None = None
        self._family: tuple[int, ...] = ()
        self._next_look = 0.0
        self._disk = Disk(scratch.folder, self._memory_mb)
        self._exceeds = self._overflows = False
        """The child exceeds a limit, or a limit of the disk in particular."""
        self._lost_seconds = self._ended_seconds = 0.0
        """CPU time of children of earlier keepers, and of ended children of this keeper."""

    @property
    def control(self) -> int:
        """Descriptor that is readable when the child has ended: then call `ended`."""
        return -1 if self._control is None else self._control.fileno()

    @property
    def family(self) -> tuple[int, ...]:
        """The running child and its known descendants, by their ids."""
        return self._family

    def start(self, stdin: int, stdout: int, stderr: int) -> None:
        """Starts the child with these descriptors.

        Raises UnavailableError if its command cannot be run, and OSError if the machine lacks processes or the scratch folder is gone or
        not to be trusted.
        """
        if self._scratch.is_spoilt:
            raise ChildProcessError(errno.EPERM, "a simulator's keeper was killed", str(self._scratch.work))
        if not self._scratch.work.is_dir():  # removed by its program, or by a keeper that ended: a new session has another
            raise ChildProcessError(errno.ENOENT, "the working directory of a simulator is gone", str(self._scratch.work))
        if self._control is None:
            self._start_keeper()
        reply = None
        if self._control is not None:
            with contextlib.suppress(OSError):
                socket.send_fds(self._control, [keeper.START, str(self.seed or "").encode()], [stdin, stdout, stderr])
                reply = self._reply()
        if reply is None:
            self._lose()
            raise NoMeasuresError(Breakdown.CRASH, "the child's keeper was killed")
        if "error" in reply:
            raise UnavailableError(f"{self._command[0]} cannot be started: {reply['error']}")
        self._pid = int(reply["pid"])
        self._family, self._next_look = (self._pid,), time.monotonic() + LOOK_SECONDS
        self._exceeds = False

    def ended(self) -> int:
        """Waits for the end of the child, whose descendants end with it; returns its return code as in `subprocess`."""
        reply = self._reply()
        if reply is None:
            self._lose()
            return -signal.SIGKILL
        self._pid, self._family = None, ()
        self._ended_seconds = reply["cpu"]
        return int(reply["status"])

    def end(self) -> int | None:
        """Ends the child and its descendants by SIGTERM, then SIGKILL, which comes at once if they exceed a limit. Returns None if no child
        is running."""
        if self._pid is None or self._control is None:
            return None
        try:
            self._control.sendall(keeper.KILL if self._exceeds else keeper.END)
        except OSError:
            self._lose()
            ended = -int(signal.SIGKILL)
        else:
            ended = self.ended()
        if self._overflows and not self._scratch.is_spoilt:
            self._scratch.clear()
            self._overflows = False
        return ended

    def cpu_seconds(self) -> float:
        """Returns the CPU time of all children so far, the living included."""
        total = self._lost_seconds + self._ended_seconds
        for pid in self._family:
            if (process := keeper.seen(pid)) is not None:
                total += process.waited_seconds + _precise_seconds(process)
        return total

    def timed(self, run: Callable[[], RunOutcome]) -> RunOutcome:
        """Returns the outcome of a run, to whose CPU time that of all children during it is added; a NoMeasuresError has it as well."""
        before, queued = self.cpu_seconds(), self._queued_seconds()
        try:
            outcome = run()
        except NoMeasuresError as error:
            detail = self._scratch.shown(error.detail)
            raise NoMeasuresError(error.breakdown, detail, max(self.cpu_seconds() - before, 0.0)) from None
        spent, waited = outcome.cpu_seconds + self.cpu_seconds() - before, self._queued_seconds() - queued
        return replace(outcome, cpu_seconds=max(spent, 0.0), queued_seconds=max(waited, 0.0))

    def _queued_seconds(self) -> float:
        """Returns the time for which the children, and this thread, were ready to run and waited for a core (`schedstat`)."""
        total = 0
        for path in ("/proc/thread-self/schedstat", *(f"/proc/{pid}/schedstat" for pid in self._family)):
            with contextlib.suppress(OSError):
                total += int(Path(path).read_bytes().split()[1])
        return total / 1e9

    def scan(self) -> None:
        """Looks for descendants as `look`, if the last look is long ago compared with its own time."""
        if time.monotonic() >= self._next_look:
            self.look()

    def look(self) -> None:
        """Looks for descendants and their files. Raises NoMeasuresError if these take too much memory or disk, or are too many."""
        if self._keeper is None:
            return
        start = time.thread_time()  # a look that waits for a core costs nothing
        try:
            self._look(self._keeper)
        except NoMeasuresError:
            self._exceeds = True
            raise
        finally:
            self._next_look = time.monotonic() + max(LOOK_SECONDS, 50 * (time.thread_time() - start))

    def _look(self, keeping: int) -> None:
        family = keeper.descendants(keeping)
        self._family = tuple(process.pid for process in family)
        if len(family) > MOST_PROCESSES:
            raise NoMeasuresError(Breakdown.ERROR, f"it runs {len(family):,} processes, more than {MOST_PROCESSES}")
        if (count := sum(process.threads for process in family)) > MOST_THREADS:
            raise NoMeasuresError(Breakdown.ERROR, f"it runs {count:,} threads, more than {MOST_THREADS:,}")
        threads = [process.thread for process in family]
        excess = self._disk.excess(threads)
        if excess is not None:
            self._overflows = True
            raise NoMeasuresError(Breakdown.ERROR, excess)
        try:
            nameless = usage.find_nameless(threads, str(self._scratch.folder), of_every_thread=False)
        except usage.UncountableError as error:
            raise NoMeasuresError(Breakdown.ERROR, str(error)) from None
        files = sum(nameless.in_memory.values())
        if sum(process.resident for process in family) + files >> 20 <= self._memory_mb:
            return
        shares = list(map(keeper.share, family))  # a fork's pages are its parent's as well; this takes longer to read
        mapped = sum(share.of_files for share in shares)
        taken = sum(share.memory for share in shares) + max(files - mapped, 0) >> 20
        if taken > self._memory_mb:
            detail = f"its processes take {taken:,} MB of memory, more than memory_mb: {self._memory_mb:,}"
            raise NoMeasuresError(Breakdown.MEMORY, detail)

    def close(self) -> None:
        """Ends everything. Idempotent."""
        if self._control is not None:
            with contextlib.suppress(OSError):
                self._control.shutdown(socket.SHUT_WR)
                while self._control.recv(65536):  # until the keeper has ended everything
                    pass
                self._keeper = None
            self._lose()

    def _start_keeper(self) -> None:
        ours, theirs = socket.socketpair(type=socket.SOCK_SEQPACKET)  # a message is received as it was sent
        is_ours = tuple(self._command[: len(DRIVER)]) == DRIVER  # PYTHONPATH would bring modules into it
        named = [name for name in self._environment if not (is_ours and name.startswith("PYTHON"))]
        settings = {
            "command": list(self._command),
            "environment": environment(self._scratch.home, named),
            "folder": str(self._scratch.work),
            "scratch": str(self._scratch.folder),
            "memory": self._memory_mb << 20,
            "confinement": self._scratch.confinement(self._writable),
        }
        with theirs:
            begun = subprocess.run(  # noqa: S603  # our own program, which goes on in another process
                [sys.executable, "-I", "-S", keeper.__file__, str(theirs.fileno())],
                input=json.dumps(settings).encode(),
                pass_fds=[theirs.fileno(), self._scratch.lock],
                start_new_session=True,
                cwd="/",
                check=False,
            )
        if begun.returncode:
            ours.close()
            raise OSError(f"the keeper of a simulator does not start (exit code {begun.returncode})")
        ours.settimeout(REPLY_SECONDS)
        self._control = ours
        reply = self._reply()
        if reply is None:
            self._lose()
        else:
            self._keeper = reply["keeper"]

    def _reply(self) -> dict[str, Any] | None:
        """Returns the keeper's next message, None if it is gone."""
        if self._control is None:
            return None
        try:
            received = self._control.recv(65536)
        except OSError:
            return None
        reply: dict[str, Any] | None = json.loads(received) if received else None
        return reply

    def _lose(self) -> None:
        """Forgets the keeper, and kills the rest of a keeper that was killed or does not answer."""
        if self._keeper is not None:
            self._scratch.is_spoilt = True
            self._lost_seconds = self.cpu_seconds()
            for pid in self._family:
                with contextlib.suppress(OSError):
                    os.kill(pid, signal.SIGKILL)
            if self._pid is not None:
                with contextlib.suppress(OSError):
                    os.killpg(self._pid, signal.SIGKILL)
        if self._control is not None:
            if self._keeper is not None and _is_open(self._control):
                os.kill(self._keeper, signal.SIGKILL)  # stopped by its child, perhaps; the number is still its own
            self._control.close()
        self._keeper, self._control, self._pid, self._family, self._ended_seconds = None, None, None, (), 0.0


def _is_open(control: socket.socket) -> bool:
    """Returns whether the keeper has not closed its end, i.e. lives."""
    control.setblocking(False)
    try:
        while control.recv(65536):
            pass
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def check_command(command: Sequence[str], work: Path) -> None:
    """Raises UnavailableError if a command is neither a program of the bundle nor on PATH."""
    program = command[0]
    if "/" not in program:
        if shutil.which(program) is None:
            raise UnavailableError(f"{program} is not on this machine's PATH; a program of the bundle is called ./{program}")
    elif not (work / program).is_file():
        raise UnavailableError(f"the file {program} does not exist")
    elif not os.access(work / program, os.X_OK):
        raise UnavailableError(f"the file {program} is not executable; type: chmod +x {program}")
    elif (fault := _interpreter_fault(work / program)) is not None:
        raise UnavailableError(f"{program} cannot be started: {fault}")


def _interpreter_fault(script: Path) -> str | None:
    """Returns why the first line of a script names no interpreter of this machine; the system's error would name the script itself."""
    try:
        with script.open("rb") as file:
            line = file.read(FIRST_LINE).partition(b"\n")[0]
    except OSError:
        return None
    if not line.startswith(b"#!"):
        return None
    if line.endswith(b"\r"):
        return "its first line ends as on Windows; convert the line ends, e.g. by sed -i 's/\\r$//'"
    interpreter = next(iter(line[2:].decode(errors="replace").split()), "")
    if interpreter.startswith("/") and not Path(interpreter).exists():
        return f"its first line names {interpreter}, which is not on this machine"
    return None


def _precise_seconds(process: keeper.Seen) -> float:
    """Returns the CPU time of a process by its clock, which ticks in nanoseconds (`clock_getcpuclockid`; Linux numbers them so)."""
    try:
        return time.clock_gettime(~process.pid << 3 | 2)
    except OSError:
        return process.own_seconds
