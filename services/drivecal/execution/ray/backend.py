"""The backend on Ray actors, and the coordinator's only bridge to `drivecal.runtime`.

Ray restarts and retries nothing: lost actors are replaced here, and the scheduler handles their batches. Each actor has at most two
calls, so that it never waits for the next.
"""

import itertools
import logging
import math
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

from drivecal.cluster.members import Node
from drivecal.contracts.work import Batch, BatchResult
from drivecal.domain.errors import DrivecalError
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.backend import (
    DEADLINE_FACTOR,
    DEADLINE_SECONDS,
    Backend,
    BackendLostError,
    Finished,
    Lost,
    Slot,
    WorkerInfo,
)
from drivecal.execution.ray.actor import Actor, Call
from drivecal.execution.ray.cluster import Cluster
from drivecal.execution.ray.placement import complaint, fits, missing
from drivecal.runtime.worker import Worker

TRIES_TO_START = 3
"""Attempts without a started worker after which a local Ray is given up: a new process may succeed. A cluster is waited for."""
MOST_ARCHIVES = 8
"""Archives of bundles that are kept in Ray's store for workers to come."""
LONGEST_REASON = 600
"""Characters of a reason."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class RayOptions:
    """`address` of a cluster, None for a local Ray; `workers`: None is one per CPU of all nodes.

    A batch is ended as hung after `deadline_seconds` and `deadline_factor` times its expected time, a worker after `start_seconds` of
    starting, which includes compiling."""

    address: str | None = None
    workers: int | None = None
    deadline_seconds: float = DEADLINE_SECONDS
    deadline_factor: float = DEADLINE_FACTOR
    start_seconds: float = 600.0
    certificates_mb: int | None = None
    """Memory of each worker for certificates; None: its machine's share."""
    archive: Callable[[str], bytes] | None = None
    """Returns the archive of a problem bundle by its digest; None: no bundle is ever run."""


