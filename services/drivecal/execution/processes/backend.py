"""The backend on processes of this machine, connected by socket pairs. It needs no other package and starts in a second."""

import itertools
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from typing import Any

from drivecal.contracts.work import Batch
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.processes.calls import RemoteAnswer, RemoteCall
from drivecal.execution.supervised import CallFailedError, SupervisedBackend, WorkerDiedError, WorkerLimits
from drivecal.execution.worker_process import WorkerProcess


@dataclass(slots=True)
class ConnectedProcess:
    """A running process, the coordinator's end of its connection, and answers that were not asked for yet, by the number of their call."""

    process: subprocess.Popen[bytes]
    connection: Connection
    answers: dict[int, RemoteAnswer] = field(default_factory=dict)
    ended: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class SentCall:
    """A call that was sent to a process."""

    child: ConnectedProcess
    number: int


class ProcessBackend(SupervisedBackend):
    """A `Backend` on this machine. Workers end with the process that made the backend, however it ends."""

    def __init__(self, limits: WorkerLimits, trial: Batch) -> None:
        """Starts the workers without waiting for them; each runs `trial` before it is ready."""
        super().__init__(limits)
        self._trial = trial
        self._numbers = itertools.count(1)
        for _ in range(limits.workers or _cpus()):
            self._hire(None)

    def _launch(self, worker: WorkerProcess) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            descriptor = theirs.fileno()
            arguments = [str(descriptor), worker.name, str(self._limits.certificates_mb or 0)]
            command = [sys.executable, "-m", "drivecal.execution.processes.child", *arguments]
            process = subprocess.Popen(command, stdin=subprocess.DEVNULL, pass_fds=[descriptor])  # noqa: S603  # our own module
        worker.handle = ConnectedProcess(process, Connection(ours.detach()))
        worker.warming = self._call(worker.handle, "warm", self._trial)

    def _send(self, worker: WorkerProcess, batch: Batch) -> SentCall:
        return self._call(worker.handle, "run", batch)

    def _store(self, worker: WorkerProcess, bundle: str, archive: bytes) -> None:
        _send(worker.handle, RemoteCall(0, "store", (bundle, archive)))

    def _call(self, child: ConnectedProcess, method: str, *arguments: Any) -> SentCall:
        reference = SentCall(child, next(self._numbers))
        _send(child, RemoteCall(reference.number, method, arguments))
        return reference

    def _end(self, worker: WorkerProcess) -> None:
        child: ConnectedProcess = worker.handle
        child.connection.close()
        child.process.kill()
        child.process.wait()

    def _answered(self, references: Sequence[SentCall], timeout: float) -> Collection[SentCall]:
        done = [reference for reference in references if _is_done(reference)]
        ready = wait(
            [reference.child.connection for reference in references if reference not in done], 0.0 if done else timeout
        )
        for reference in references:
            if reference.child.connection in ready:
                _read(reference.child)
        return [reference for reference in references if _is_done(reference)]

    def _value(self, worker: WorkerProcess) -> Any:
        reference: SentCall = worker.waited_for
        answer = reference.child.answers.pop(reference.number, None)
        if answer is None:
            raise WorkerDiedError(*_cause(reference.child.process))
        if answer.error is not None:
            raise CallFailedError(answer.error)
        return answer.value


def _cpus() -> int:
    """Returns the number of CPUs that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _send(child: ConnectedProcess, call: RemoteCall) -> None:
    with suppress(OSError):  # a dead process is noticed when it is waited for
        child.connection.send(call)


def _is_done(reference: SentCall) -> bool:
    return reference.number in reference.child.answers or reference.child.ended


def _read(child: ConnectedProcess) -> None:
    """Reads what a process has sent; notices its end."""
    try:
        while child.connection.poll():
            answer: RemoteAnswer = child.connection.recv()
            child.answers[answer.number] = answer
    except (EOFError, OSError):
        child.ended = True


def _cause(process: subprocess.Popen[bytes]) -> tuple[Breakdown, str]:
    """Returns why a process ended, which has closed its connection."""
    try:
        code = process.wait(timeout=1.0)
    except subprocess.TimeoutExpired:
        return Breakdown.CRASH, "closed its connection"
    if code >= 0:
        return Breakdown.CRASH, f"ended with exit code {code}"
    number = -code
    name = signal.Signals(number).name if number in set(signal.Signals) else f"signal {number}"
    return Breakdown.CRASH, f"died of {name}"
