"""Common part of backends with worker processes: calls, deadlines, and the replacement of workers that crash, hang or do not start.

A backend starts, asks and ends processes; everything is decided here. Each worker has at most two calls, so that it never waits for the
next. Nothing is retried: lost workers are replaced here, and the scheduler handles their batches.
"""

import itertools
import logging
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from drivecal.cluster.members import Node
from drivecal.contracts.work import Batch, BatchResult
from drivecal.domain.errors import DrivecalError
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.backend import (
    DEADLINE_FACTOR,
    DEADLINE_SECONDS,
    LONGEST_QUEUED,
    SETTLE_SECONDS,
    Backend,
    BackendLostError,
    Finished,
    Lost,
    Slot,
    WorkerInfo,
)
from drivecal.execution.worker_process import Call, WorkerProcess
from drivecal.plugins.simulators import END_SECONDS, MOST_SESSIONS, probe_limit, start_limit

TRIES_TO_START = 3
"""Attempts without a started worker after which a backend is given up, because a new process may succeed, unless it `waits_for_workers`."""
MOST_DOUBLINGS = 3
"""How often the limit of a start is doubled at most. Kernels are cached as they are compiled, so that each start gets further."""
LONGEST_REASON = 600
"""Characters of a reason."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class WorkerLimits:
    """`workers`: None is one per CPU. A batch is ended as hung after `deadline_seconds` and DEADLINE_FACTOR times its expected time, a
    worker after `start_seconds`, compiling included; after each failed start it gets twice as long, up to MOST_DOUBLINGS times."""

    workers: int | None = None
    deadline_seconds: float = DEADLINE_SECONDS
    start_seconds: float = 600.0
    archive: Callable[[str], bytes] | None = None
    """Returns the archive of a problem bundle by its digest; None: no bundle is ever run."""


class WorkerDiedError(DrivecalError):
    """A worker's process is gone."""

    def __init__(self, breakdown: Breakdown, reason: str, *, departed: bool = False) -> None:
        """`reason` completes a sentence about the worker. `departed`: nothing says that it died of its work."""
        super().__init__(breakdown, reason, departed)
        self.breakdown, self.reason, self.departed = breakdown, reason, departed


class CallFailedError(DrivecalError):
    """A worker lives, but its call raised, or the answer could not be transferred."""


class NotKnownYetError(DrivecalError):
    """A worker seems to be dead, and it is not known yet whether it died by itself."""


