"""The backend on processes of this machine, connected by socket pairs. It needs no other package and starts in a second."""

import errno
import itertools
import os
import queue
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import IO, Any

from drivecal.cluster.machine import cpus
from drivecal.cluster.pulse import Pipe
from drivecal.contracts.work import Batch
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.processes.calls import START, RemoteAnswer, RemoteCall
from drivecal.execution.supervised import CallFailedError, SupervisedBackend, WorkerDiedError, WorkerLimits
from drivecal.execution.worker_process import WorkerProcess

ENDING_SECONDS = 5.0
"""Time limit for the threads of a process that was ended."""


class ConnectedProcess:
    """A running process with its connection, and answers that were not asked for yet, by the number of their call.

    Threads send and receive, so that a process that is stopped, or holds its interpreter for long, delays no other. A call is sent when
    the one before it is answered, and can be taken back until then.
    """

    def __init__(
        self,
        process: subprocess.Popen[bytes],
        connection: Connection,
        pulse: Pipe,
        starts: IO[bytes],
        arrived: threading.Condition,
    ) -> None:
        """`arrived` is notified of answers, and of the end of the process; `pulse` gets its signs of life, `starts` the runs that begin.
        Raises OSError, and ends the process, without room for the threads."""
        self.process, self.pulse, self._starts = process, pulse, starts
        self.answers: dict[int, RemoteAnswer] = {}
        self.ended = False
        self._connection, self._arrived = connection, arrived
        self._calls: queue.SimpleQueue[RemoteCall | None] = queue.SimpleQueue()
        self._begun, self._done, self._recalled = 0, 0, set[int]()
        self._threads = [threading.Thread(target=target, daemon=True) for target in (self._receive_all, self._send_all)]
        try:
            for thread in self._threads:
                thread.start()
        except RuntimeError as error:  # the limit of processes counts threads
            process.kill()
            process.wait()
            raise OSError(errno.EAGAIN, str(error)) from error

    def send(self, call: RemoteCall) -> None:
        """Sends a call after those before it."""
        self._calls.put(call)

    def recall(self, number: int) -> bool:
        """Takes a call back; returns whether it was not sent yet."""
        with self._arrived:
            self._recalled |= {number} if number > self._begun else set()
            return number > self._begun

    def starts(self, number: int) -> Mapping[int, int]:
        """Returns how many runs a call began, by cell. The process forgets them when it begins its next call."""
        content = os.pread(self._starts.fileno(), os.fstat(self._starts.fileno()).st_size, 0)
        return Counter(cell for begun_by, cell in START.iter_unpack(content) if begun_by == number)

    def end(self) -> None:
        """Ends the process, whatever it does."""
        self.process.kill()
        self.process.wait()
        self._calls.put(None)
        for thread in self._threads:
            thread.join(ENDING_SECONDS)
        for held in (self._connection, self.pulse, self._starts):
            held.close()

    def _send_all(self) -> None:
        with suppress(OSError):  # the end of the process is noticed by the other thread
            while (call := self._calls.get()) is not None:
                with self._arrived:
                    self._arrived.wait_for(lambda: self.ended or self._done == self._begun)
                    if call.number in self._recalled:
                        continue
                    self._begun = call.number or self._begun
                self._connection.send(call)

    def _receive_all(self) -> None:
        try:
            while True:
                answer: RemoteAnswer = self._connection.recv()
                with self._arrived:
                    self.answers[answer.number], self._done = answer, answer.number
                    self._arrived.notify_all()
        except Exception:  # noqa: BLE001  # the end of the connection, or an answer that cannot be read: no further one can be, either
            with self._arrived:
                self.ended = True
                self._arrived.notify_all()


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
        self._arrived = threading.Condition()
        self._numbers = itertools.count(1)
        for _ in range(limits.workers or cpus()):
            self._hire(None)

    def _launch(self, worker: WorkerProcess) -> None:
        with ExitStack() as opened:
            ours, theirs = map(opened.enter_context, socket.socketpair())
            pulse, starts = opened.enter_context(closing(Pipe())), opened.enter_context(tempfile.TemporaryFile())
            kept = [theirs.fileno(), pulse.writer, starts.fileno()]
            command = [sys.executable, "-P", "-m", "drivecal.execution.processes.child", *map(str, kept), worker.name]
            process = subprocess.Popen(command, stdin=subprocess.DEVNULL, pass_fds=kept)  # noqa: S603  # our own module
            worker.handle = ConnectedProcess(process, Connection(ours.detach()), pulse, starts, self._arrived)
            opened.pop_all()
        theirs.close()
        worker.warming = self._call(worker.handle, "warm", self._trial)

    def _send(self, worker: WorkerProcess, batch: Batch) -> SentCall:
        return self._call(worker.handle, "run", batch)

    def _store(self, worker: WorkerProcess, bundle: str, archive: bytes) -> None:
        worker.handle.send(RemoteCall(0, "store", (bundle, archive)))

    def _call(self, child: ConnectedProcess, method: str, *arguments: Any) -> SentCall:
        reference = SentCall(child, next(self._numbers))
        child.send(RemoteCall(reference.number, method, arguments))
        return reference

    def _recall(self, reference: SentCall) -> bool:
        return reference.child.recall(reference.number)

    def _is_silent(self, worker: WorkerProcess) -> bool:
        return bool(worker.handle.pulse.is_silent())

    def _starts_of(self, reference: SentCall) -> Mapping[int, int]:
        return reference.child.starts(reference.number)

    def _end(self, worker: WorkerProcess) -> None:
        worker.handle.end()

    def _answered(self, references: Sequence[SentCall], timeout: float) -> Collection[SentCall]:
        with self._arrived:
            self._arrived.wait_for(lambda: any(map(_is_done, references)), timeout)
            return [reference for reference in references if _is_done(reference)]

    def _value(self, worker: WorkerProcess) -> Any:
        reference: SentCall = worker.waited_for
        answer = reference.child.answers.pop(reference.number, None)
        if answer is None:
            raise _cause(reference.child.process)
        if answer.error is not None:
            raise CallFailedError(answer.error)
        return answer.value


def _is_done(reference: SentCall) -> bool:
    return reference.number in reference.child.answers or reference.child.ended


_FROM_OUTSIDE = {signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP}
"""Signals that no crash of a program sends to itself."""


def _cause(process: subprocess.Popen[bytes]) -> WorkerDiedError:
    """Returns why a process ended, which has closed its connection."""
    try:
        code = process.wait(timeout=1.0)
    except subprocess.TimeoutExpired:
        return WorkerDiedError(Breakdown.CRASH, "closed its connection")
    if code >= 0:
        return WorkerDiedError(Breakdown.CRASH, f"ended with exit code {code}")
    number = -code
    name = signal.Signals(number).name if number in set(signal.Signals) else f"signal {number}"
    return WorkerDiedError(Breakdown.CRASH, f"died of {name}", departed=number in _FROM_OUTSIDE)
