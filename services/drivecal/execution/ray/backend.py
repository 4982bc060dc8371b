"""The backend on Ray actors. Ray restarts and retries nothing: lost actors are replaced here."""

import logging
import os
import secrets
import signal
import socket
import time
from collections import Counter
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from drivecal.cluster.members import Node
from drivecal.cluster.pulse import Silence
from drivecal.cluster.settings import release
from drivecal.contracts.work import Batch
from drivecal.domain.errors import DrivecalError
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.backend import SETTLE_SECONDS, Finished, Lost
from drivecal.execution.ray.cluster import Cluster
from drivecal.execution.ray.worker import RayWorker
from drivecal.execution.supervised import CallFailedError, NotKnownYetError, SupervisedBackend, WorkerDiedError, WorkerLimits
from drivecal.execution.worker_process import WorkerProcess


def missing(nodes: Sequence[Node], placed: Collection[str], most: int | None, version: str) -> list[Node]:
    """Returns the nodes of the workers to add, in order, one entry per worker.

    `placed`: node ids of the existing workers. `most`: number of all workers; None is one per CPU. The next worker goes to the node with
    the fewest, so that few workers are spread over many nodes.
    """
    room = {node.id: node.cpus for node in nodes if fits(node, version)}
    by_id = {node.id: node for node in nodes}
    taken = Counter(identifier for identifier in placed if identifier in room)
    added: list[Node] = []
    while most is None or taken.total() < most:
        free = [identifier for identifier, cpus in room.items() if taken[identifier] < cpus]
        if not free:
            break
        chosen = min(free, key=lambda identifier: taken[identifier])
        taken[chosen] += 1
        added.append(by_id[chosen])
    return added


def fits(node: Node, version: str) -> bool:
    """Returns whether a node has the coordinator's version of drivecal (`release()`), or an unknown version."""
    return node.version in {None, version}


def complaint(nodes: Sequence[Node], version: str, cluster: str) -> str | None:
    """Returns a message about unusable nodes, or None."""
    working = [node for node in nodes if node.cpus > 0]
    others = [node for node in working if not fits(node, version)]
    if others:
        listed = ", ".join(f"{node.name} has drivecal {node.version}" for node in others[:3])
        return (
            f"{len(others)} of {len(working)} nodes get no work, for they are of another version than the coordinator"
            f" ({version}): {listed}; install the same release on both"
        )
    return None if working else f"{cluster} has no node with workers; start some, and they get work at once"


CLUSTER_SETTLE_SECONDS = 90.0
"""How long runs may outlive their worker in a cluster: a node that loses its head ends its workers after 30 s, after a
minute by Ray's default (`gcs_rpc_server_reconnect_timeout_s`)."""

log = logging.getLogger(__name__)


@dataclass(slots=True)
class _Signs:
    """Signs of life of a worker: its key in the state store, and the latest value."""

    key: bytes
    latest: bytes | None = None
    silence: Silence = field(default_factory=Silence)