class SupervisedBackend(Backend, ABC):
    """A `Backend` on worker processes. Subclasses start them, call them, and end them."""

    settle_seconds = SETTLE_SECONDS
    """Longest time that runs may go on after their worker is gone."""
    waits_for_workers = False
    """True if it waits without end for workers that do not start."""

    def __init__(self, limits: WorkerLimits) -> None:
        self._limits = limits
        self._indices = itertools.count(1)
        self._workers: list[WorkerProcess] = []

    @abstractmethod
    def _launch(self, worker: WorkerProcess) -> None:
        """Starts a process and its trial: sets `handle` and `warming`. Raises OSError if the machine has no room for it."""

    @abstractmethod
    def _send(self, worker: WorkerProcess, batch: Batch) -> Any:
        """Sends a batch; returns a reference to its answer."""

    @abstractmethod
    def _store(self, worker: WorkerProcess, bundle: str, archive: bytes) -> None:
        """Sends a bundle's files. A worker's calls run in order, so that they are there for the next batch."""

    @abstractmethod
    def _end(self, worker: WorkerProcess) -> None:
        """Ends a worker's process, whatever it does."""

    @abstractmethod
    def _answered(self, references: Sequence[Any], timeout: float) -> Collection[Any]:
        """Waits for the first answer or death at most `timeout` seconds; returns all references that have one."""

    @abstractmethod
    def _value(self, worker: WorkerProcess) -> Any:
        """Returns the answer of a worker's running call. Raises WorkerDiedError, CallFailedError or NotKnownYetError."""

    def _is_silent(self, worker: WorkerProcess) -> bool:  # noqa: ARG002  # subclasses look at the call
        """Returns whether the process of a started worker has shown no sign of life for long, see `cluster.pulse`."""
        return False

    def _starts_of(self, reference: Any) -> Mapping[int, int] | None:  # noqa: ARG002  # subclasses look at the call
        """Returns the starts of the simulator in a call whose worker is gone, see `Lost`."""
        return None

    def _recall(self, reference: Any) -> bool:  # noqa: ARG002  # subclasses look at the call
        """Takes a call back that waits behind another one; returns whether it will not begin. Ray tells so only when it would begin."""
        return False

    def _changes(self) -> list[Finished | Lost]:
        """Follows the machines of the cluster; returns the lost batches of machines that are gone. Raises BackendLostError."""
        return []

    def _lost_with_machine(self, worker: WorkerProcess) -> list[Finished | Lost] | None:  # noqa: ARG002  # subclasses look at the call
        """Returns the lost batches of a worker whose machine is gone, and forgets it; None if the machine is there."""
        return None

    def _complaints(self) -> list[str | None]:
        """Returns reasons for missing workers, except the workers' own."""
        return []

    def submit(self, worker: str, batch_id: int, batch: Batch, expected_seconds: float | None, *, alone: bool = False) -> None:
        chosen = self._named(worker)
        if not chosen.room(alone=alone):
            raise RuntimeError(f"{worker} has no slot; ask `slots` first")
        allowed = max(self._limits.deadline_seconds + _limits_of_simulators(batch), DEADLINE_FACTOR * (expected_seconds or 0.0))
        self._ship(chosen, batch.setup.bundle)
        unknown = 0.0 if batch.setup.timeout is None else math.inf
        expected = unknown if expected_seconds is None else expected_seconds
        call = Call(batch_id, len(batch.cells), batch.setup.scenario, self._send(chosen, batch), allowed, expected)
        chosen.take(call, alone=alone)

    def _ship(self, worker: WorkerProcess, bundle: str | None) -> None:
        """Sends a bundle's files to a worker that has not got them."""
        if bundle is None or bundle in worker.bundles or self._limits.archive is None:
            return
        try:
            self._store(worker, bundle, self._limits.archive(bundle))
        except DrivecalError as error:
            log.warning("the files of %s cannot be read, so %s refuses its cells for now: %s", bundle, worker.place, error)
            return
        worker.bundles.add(bundle)

    def wait(self, timeout: float) -> list[Finished | Lost]:
        until = time.monotonic() + timeout
        events: list[Finished | Lost] = []
        while not events:
            events += self._changes()
            now = time.monotonic()
            for worker in self._workers:
                if worker.handle is None and worker.start_again_at <= now:
                    self._start(worker)
            events += self._collect(max(0.0, min(until, self._next_deadline()) - now))
            events += self._take_back()
            events += self._overdue(time.monotonic())
            events += self._bury_silent()
            if not self.waits_for_workers and all(worker.failed_starts >= TRIES_TO_START for worker in self._workers):
                raise BackendLostError(f"no worker starts: {self._workers[0].reason}")
            if time.monotonic() >= until:
                break
        return events

    def slots(self) -> list[Slot]:
        # `submit` looks at `room` alone: what is offered stays, even if the run takes too long meanwhile
        offered = (each for each in self._workers if each.room(alone=False) and each.busy_seconds() <= LONGEST_QUEUED)
        slots = [Slot(worker.name, not worker.calls) for worker in offered]
        return sorted(slots, key=lambda slot: not slot.idle)

    def workers(self) -> list[WorkerInfo]:
        return [WorkerInfo.of(worker, id=worker.name) for worker in self._workers]

    def replace(self, worker: str, fault: str | None) -> None:
        chosen = self._named(worker)
        if not chosen.room(alone=True):
            raise RuntimeError(f"{worker} is not idle")
        log.warning("%s is replaced: %s", chosen.place, fault or "another one is to have a look")
        if fault is not None:
            chosen.faults += 1
            chosen.reason = f"{chosen.place} was replaced: {fault}"
            chosen.pause(chosen.faults - 1)
        self._begin_anew(chosen)

    def trouble(self) -> str | None:
        starting = [worker for worker in self._workers if worker.failed_starts]
        failing = [worker for worker in self._workers if worker.faults and not worker.failed_starts]
        complaints = self._complaints()
        complaints += [
            f"{len(members)} of {len(self._workers)} workers {words}: {members[0].reason}"
            for members, words in ((starting, "do not start"), (failing, "give no results"))
            if members
        ]
        return "; ".join(filter(None, complaints)) or None

    def close(self) -> None:
        for worker in self._workers:
            self._kill(worker)

    def _hire(self, home: Node | None) -> None:
        worker = WorkerProcess(next(self._indices), home, node="" if home is None else home.name)
        self._workers.append(worker)
        self._start(worker)

    def _start(self, worker: WorkerProcess) -> None:
        worker.incarnation += 1
        worker.bundles.clear()
        worker.recent.clear()
        try:
            self._launch(worker)
        except OSError as error:  # no room for a process, a file or a descriptor: another process of ours would get none either
            worker.handle = worker.warming = None
            worker.reason = f"{worker.place} cannot be started: {error}"
            if not worker.failed_starts:
                log.warning("%s; it is tried again", worker.reason)
            worker.failed_starts = min(worker.failed_starts + 1, TRIES_TO_START - 1)
            worker.pause(TRIES_TO_START)
            return
        worker.deadline = time.monotonic() + self._allowed_to_start(worker)

    def _allowed_to_start(self, worker: WorkerProcess) -> float:
        """Returns how long the present start may take (s)."""
        return self._limits.start_seconds * 2.0 ** min(worker.failed_starts, MOST_DOUBLINGS)

    def _collect(self, timeout: float) -> list[Finished | Lost]:
        """Waits for the first answer of running calls, and returns all answers."""
        waiting = {worker.waited_for: worker for worker in self._workers if worker.waited_for is not None}
        if not waiting:
            time.sleep(timeout)
            return []
        done = self._answered(list(waiting), timeout)
        events = [event for reference in done for event in self._answer(waiting[reference])]
        if done and not events:
            time.sleep(min(timeout, 0.02))  # an unconfirmed death is reported again at once
        return events

    def _answer(self, worker: WorkerProcess) -> list[Finished | Lost]:
        """Returns the answer of a worker's running call."""
        try:
            value = self._value(worker)
        except NotKnownYetError:
            return []
        except WorkerDiedError as error:
            return self._bury(worker, error.breakdown, f"{worker.place} {error.reason}", error, departed=error.departed)
        except CallFailedError as error:
            words = (str(error).strip() or "it failed without a reason").splitlines()[-1][:LONGEST_REASON]
            if worker.warming is not None:
                return self._bury(worker, Breakdown.ERROR, f"{worker.place} cannot start: {words}", error)
            seconds = worker.busy_seconds()
            return [Lost(worker.next_call().batch_id, worker.name, Breakdown.ERROR, words, seconds)]
        if worker.warming is not None:
            worker.started(value.node, value.pid)
            return []
        call = worker.next_call()
        worker.cells += call.cells
        result: BatchResult = value
        if result.results:
            worker.recent.append((len(result.results), result.seconds))
        if any(answer.breakdown is None for answer in result.results):
            worker.faults, worker.reason = 0, ""
        if result.refusal is not None:
            worker.bundles.clear()  # its cache may have lost them
        return [Finished(call.batch_id, result)]

    def _overdue(self, now: float) -> list[Finished | Lost]:
        events: list[Finished | Lost] = []
        for worker in tuple(self._workers):
            if worker.deadline > now or worker.waited_for is None:
                continue
            detail = f"{worker.place} was not ready after {self._allowed_to_start(worker):.0f} s"
            if worker.warming is None:
                detail = f"{worker.place} was ended after {worker.calls[0].seconds:.0f} s in one batch"
            events += self._bury(worker, Breakdown.HANG, detail, None)
        return events

    def _bury_silent(self) -> list[Finished | Lost]:
        """Replaces workers that are stopped or hang as a whole, long before the deadline of their batch."""
        events: list[Finished | Lost] = []
        for worker in tuple(self._workers):
            if worker.ready and self._is_silent(worker):
                detail = f"{worker.place} showed no sign of life"
                worker.faults, worker.reason = worker.faults + bool(worker.calls), f"{detail} and was replaced"
                events += self._bury(worker, Breakdown.HANG, detail, None)
        return events

    def _take_back(self) -> list[Finished | Lost]:
        """Takes back the batches behind runs that take longer than expected: another worker may begin them sooner."""
        return [
            Lost(worker.calls.pop().batch_id, worker.name, Breakdown.ERROR, "taken back", 0.0, begun=False)
            for worker in self._workers
            if len(worker.calls) > 1 and worker.busy_seconds() > LONGEST_QUEUED and self._recall(worker.calls[1].reference)
        ]

    def _bury(
        self, worker: WorkerProcess, breakdown: Breakdown, detail: str, cause: BaseException | None, *, departed: bool = False
    ) -> list[Finished | Lost]:
        """Returns a worker's batches as lost and starts a new process, after a pause if the start failed."""
        lost_with_machine = self._lost_with_machine(worker)
        if lost_with_machine is not None:
            return lost_with_machine
        log.warning("%s; it is replaced", detail, exc_info=cause if log.isEnabledFor(logging.DEBUG) else None)
        starts = self._starts_of(worker.calls[0].reference) if worker.calls else None
        lost: list[Finished | Lost] = list(worker.lose(breakdown, detail, departed=departed))
        lost[:1] = [replace(running, starts=starts) for running in lost[:1] if isinstance(running, Lost)]
        if worker.warming is not None:
            worker.failed_starts += 1
            worker.reason = detail
            worker.pause(worker.failed_starts)
        self._begin_anew(worker)
        return lost

    def _begin_anew(self, worker: WorkerProcess) -> None:
        self._kill(worker)
        worker.warming = worker.pid = worker.died_at = None
        if worker.start_again_at <= time.monotonic():
            self._start(worker)

    def _named(self, name: str) -> WorkerProcess:
        return next(candidate for candidate in self._workers if candidate.name == name)

    def _kill(self, worker: WorkerProcess) -> None:
        if worker.handle is not None:
            self._end(worker)
            worker.handle = None

    def _next_deadline(self) -> float:
        deadlines = [worker.deadline for worker in self._workers if worker.waited_for is not None]
        starts = [worker.start_again_at for worker in self._workers if worker.handle is None]
        return min(deadlines + starts, default=float("inf"))


def _limits_of_simulators(batch: Batch) -> float:
    """Returns how long a user's simulator may take for a batch (s): it ends its probe, two starts and its runs itself. A run that hangs
    costs a start as well, and each end of a simulation END_SECONDS at most."""
    if batch.closes:
        return 0.0
    timeout, asks = batch.setup.timeout, not batch.cells or batch.setup.tools is not None
    probe = probe_limit(batch.setup.simulator) if asks else 0.0
    if timeout is None or not batch.cells:
        return probe
    starts = 2 * start_limit(timeout) + MOST_SESSIONS * END_SECONDS
    return probe + starts + (2 * timeout + END_SECONDS) * len(batch.cells)
