"""The keeper of one session's children: a small program of its own between a worker and a user's simulator.

It starts a child on request, limits it, and ends all its descendants: when the child ends, when the worker asks, or when the worker is
gone. As a subreaper it inherits orphans, including those in sessions of their own, so none is missed. A worker cannot do this itself:
`preexec_fn` is unsafe with threads, the signal of a parent's death follows the starting thread, and orphans would mix with others.

Runs by path, `python -I -S keeper.py FD`, with the standard library and modules that need nothing else. FD is a socket of messages
(SOCK_SEQPACKET): the worker sends `s`, and the child's seed if it has one, with three descriptors (standard input, output, error) for a
start, `t` for an end and `k` for one at once; the keeper answers in JSON, see `Keeper`.
"""

import contextlib
import ctypes
import json
import os
import resource
import select
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

if __name__ == "__main__":  # isolated, without site-packages
    sys.path.append(str(Path(__file__).parents[2]))

from drivecal.adapters.confinement import SHARED_MEMORY, confine, keep_signals, ruleset
from drivecal.adapters.files import remove
from drivecal.adapters.seclusion import Seclusion
from drivecal.adapters.system_calls import hold_to_itself

START, END, KILL = b"s", b"t", b"k"
GRACE_SECONDS = 2.0
"""Longest time between SIGTERM and SIGKILL. It ends with the last process."""
SWEEP_SECONDS = 5.0
"""Time after which processes that cannot be killed are given up."""
LARGEST_FILE = 4 << 30
"""Size limit of each file that a child writes, in bytes."""
MOST_KILLABLE = "1000"
"""The system ends children before workers, servers and databases if the machine's memory runs out."""
IGNORED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""The keeper ends with its worker only."""
_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36


class Seen(NamedTuple):
    """A living process: its parent, CPU time (s) of its own and of children it has waited for, resident memory in bytes, threads.

    `thread`: the number under which /proc shows its memory and files: another than its own once its first thread has ended.
    """

    pid: int
    parent: int
    own_seconds: float
    waited_seconds: float
    resident: int
    threads: int
    thread: int


_TICK = os.sysconf("SC_CLK_TCK")
_PAGE = os.sysconf("SC_PAGESIZE")


def seen(pid: int) -> Seen | None:
    """Returns what /proc says of a process, None if it is gone."""
    fields = _fields(pid)
    if fields is None:
        return None
    own, waited = int(fields[11]) + int(fields[12]), int(fields[13]) + int(fields[14])
    thread, resident = (pid, int(fields[21])) if fields[0] != b"Z" else _of_living_thread(pid)
    return Seen(pid, int(fields[1]), own / _TICK, waited / _TICK, resident * _PAGE, int(fields[17]), thread)


def _fields(pid: int) -> list[bytes] | None:
    """Returns what /proc/PID/stat says after the name of the program."""
    try:
        descriptor = os.open(f"/proc/{pid}/stat", os.O_RDONLY)  # twice in each run, in half the time of an open file
    except OSError:
        return None
    try:
        return os.read(descriptor, 4096).rpartition(b")")[2].split()
    except OSError:
        return None
    finally:
        os.close(descriptor)


def _of_living_thread(pid: int) -> tuple[int, int]:
    """Returns a living thread of a process whose first thread has ended, and the resident pages; the process and 0 if it has none."""
    with contextlib.suppress(OSError):
        for name in os.listdir(f"/proc/{pid}/task"):  # noqa: PTH208  # as below
            fields = _fields(int(name))
            if fields is not None and fields[0] != b"Z":
                return int(name), int(fields[21])
    return pid, 0


class Share(NamedTuple):
    """Memory of a process in bytes, and the part of it that is mapped files in memory and other shared memory."""

    memory: int
    of_files: int


def share(process: Seen) -> Share:
    """Returns the memory of a process, with pages of several processes divided among them; without such pages if /proc reports no share."""
    try:
        lines = Path(f"/proc/{process.thread}/smaps_rollup").read_bytes().splitlines()
    except OSError:
        lines = []
    sizes = {line.split()[0]: int(line.split()[1]) << 10 for line in lines if line.startswith(b"Pss")}
    return Share(sizes.get(b"Pss:", process.resident), sizes.get(b"Pss_Shmem:", 0))


def descendants(root: int) -> list[Seen]:
    """Returns all living descendants of a process, parents first."""
    children: dict[int, list[Seen]] = {}
    for name in os.listdir("/proc"):  # noqa: PTH208  # as often as above
        if name.isdigit() and (process := seen(int(name))) is not None:
            children.setdefault(process.parent, []).append(process)
    family = list(children.get(root, ()))
    for process in family:
        family.extend(children.get(process.pid, ()))
    return family


class Keeper:
    """Serves one session.

    Answers `{"pid": n}` or `{"error": text}` to a start. After each child's end, and that of its descendants, whatever the cause:
    `{"status": n, "cpu": s}` with the return code as in `subprocess`, and the CPU time of all ended processes since the keeper's start.
    """

    def __init__(self, control: socket.socket, settings: dict[str, Any], worker: int) -> None:
        """`settings`: `command`, `environment`, `folder` (working directory), `memory` (bytes of data of each process), and `confinement`:
        the arguments of `ruleset`, or None."""
        self._control, self._settings = control, settings
        rules = settings["confinement"]
        self._seclusion = None if rules is None else Seclusion.make(rules["writable"], settings["memory"])
        self._reaches_its_own_only = rules is not None and _reaches_its_own_only(worker)
        """A signal to all processes reaches the descendants only."""
        own_memory = None if self._seclusion is None else self._seclusion.shared_memory
        self._rules = None if rules is None else ruleset(**rules, shared_memory=own_memory)
        self._shares_memory = own_memory is None and rules is not None and SHARED_MEMORY not in rules["writable"]
        self._library = ctypes.CDLL(None, use_errno=True)
        self._library.prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
        self._child: int | None = None
        self._statuses: dict[int, int] = {}

    def serve(self) -> None:
        """Reports its own number as `{"keeper": n}` and serves until the worker closes the socket or dies."""
        self._say({"keeper": os.getpid()})
        reader, writer = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        control = self._control.fileno()
        while True:
            ready, _, _ = select.select([control, reader], [], [])
            if reader in ready:
                with contextlib.suppress(BlockingIOError):
                    os.read(reader, 4096)
            self._notice()
            if control not in ready:
                continue
            message, descriptors, _, _ = socket.recv_fds(self._control, 32, 3)
            if not message:
                return
            if message.startswith(START):
                self._start(descriptors, message.removeprefix(START).decode())
            elif self._child is not None:
                if message == END:
                    self._ask()
                self._stop(self._child)
                self._report(self._child)

    def finish(self) -> None:
        """Ends the child without a report."""
        if self._child is not None:
            self._ask()
            self._stop(self._child)

    def _say(self, message: dict[str, Any]) -> None:
        self._control.sendall(json.dumps(message).encode())

    def _start(self, descriptors: list[int], seed: str) -> None:
        settings = self._settings
        seeded = {"DRIVECAL_SEED": seed} if seed else {}
        self._statuses.clear()
        try:
            child = subprocess.Popen(  # noqa: S603  # running a user's program is the purpose
                [part.replace("{seed}", seed) for part in settings["command"]] if seed else settings["command"],
                stdin=descriptors[0],
                stdout=descriptors[1],
                stderr=descriptors[2],
                cwd=settings["folder"],
                env=settings["environment"] | seeded,
                start_new_session=True,
                preexec_fn=self._limit,  # noqa: PLW1509  # safe here: this process has one thread
            )
        except (OSError, ValueError, subprocess.SubprocessError) as error:
            self._say({"error": str(error)})
        else:
            child.returncode = 0  # waited for below
            self._child = child.pid
            self._say({"pid": child.pid})
        finally:
            for descriptor in descriptors:
                os.close(descriptor)

    def _limit(self) -> None:
        """Limits the child before its program starts.

        Memory is a limit of data, not of addresses: Java, Go and Node reserve many times the addresses that they use.
        """
        for number in IGNORED:
            signal.signal(number, signal.SIG_DFL)
        self._library.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        with contextlib.suppress(OSError):
            Path("/proc/self/oom_score_adj").write_text(MOST_KILLABLE)
        for limit, value in (
            (resource.RLIMIT_DATA, self._settings["memory"]),
            (resource.RLIMIT_CORE, 0),
            (resource.RLIMIT_FSIZE, LARGEST_FILE),
        ):
            hard = resource.getrlimit(limit)[1]
            value = value if hard == resource.RLIM_INFINITY else min(value, hard)
            resource.setrlimit(limit, (value, value))
        if self._settings["confinement"] is not None:
            if self._seclusion is not None:
                self._seclusion.enter(self._settings["folder"])
            confine(self._rules)
            hold_to_itself(shares_memory=self._shares_memory)

    def _notice(self) -> None:
        """Reaps orphans, and reports the child if it has ended."""
        child = self._child
        if child is None or not _has_ended(child):
            self._reap()
        # The child may have ended since, and be reaped already.
        if child is not None and (child in self._statuses or _has_ended(child)):
            self._stop(child)
            self._report(child)

    def _ask(self) -> None:
        """Asks every process to end, not the child's group alone, which may be a shell before the program. Waits while any lives, for the
        grace at most."""
        self._send(signal.SIGTERM)
        deadline = time.monotonic() + GRACE_SECONDS
        while self._reap() and time.monotonic() < deadline:  # without children of its own a subreaper has no descendants
            time.sleep(0.002)

    def _report(self, child: int) -> None:
        self._child = None
        if self._seclusion is not None:
            self._seclusion.clear()
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        status = self._statuses.pop(child, -signal.SIGKILL)
        self._statuses.clear()
        self._say({"status": status, "cpu": usage.ru_utime + usage.ru_stime})

    def _stop(self, child: int) -> None:
        """Kills the child's group and then every descendant."""
        if child not in self._statuses:
            with contextlib.suppress(OSError):
                os.killpg(child, signal.SIGKILL)  # the child is not reaped yet, so the number is still its own
        deadline = time.monotonic() + SWEEP_SECONDS
        while self._reap():
            self._send(signal.SIGSTOP, signal.SIGKILL)  # stopped first: a parent cannot start another while its child dies
            if time.monotonic() > deadline:
                return
            time.sleep(0.001)

    def _send(self, *numbers: int) -> None:
        """Sends signals to every descendant. If the kernel holds this process to its own, it signals all at once, which no process escapes
        by a fork; else the descendants that a look finds."""
        with contextlib.suppress(OSError):  # a machine without files for a look, which is tried again
            family = [-1] if self._reaches_its_own_only else [process.pid for process in descendants(os.getpid())]
            for number in numbers:
                for process in family:
                    with contextlib.suppress(OSError):
                        os.kill(process, number)

    def _reap(self) -> bool:
        """Waits for ended children; returns whether there are others."""
        while True:
            try:
                pid, status = os.waitpid(-1, os.WNOHANG)
            except ChildProcessError:
                return False
            if pid == 0:
                return True
            self._statuses[pid] = os.waitstatus_to_exitcode(status)


def _reaches_its_own_only(worker: int) -> bool:
    """Holds this process to signals to its descendants. Returns True only if the living worker, which is none, was within reach before and
    is not since: a signal to all processes would end everything of the user otherwise."""

    def reaches_worker() -> bool | None:
        try:
            os.kill(worker, 0)
        except PermissionError:
            return False
        except OSError:
            return None
        return True

    before = reaches_worker()
    return keep_signals() and before is True and reaches_worker() is False


def _has_ended(child: int) -> bool:
    return os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None


def main() -> None:
    """Reads the settings from standard input and serves; removes the scratch folder at the end.

    Serves in a process that is not a child of the worker: Ray kills a worker's children before the keeper could end theirs.
    """
    for number in IGNORED:
        signal.signal(number, signal.SIG_IGN)
    settings = json.load(sys.stdin)
    worker = os.getppid()
    if os.fork():
        os._exit(0)
    keeper = Keeper(socket.socket(fileno=int(sys.argv[1])), settings, worker)
    try:
        keeper.serve()
    except OSError:  # the worker is gone
        pass
    finally:
        with contextlib.suppress(OSError):
            keeper.finish()
        remove(Path(settings["scratch"]))


if __name__ == "__main__":
    main()