class RayBackend(SupervisedBackend):
    """A `Backend`, once per process; only the main thread may create, use and close it."""

    def __init__(self, limits: WorkerLimits, trial: Batch, address: str | None = None) -> None:
        """Starts a local Ray, or joins the cluster at `address`, and starts the workers without waiting for them, by default one per CPU of
        all nodes; each runs `trial` before it is ready.

        Raises UnavailableError without Ray."""
        super().__init__(limits)
        self._address = address
        self.waits_for_workers = address is not None
        self.settle_seconds = SETTLE_SECONDS if address is None else CLUSTER_SETTLE_SECONDS
        self._cluster = Cluster(address, limits.workers)
        self._ray = self._cluster.ray
        self._actor_class = self._ray.remote(num_cpus=1, max_restarts=0, max_task_retries=0)(RayWorker)
        self._signs: dict[str, _Signs] = {}
        """Signs of life of workers, by name."""
        self._trial = trial
        self._version = release()
        self._nodes: tuple[Node, ...] = ()
        if address is None:
            for _ in range(limits.workers or max(1, self._cluster.cpus())):
                self._hire(None)
        else:
            self._follow_nodes()

    def close(self) -> None:
        super().close()
        self._cluster.close()

    def _launch(self, worker: WorkerProcess) -> None:
        signs = self._signs[worker.name] = _Signs(f"drivecal-pulse-{secrets.token_hex(8)}".encode())
        worker.handle = self._actor_class.options(**self._bound_to(worker.home)).remote(worker.name, signs.key)
        worker.warming = worker.handle.warm.remote(self._trial)

    def _send(self, worker: WorkerProcess, batch: Batch) -> Any:
        return worker.handle.run.remote(batch)

    def _store(self, worker: WorkerProcess, bundle: str, archive: bytes) -> None:
        worker.handle.store.remote(bundle, archive)

    def _is_silent(self, worker: WorkerProcess) -> bool:
        signs = self._signs[worker.name]
        before, signs.latest = signs.latest, self._cluster.value(signs.key)
        heard = signs.latest != before or self._cluster.trouble() is not None
        here = worker.pid if worker.node == socket.gethostname() else None
        return signs.silence.is_too_long(here, heard=heard)

    def _end(self, worker: WorkerProcess) -> None:
        signs = self._signs.pop(worker.name, None)
        if signs is not None:
            self._cluster.forget(signs.key)
        self._ray.kill(worker.handle, no_restart=True)
        if worker.pid is not None and worker.node == socket.gethostname():
            with suppress(OSError):  # Ray asks a stopped process to end itself
                os.kill(worker.pid, signal.SIGKILL)

    def _answered(self, references: Sequence[Any], timeout: float) -> Collection[Any]:
        done, _ = self._ray.wait(references, num_returns=1, timeout=timeout, fetch_local=False)
        if done and len(references) > 1:
            done, _ = self._ray.wait(references, num_returns=len(references), timeout=0, fetch_local=False)
        return list(done)

    def _value(self, worker: WorkerProcess) -> Any:
        errors = self._ray.exceptions
        out_of_memory = WorkerDiedError(Breakdown.MEMORY, "was ended because its node ran out of memory")
        try:
            return self._ray.get(worker.waited_for)
        except errors.OutOfMemoryError as error:
            raise out_of_memory from error
        except errors.RayActorError as error:
            if not self._is_to_blame(worker):
                raise NotKnownYetError from error
            if "low on memory" in str(error):
                raise out_of_memory from error
            # Ray does not tell a crash from a kill, or from the end of a node that is not known yet
            raise WorkerDiedError(Breakdown.CRASH, "died, as after a segmentation fault or a kill", departed=True) from error
        except errors.RayError as error:
            cause = getattr(error, "cause", None)  # the exception of the call, if any
            raise CallFailedError(str(cause if isinstance(cause, DrivecalError) else error)) from error

    def _changes(self) -> list[Finished | Lost]:
        self._cluster.check()
        return self._follow_nodes()

    def _lost_with_machine(self, worker: WorkerProcess) -> list[Finished | Lost] | None:
        return self._dismiss(worker) if worker in self._gone({node.id for node in self._cluster.nodes}) else None

    def _complaints(self) -> list[str | None]:
        of_cluster = None if self._address is None else complaint(self._nodes, self._version, self._cluster.name)
        return [self._cluster.trouble(), of_cluster]

    def _follow_nodes(self) -> list[Finished | Lost]:
        """Starts workers on new nodes; returns the lost batches of workers whose nodes are gone."""
        if self._nodes is self._cluster.nodes:
            return []
        before, self._nodes = self._nodes, self._cluster.nodes
        there = {node.id for node in self._nodes}
        events = [event for worker in self._gone(there) for event in self._dismiss(worker)]
        homes = [worker.home.id for worker in self._workers if worker.home is not None]
        for node in missing(self._nodes, homes, self._limits.workers, self._version):
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

    def _gone(self, there: Collection[str]) -> list[WorkerProcess]:
        return [worker for worker in self._workers if worker.home is not None and worker.home.id not in there]

    def _dismiss(self, worker: WorkerProcess) -> list[Finished | Lost]:
        """Removes a worker whose node is gone."""
        events: list[Finished | Lost] = list(worker.lose(Breakdown.CRASH, f"{worker.place} went with its node", departed=True))
        self._kill(worker)
        self._workers.remove(worker)
        return events

    def _is_to_blame(self, worker: WorkerProcess) -> bool:
        """Returns whether a dead worker died by itself: Ray answered afterwards. If all of Ray is gone, the cells are innocent."""
        if worker.died_at is None:
            worker.died_at = time.monotonic()
        return self._cluster.answered_since(worker.died_at)

    def _bound_to(self, home: Node | None) -> dict[str, Any]:
        if home is None:
            return {}
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        return {"scheduling_strategy": NodeAffinitySchedulingStrategy(home.id, soft=False)}
