"""The backend on Ray actors, and the coordinator's only bridge to `drivecal.runtime`.

Ray restarts and retries nothing here: an actor that is lost is replaced, and the scheduler decides what becomes of its batches. Each
actor has at most two calls, so that it never waits for the next one.
"""

from __future__ import annotations

import itertools
import logging
import time
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any

from drivecal.cluster.members import Node
from drivecal.contracts.work import Batch, BatchResult
from drivecal.domain.errors import DrivecalError
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.backend import (
    DEADLINE_FACTOR,
    DEADLINE_SECONDS,
    BackendLostError,
    Finished,
    Lost,
    Slot,
    WorkerInfo,
)
from drivecal.execution.placement import complaint, missing
from drivecal.execution.ray_cluster import Cluster
from drivecal.runtime.worker import Worker

CALLS_PER_ACTOR = 2
LONGEST_PAUSE = 30.0
"""Between two attempts to start a worker that does not start, s."""
TRIES_TO_START = 3
"""When no worker at all has started in so many attempts, a local Ray is given up: with a new process it may go better. The nodes of a
cluster are not ours to mend; they are waited for."""
LONGEST_REASON = 600
"""Characters."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class RayOptions:
    """`address` of a cluster, None starts a local Ray; `workers`: None is one per CPU, of all nodes that are there.

    A batch that takes longer than `deadline_seconds` and longer than `deadline_factor` times what was expected is ended as hung, and so is
    a worker that takes longer than `start_seconds` to start, which includes compiling."""

    address: str | None = None
    workers: int | None = None
    deadline_seconds: float = DEADLINE_SECONDS
    deadline_factor: float = DEADLINE_FACTOR
    start_seconds: float = 180.0
    certificates_mb: int | None = None
    """Memory of each worker for what certifies other runs; None: what its machine has for it."""


@dataclass(slots=True)
class _Call:
    batch_id: int
    cells: int
    reference: Any
    seconds: float
    """Allowed."""


@dataclass(slots=True)
class _Actor:
    index: int
    home: Node | None = None
    """Where it belongs; None in a local Ray."""
    incarnation: int = 0
    handle: Any = None
    warming: Any = None
    """Reference to the call of `warm`; None once it has answered."""
    calls: deque[_Call] = field(default_factory=deque)
    alone: bool = False
    deadline: float = 0.0
    """Of the first call, or of the start."""
    died_at: float | None = None
    """When its death was noticed, until it is known whether Ray as a whole has died."""
    start_again_at: float = 0.0
    failed_starts: int = 0
    faults: int = 0
    """Replacements since the last result."""
    reason: str = ""
    """What was wrong at last; empty once it has started, or given a result after a fault."""
    node: str = ""
    pid: int | None = None
    cells: int = 0

    @property
    def name(self) -> str:
        return f"worker-{self.index}" if self.incarnation <= 1 else f"worker-{self.index}.{self.incarnation}"

    def pause(self, times: int) -> None:
        """Starts again later the more often it went wrong: at once after no time, then after 1, 2, 4 ... seconds."""
        self.start_again_at = time.monotonic() + (min(LONGEST_PAUSE, 2.0 ** (times - 1)) if times else 0.0)

    @property
    def ready(self) -> bool:
        return self.handle is not None and self.warming is None

    @property
    def state(self) -> str:
        return "starting" if not self.ready else "busy" if self.calls else "idle"

    def room(self, *, alone: bool) -> bool:
        if not self.ready:
            return False
        return not self.calls or (not alone and not self.alone and len(self.calls) < CALLS_PER_ACTOR)


class RayBackend:
    """See `Backend`. One per process. To be made, used and closed by the main thread."""

    def __init__(self, options: RayOptions, trial: Batch) -> None:
        """Starts or joins Ray and starts the workers, without waiting for them; each has to run `trial` before it counts as ready.

        Raises UnavailableError where there is no Ray."""
        self._options = options
        self._cluster = Cluster(options.address, options.workers)
        self._ray = self._cluster.ray
        self._actor_class = self._ray.remote(num_cpus=1, max_restarts=0, max_task_retries=0)(Worker)
        self._trial = trial
        self._version = version("drivecal")
        self._nodes: tuple[Node, ...] = ()
        self._indices = itertools.count(1)
        self._actors: list[_Actor] = []
        if options.address is None:
            for _ in range(options.workers or max(1, self._cluster.cpus())):
                self._hire(None)
        else:
            self._follow_nodes()

    def submit(self, worker: str, batch_id: int, batch: Batch, expected_seconds: float | None, *, alone: bool = False) -> None:
        """See `Backend`."""
        actor = self._named(worker)
        if not actor.room(alone=alone):
            raise RuntimeError(f"{worker} has no slot; ask `slots` first")
        allowed = max(self._options.deadline_seconds, self._options.deadline_factor * (expected_seconds or 0.0))
        actor.calls.append(_Call(batch_id, len(batch.cells), actor.handle.run.remote(batch), allowed))
        actor.alone = alone
        if len(actor.calls) == 1:
            actor.deadline = time.monotonic() + allowed

    def wait(self, timeout: float) -> list[Finished | Lost]:
        """See `Backend`."""
        until = time.monotonic() + timeout
        events: list[Finished | Lost] = []
        while not events:
            self._cluster.check()
            events += self._follow_nodes()
            now = time.monotonic()
            for actor in self._actors:
                if actor.handle is None and actor.start_again_at <= now:
                    self._start(actor)
            events += self._collect(max(0.0, min(until, self._next_deadline()) - now))
            events += self._overdue(time.monotonic())
            if not self._options.address and all(actor.failed_starts >= TRIES_TO_START for actor in self._actors):
                raise BackendLostError(f"no worker starts: {self._actors[0].reason}")
            if time.monotonic() >= until:
                break
        return events

    def slots(self) -> list[Slot]:
        """See `Backend`."""
        found = [Slot(actor.name, not actor.calls) for actor in self._actors if actor.room(alone=False)]
        return sorted(found, key=lambda slot: not slot.idle)

    def workers(self) -> list[WorkerInfo]:
        """See `Backend`."""
        return [WorkerInfo(actor.name, actor.node, actor.pid, actor.state, actor.cells) for actor in self._actors]

    def replace(self, worker: str, fault: str | None) -> None:
        """See `Backend`."""
        actor = self._named(worker)
        if not actor.room(alone=True):
            raise RuntimeError(f"{worker} is not idle")
        log.warning("%s is replaced: %s", _place(actor), fault or "another one is to have a look")
        if fault is not None:
            actor.faults += 1
            actor.reason = f"{_place(actor)} was replaced: {fault}"
            actor.pause(actor.faults - 1)
        self._begin_anew(actor)

    def trouble(self) -> str | None:
        """See `Backend`."""
        starting = [actor for actor in self._actors if actor.failed_starts]
        failing = [actor for actor in self._actors if actor.faults and not actor.failed_starts]
        found = [self._cluster.trouble()]
        if self._options.address is not None:
            found.append(complaint(self._nodes, self._version, self._cluster.name))
        found += [
            f"{len(actors)} of {len(self._actors)} workers {words}: {actors[0].reason}"
            for actors, words in ((starting, "do not start"), (failing, "give no results"))
            if actors
        ]
        return "; ".join(filter(None, found)) or None

    def close(self) -> None:
        """See `Backend`."""
        for actor in self._actors:
            self._kill(actor)
        self._cluster.close()

    def _follow_nodes(self) -> list[Finished | Lost]:
        """Workers on nodes that have come; what workers had whose nodes have gone is lost, and so are they."""
        if self._nodes is self._cluster.nodes:
            return []
        before, self._nodes = self._nodes, self._cluster.nodes
        there = {node.id for node in self._nodes}
        events = [event for actor in self._gone(there) for event in self._dismiss(actor)]
        for node in missing(self._nodes, self._homes(), self._options.workers, self._version):
            self._hire(node)
        for node in sorted(set(before) - set(self._nodes)):
            if node.cpus:
                log.warning("node %s is gone (%d CPUs); its cells go elsewhere", node.name, node.cpus)
        for node in sorted(set(self._nodes) - set(before)):
            if node.cpus:
                log.info("node %s is there: %d CPUs, drivecal %s", node.name, node.cpus, node.version or "unknown")
        return events

    def _homes(self) -> list[str]:
        return [actor.home.id for actor in self._actors if actor.home is not None]

    def _gone(self, there: Collection[str]) -> list[_Actor]:
        return [actor for actor in self._actors if actor.home is not None and actor.home.id not in there]

    def _hire(self, home: Node | None) -> None:
        actor = _Actor(next(self._indices), home, node="" if home is None else home.name)
        self._actors.append(actor)
        self._start(actor)

    def _dismiss(self, actor: _Actor) -> list[Finished | Lost]:
        """A worker whose node is gone; it may have been the worker that took the node along, so its cells are blamed as by a crash."""
        events = self._lose(actor, Breakdown.CRASH, f"{_place(actor)} went with its node")
        self._kill(actor)
        self._actors.remove(actor)
        return events

    def _start(self, actor: _Actor) -> None:
        actor.incarnation += 1
        actor.handle = self._actor_class.options(**self._bound_to(actor.home)).remote(
            actor.name, certificates_mb=self._options.certificates_mb
        )
        actor.warming = actor.handle.warm.remote(self._trial)
        actor.deadline = time.monotonic() + self._options.start_seconds

    def _collect(self, timeout: float) -> list[Finished | Lost]:
        """What came back from the calls that are running; waits for the first of them."""
        waiting = {
            actor.warming or actor.calls[0].reference: actor
            for actor in self._actors
            if actor.warming is not None or actor.calls
        }
        if not waiting:
            time.sleep(timeout)
            return []
        references = list(waiting)
        done, _ = self._ray.wait(references, num_returns=1, timeout=timeout, fetch_local=False)
        if done and len(references) > 1:
            done, _ = self._ray.wait(references, num_returns=len(references), timeout=0, fetch_local=False)
        events = [event for reference in done for event in self._answer(waiting[reference])]
        if done and not events:
            time.sleep(min(timeout, 0.02))  # a death that is not settled yet comes back at once
        return events

    def _answer(self, actor: _Actor) -> list[Finished | Lost]:
        """The answer of an actor whose running call has one."""
        errors = self._ray.exceptions
        reference = actor.warming or actor.calls[0].reference
        try:
            value = self._ray.get(reference)
        except errors.OutOfMemoryError as error:
            return self._bury(actor, Breakdown.MEMORY, f"{_place(actor)} was ended because its node ran out of memory", error)
        except errors.RayActorError as error:
            if not self._is_to_blame(actor):
                return []
            if "low on memory" in str(error):
                return self._bury(
                    actor, Breakdown.MEMORY, f"{_place(actor)} was ended because its node ran out of memory", error
                )
            return self._bury(actor, Breakdown.CRASH, f"{_place(actor)} died, as after a segmentation fault or a kill", error)
        except (
            errors.RayError
        ) as error:  # the worker lives, but this call gave no answer: it raised, or could not be transferred
            cause = getattr(error, "cause", None)  # what the call raised, where it did
            words = str(cause if isinstance(cause, DrivecalError) else error).strip().splitlines()[-1][:LONGEST_REASON]
            if actor.warming is not None:
                return self._bury(actor, Breakdown.ERROR, f"{_place(actor)} cannot start: {words}", error)
            seconds = self._busy_seconds(actor)
            return [Lost(self._next_call(actor).batch_id, actor.name, Breakdown.ERROR, words, seconds)]
        if actor.warming is not None:
            actor.warming, actor.node, actor.pid = None, value.node, value.pid
            actor.failed_starts = 0
            if not actor.faults:
                actor.reason = ""
            return []
        call = self._next_call(actor)
        actor.cells += call.cells
        result: BatchResult = value
        if any(one.breakdown is None for one in result.results):
            actor.faults, actor.reason = 0, ""
        return [Finished(call.batch_id, result)]

    def _is_to_blame(self, actor: _Actor) -> bool:
        """Whether a dead actor died by itself: Ray was there afterwards. Where all of it is gone, its cells have no part in that."""
        if actor.died_at is None:
            actor.died_at = time.monotonic()
        return self._cluster.answered_since(actor.died_at)

    def _next_call(self, actor: _Actor) -> _Call:
        """Takes the running call away; the one behind it is running now."""
        call = actor.calls.popleft()
        if actor.calls:
            actor.deadline = time.monotonic() + actor.calls[0].seconds
        return call

    def _busy_seconds(self, actor: _Actor) -> float:
        """How long the running call has been running."""
        begun = actor.deadline - actor.calls[0].seconds if actor.calls else actor.deadline
        return max(0.0, time.monotonic() - begun)

    def _overdue(self, now: float) -> list[Finished | Lost]:
        events: list[Finished | Lost] = []
        for actor in tuple(self._actors):
            if actor.deadline > now or (actor.warming is None and not actor.calls):
                continue
            if actor.warming is not None:
                events += self._bury(
                    actor, Breakdown.HANG, f"{_place(actor)} was not ready after {self._options.start_seconds:.0f} s", None
                )
            else:
                seconds = actor.calls[0].seconds
                events += self._bury(
                    actor, Breakdown.HANG, f"{_place(actor)} was ended after {seconds:.0f} s in one batch", None
                )
        return events

    def _bury(self, actor: _Actor, breakdown: Breakdown, detail: str, cause: BaseException | None) -> list[Finished | Lost]:
        """Everything an actor had is lost; a new one starts at once, or after a pause where it was the start that failed."""
        if actor in self._gone({node.id for node in self._cluster.nodes}):
            return self._dismiss(actor)
        log.warning("%s; it is replaced", detail, exc_info=cause if log.isEnabledFor(logging.DEBUG) else None)
        lost = self._lose(actor, breakdown, detail)
        if actor.warming is not None:
            actor.failed_starts += 1
            actor.reason = detail
            actor.pause(actor.failed_starts)
        self._begin_anew(actor)
        return lost

    def _lose(self, actor: _Actor, breakdown: Breakdown, detail: str) -> list[Finished | Lost]:
        seconds = self._busy_seconds(actor)
        calls, actor.calls = actor.calls, deque()
        return [
            Lost(call.batch_id, actor.name, breakdown, detail, 0.0 if behind else seconds) for behind, call in enumerate(calls)
        ]

    def _bound_to(self, home: Node | None) -> dict[str, Any]:
        if home is None:
            return {}
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        return {"scheduling_strategy": NodeAffinitySchedulingStrategy(home.id, soft=False)}

    def _begin_anew(self, actor: _Actor) -> None:
        self._kill(actor)
        actor.warming = actor.pid = actor.died_at = None
        if actor.start_again_at <= time.monotonic():
            self._start(actor)

    def _named(self, worker: str) -> _Actor:
        return next(actor for actor in self._actors if actor.name == worker)

    def _kill(self, actor: _Actor) -> None:
        if actor.handle is not None:
            self._ray.kill(actor.handle, no_restart=True)
            actor.handle = None

    def _next_deadline(self) -> float:
        deadlines = [actor.deadline for actor in self._actors if actor.warming is not None or actor.calls]
        starts = [actor.start_again_at for actor in self._actors if actor.handle is None]
        return min(deadlines + starts, default=float("inf"))


def _place(actor: _Actor) -> str:
    return actor.name if actor.pid is None else f"{actor.name} (process {actor.pid} on {actor.node})"