class RayBackend(Backend):
    """A `Backend`, once per process; only the main thread may create, use and close it."""

    def __init__(self, options: RayOptions, trial: Batch) -> None:
        """Starts or joins Ray and starts the workers without waiting for them; each runs `trial` before it is ready.

        Raises UnavailableError without Ray."""
        self._options = options
        self._cluster = Cluster(options.address, options.workers)
        self._ray = self._cluster.ray
        self._actor_class = self._ray.remote(num_cpus=1, max_restarts=0, max_task_retries=0)(Worker)
        self._trial = trial
        self._version = version("drivecal")
        self._nodes: tuple[Node, ...] = ()
        self._indices = itertools.count(1)
        self._actors: list[Actor] = []
        self._archives: dict[str, Any] = {}
        """References to archives in Ray's store, by digest."""
        if options.address is None:
            for _ in range(options.workers or max(1, self._cluster.cpus())):
                self._hire(None)
        else:
            self._follow_nodes()

    def submit(self, worker: str, batch_id: int, batch: Batch, expected_seconds: float | None, *, alone: bool = False) -> None:
        actor = self._named(worker)
        if not actor.room(alone=alone):
            raise RuntimeError(f"{worker} has no slot; ask `slots` first")
        limit = 2 * (batch.setup.timeout or 0.0) * len(batch.cells)  # simulators of users end their starts and runs themselves
        allowed = max(self._options.deadline_seconds + limit, self._options.deadline_factor * (expected_seconds or 0.0))
        self._ship(actor, batch.setup.bundle)
        unknown = 0.0 if batch.setup.timeout is None else math.inf
        expected = unknown if expected_seconds is None else expected_seconds
        call = Call(batch_id, len(batch.cells), actor.handle.run.remote(batch), allowed, expected)
        actor.take(call, alone=alone)

    def _ship(self, actor: Actor, bundle: str | None) -> None:
        """Sends a bundle's files to a worker that has not got them. Its calls run in order, so that they are there for the next batch."""
        if bundle is None or bundle in actor.bundles or self._options.archive is None:
            return
        try:
            if bundle not in self._archives:
                self._archives[bundle] = self._ray.put(self._options.archive(bundle))
        except (DrivecalError, self._ray.exceptions.RayError) as error:
            log.warning("the files of %s cannot be read, so %s refuses its cells for now: %s", bundle, actor.place, error)
            return
        actor.handle.store.remote(bundle, self._archives[bundle])
        actor.bundles.add(bundle)
        while len(self._archives) > MOST_ARCHIVES:
            del self._archives[next(iter(self._archives))]

    def wait(self, timeout: float) -> list[Finished | Lost]:
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
        slots = [Slot(actor.name, not actor.calls) for actor in self._actors if actor.room(alone=False)]
        return sorted(slots, key=lambda slot: not slot.idle)

    def workers(self) -> list[WorkerInfo]:
        return [WorkerInfo(actor.name, actor.node, actor.pid, actor.state, actor.cells) for actor in self._actors]

    def replace(self, worker: str, fault: str | None) -> None:
        actor = self._named(worker)
        if not actor.room(alone=True):
            raise RuntimeError(f"{worker} is not idle")
        log.warning("%s is replaced: %s", actor.place, fault or "another one is to have a look")
        if fault is not None:
            actor.faults += 1
            actor.reason = f"{actor.place} was replaced: {fault}"
            actor.pause(actor.faults - 1)
        self._begin_anew(actor)

    def trouble(self) -> str | None:
        starting = [actor for actor in self._actors if actor.failed_starts]
        failing = [actor for actor in self._actors if actor.faults and not actor.failed_starts]
        complaints = [self._cluster.trouble()]
        if self._options.address is not None:
            complaints.append(complaint(self._nodes, self._version, self._cluster.name))
        complaints += [
            f"{len(actors)} of {len(self._actors)} workers {words}: {actors[0].reason}"
            for actors, words in ((starting, "do not start"), (failing, "give no results"))
            if actors
        ]
        return "; ".join(filter(None, complaints)) or None

    def close(self) -> None:
        for actor in self._actors:
            self._kill(actor)
        self._cluster.close()

    def _follow_nodes(self) -> list[Finished | Lost]:
        """Starts workers on new nodes; returns the lost batches of workers whose nodes are gone."""
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
            if not node.cpus:
                continue
            log.info("node %s is there: %d CPUs, drivecal %s", node.name, node.cpus, node.version or "unknown")
            if not fits(node, self._version):
                log.warning("node %s gets no work: this coordinator has drivecal %s", node.name, self._version)
        return events

    def _homes(self) -> list[str]:
        return [actor.home.id for actor in self._actors if actor.home is not None]

    def _gone(self, there: Collection[str]) -> list[Actor]:
        return [actor for actor in self._actors if actor.home is not None and actor.home.id not in there]

    def _hire(self, home: Node | None) -> None:
        actor = Actor(next(self._indices), home, node="" if home is None else home.name)
        self._actors.append(actor)
        self._start(actor)

    def _dismiss(self, actor: Actor) -> list[Finished | Lost]:
        """Removes a worker whose node is gone. The worker may have crashed the node, so its cells count as crashed."""
        events: list[Finished | Lost] = list(actor.lose(Breakdown.CRASH, f"{actor.place} went with its node"))
        self._kill(actor)
        self._actors.remove(actor)
        return events

    def _start(self, actor: Actor) -> None:
        actor.incarnation += 1
        actor.bundles.clear()
        actor.handle = self._actor_class.options(**self._bound_to(actor.home)).remote(
            actor.name, certificates_mb=self._options.certificates_mb
        )
        actor.warming = actor.handle.warm.remote(self._trial)
        actor.deadline = time.monotonic() + self._options.start_seconds

    def _collect(self, timeout: float) -> list[Finished | Lost]:
        """Waits for the first answer of running calls, and returns all answers."""
        waiting = {actor.waited_for: actor for actor in self._actors if actor.waited_for is not None}
        if not waiting:
            time.sleep(timeout)
            return []
        references = list(waiting)
        done, _ = self._ray.wait(references, num_returns=1, timeout=timeout, fetch_local=False)
        if done and len(references) > 1:
            done, _ = self._ray.wait(references, num_returns=len(references), timeout=0, fetch_local=False)
        events = [event for reference in done for event in self._answer(waiting[reference])]
        if done and not events:
            time.sleep(min(timeout, 0.02))  # an unconfirmed death is reported again at once
        return events

    def _answer(self, actor: Actor) -> list[Finished | Lost]:
        """Returns the answer of an actor's running call."""
        errors = self._ray.exceptions
        try:
            value = self._ray.get(actor.waited_for)
        except errors.OutOfMemoryError as error:
            return self._bury(actor, Breakdown.MEMORY, f"{actor.place} was ended because its node ran out of memory", error)
        except errors.RayActorError as error:
            if not self._is_to_blame(actor):
                return []
            if "low on memory" in str(error):
                return self._bury(actor, Breakdown.MEMORY, f"{actor.place} was ended because its node ran out of memory", error)
            return self._bury(actor, Breakdown.CRASH, f"{actor.place} died, as after a segmentation fault or a kill", error)
        except errors.RayError as error:  # the worker lives, but its call raised or the answer could not be transferred
            cause = getattr(error, "cause", None)  # the exception of the call, if any
            words = str(cause if isinstance(cause, DrivecalError) else error).strip().splitlines()[-1][:LONGEST_REASON]
            if actor.warming is not None:
                return self._bury(actor, Breakdown.ERROR, f"{actor.place} cannot start: {words}", error)
            seconds = actor.busy_seconds()
            return [Lost(actor.next_call().batch_id, actor.name, Breakdown.ERROR, words, seconds)]
        if actor.warming is not None:
            actor.started(value.node, value.pid)
            return []
        call = actor.next_call()
        actor.cells += call.cells
        result: BatchResult = value
        if any(answer.breakdown is None for answer in result.results):
            actor.faults, actor.reason = 0, ""
        return [Finished(call.batch_id, result)]

    def _is_to_blame(self, actor: Actor) -> bool:
        """Whether a dead actor died by itself: Ray answered afterwards. If all of Ray is gone, the cells are innocent."""
        if actor.died_at is None:
            actor.died_at = time.monotonic()
        return self._cluster.answered_since(actor.died_at)

    def _overdue(self, now: float) -> list[Finished | Lost]:
        events: list[Finished | Lost] = []
        for actor in tuple(self._actors):
            if actor.deadline > now or actor.waited_for is None:
                continue
            if actor.warming is not None:
                events += self._bury(
                    actor, Breakdown.HANG, f"{actor.place} was not ready after {self._options.start_seconds:.0f} s", None
                )
            else:
                seconds = actor.calls[0].seconds
                events += self._bury(actor, Breakdown.HANG, f"{actor.place} was ended after {seconds:.0f} s in one batch", None)
        return events

    def _bury(self, actor: Actor, breakdown: Breakdown, detail: str, cause: BaseException | None) -> list[Finished | Lost]:
        """Returns an actor's batches as lost and starts a new actor, after a pause if the start failed."""
        if actor in self._gone({node.id for node in self._cluster.nodes}):
            return self._dismiss(actor)
        log.warning("%s; it is replaced", detail, exc_info=cause if log.isEnabledFor(logging.DEBUG) else None)
        lost: list[Finished | Lost] = list(actor.lose(breakdown, detail))
        if actor.warming is not None:
            actor.failed_starts += 1
            actor.reason = detail
            actor.pause(actor.failed_starts)
        self._begin_anew(actor)
        return lost

    def _bound_to(self, home: Node | None) -> dict[str, Any]:
        if home is None:
            return {}
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        return {"scheduling_strategy": NodeAffinitySchedulingStrategy(home.id, soft=False)}

    def _begin_anew(self, actor: Actor) -> None:
        self._kill(actor)
        actor.warming = actor.pid = actor.died_at = None
        if actor.start_again_at <= time.monotonic():
            self._start(actor)

    def _named(self, worker: str) -> Actor:
        return next(actor for actor in self._actors if actor.name == worker)

    def _kill(self, actor: Actor) -> None:
        if actor.handle is not None:
            self._ray.kill(actor.handle, no_restart=True)
            actor.handle = None

    def _next_deadline(self) -> float:
        deadlines = [actor.deadline for actor in self._actors if actor.waited_for is not None]
        starts = [actor.start_again_at for actor in self._actors if actor.handle is None]
        return min(deadlines + starts, default=float("inf"))
