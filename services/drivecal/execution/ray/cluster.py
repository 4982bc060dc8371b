"""Starts a local Ray or joins a cluster: quiet, private, and without taking over the process."""

from __future__ import annotations

import os
import secrets
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import partial
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from drivecal.cluster.guard import end_with_parent
from drivecal.cluster.machine import locked_folder
from drivecal.cluster.members import Node, ask, check_shared_memory, check_token, members
from drivecal.cluster.settings import OBJECT_STORE_BYTES, QUIET
from drivecal.domain.errors import DrivecalError, UnavailableError
from drivecal.execution.backend import BackendLostError

EVERY_SECONDS = 0.5
PATIENCE_SECONDS = 2.5
"""Silence before it is reported; a busy store answers within milliseconds."""
GIVEN_UP_AFTER = 30.0
"""Silence before the cluster is lost; a store that keeps its state may be away this long."""


class StartedAnewError(Exception):
    """The store has forgotten this process."""


class ClusterWatch:
    """Notices that a Ray cluster is gone: Ray itself reports nothing for a minute, and then ends the process. Calls just wait meanwhile.

    Calls `ask`, of the store of the cluster's state (GCS), repeatedly in its own thread. It returns soon or raises; StartedAnewError, of a
    store that has forgotten all actors, ends the watch."""

    def __init__(self, name: str, ask: Callable[[], None], clock: Callable[[], float] = time.monotonic) -> None:
        """`name`: name of the store in messages."""
        self._name = name
        self._ask = ask
        self._clock = clock
        self._answered, self._answered_at = clock(), datetime.now(UTC)
        self._gone: str | None = None
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watch Ray", daemon=True)
        self._thread.start()

    def trouble(self) -> str | None:
        """Returns a message during silence, else None."""
        if self._clock() - self._answered <= PATIENCE_SECONDS:
            return None
        return f"{self._name} has not answered since {self._answered_at:%H:%M:%S} UTC"

    def lost(self) -> str | None:
        """Returns the reason for a final loss, or None."""
        return self._gone or (self.trouble() if self._clock() - self._answered > GIVEN_UP_AFTER else None)

    def answered_since(self, moment: float) -> bool:
        """Returns whether the store answered after a moment of the clock."""
        return self._answered > moment

    def stop(self) -> None:
        """Ends the thread; Ray is unused afterwards."""
        self._stopped.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stopped.wait(EVERY_SECONDS):
            try:
                self._ask()
            except StartedAnewError as error:
                self._gone = f"{self._name} {error}"
                return
            except Exception:  # noqa: BLE001, S112  # any exception of Ray means no answer, which `trouble` reports
                continue
            self._answered, self._answered_at = self._clock(), datetime.now(UTC)


START_SECONDS = 60.0
END_SECONDS = 8.0
LOOK_SECONDS = 0.5


class OwnNode:
    """The dispatcher's own node in a cluster: a program joins only through a node on its machine. It has no CPUs and simulates nothing, and
    runs until `close`, or until this process ends in any way."""

    def __init__(self, address: str) -> None:
        """Starts the node and waits until the cluster accepts it. Raises UnavailableError if it does not, and ConflictError if there is
        too little shared memory."""
        check_shared_memory()
        self._process = subprocess.Popen(  # noqa: S603  # drivecal's own command
            [sys.executable, "-P", "-m", "drivecal.cluster", "worker", address, "--cpus", "0"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            preexec_fn=partial(end_with_parent, signal.SIGTERM),  # noqa: PLW1509  # called by the main thread, before Ray starts others
            process_group=0,  # Ctrl-C in a terminal is for the dispatcher, which ends its node in order
        )
        try:
            self._wait(address)
        except BaseException:
            self.close()
            raise

    def _wait(self, address: str) -> None:
        deadline = time.monotonic() + START_SECONDS
        while not here(ask(address)):
            if self.ended() or time.monotonic() > deadline:
                raise UnavailableError(f"this machine could not join the Ray cluster at {address}; the lines above say why")
            time.sleep(LOOK_SECONDS)

    def ended(self) -> bool:
        """Returns whether the node is gone."""
        return self._process.poll() is not None

    def close(self) -> None:
        """Leaves the cluster."""
        self._process.terminate()
        try:
            self._process.wait(END_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def here(nodes: Collection[Node]) -> bool:
    """Returns whether one of these nodes runs on this machine."""
    services: Any = import_module("ray._private.services")
    return bool({node.id for node in nodes} & set(services.find_node_ids()))


LONGEST_FOLDER = 40
"""Ray's sockets lie 65 characters deep, and a Unix socket's path ends at 107."""
ANSWER_SECONDS = 1.0
"""Time limit for an answer of Ray's state store."""

_LOCAL = {
    "RAY_AUTH_MODE": "token",
    # despite its name it makes Ray on Linux, too, listen on 127.0.0.1 only
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
}


class Cluster:
    """A connection to Ray: `ray` is the module, imported only after its environment was set."""

    def __init__(self, address: str | None, cpus: int | None) -> None:
        """Starts a local Ray with `cpus` CPUs (None: all), or joins the cluster at `address`. Raises UnavailableError."""
        self.name = "the local Ray" if address is None else f"the Ray cluster at {address}"
        self._folder: tuple[Path, int] | None = None
        self._own: OwnNode | None = None
        self._watch: ClusterWatch | None = None
        self._values: dict[bytes, bytes | None] = {}
        """Watched keys of the state store, with their values at the last look."""
        self.nodes: tuple[Node, ...] = ()
        """Living nodes of a joined cluster; replaced as a whole, about twice a second."""
        os.environ.update(QUIET)
        if address is None:
            os.environ.update(_LOCAL)
            os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))  # read once per process, so never changed
            self._folder = private_folder()
        elif "RAY_AUTH_MODE" not in os.environ:
            with_token = "RAY_AUTH_TOKEN" in os.environ or "RAY_AUTH_TOKEN_PATH" in os.environ
            os.environ["RAY_AUTH_MODE"] = "token" if with_token else "disabled"
        import ray  # reads its environment at import

        self.ray: ModuleType = ray
        # a client's working directory, here a user's folder, is no place that workers import modules from
        job: dict[str, Any] = {**_QUIET, "job_config": ray.job_config.JobConfig(_client_job=True)}
        if address is not None:
            self._join(address)
        try:
            with _own_signal_handlers():
                if self._folder is not None:
                    with _spare_processes_left_out():
                        ray.init(
                            address="local",  # whatever other cluster the machine or its environment knows
                            num_cpus=cpus,
                            include_dashboard=False,
                            object_store_memory=OBJECT_STORE_BYTES,
                            _temp_dir=str(self._folder[0] / "r"),  # Ray opens it to all users
                            **job,
                        )
                else:
                    ray.init(address=address, **job)
        except Exception as error:
            self.close()
            reason = " ".join(str(error).split()) or type(error).__name__
            raise UnavailableError(f"{self.name} cannot be used: {reason[:500]}") from error
        self._watch = ClusterWatch(self.name, self._ask)

    def _join(self, address: str) -> None:
        """Makes sure that this machine has a node in the cluster, and all that a node needs. Raises UnavailableError: faults here can be
        mended while the server waits."""
        try:
            check_token(os.environ)
            self.nodes = ask(address)
            if not here(self.nodes):
                self._own = OwnNode(address)
        except UnavailableError:
            raise
        except DrivecalError as error:
            raise UnavailableError(str(error)) from error

    def cpus(self) -> int:
        """The CPUs of all nodes."""
        return int(self.ray.cluster_resources().get("CPU", 0))

    def check(self) -> None:
        """Raises BackendLostError if Ray is gone for good: left alone, it would end this process a minute later."""
        node = self.ray._private.worker._global_node  # noqa: SLF001  # no public interface
        dead = sorted({kind for kind, _ in node.dead_processes()} & _VITAL) if node else ["connection"]
        if dead:
            raise BackendLostError(f"Ray's {' and '.join(dead)} ended unexpectedly")
        if self._own is not None and self._own.ended():
            raise BackendLostError("this machine's node in the Ray cluster ended unexpectedly")
        lost = None if self._watch is None else self._watch.lost()
        if lost is not None:
            raise BackendLostError(lost)

    def trouble(self) -> str | None:
        """Returns a message while Ray does not answer, else None."""
        return None if self._watch is None else self._watch.trouble()

    def value(self, key: bytes) -> bytes | None:
        """Returns the value of a key in the cluster's state store at the last look; from now on it is looked at twice a second."""
        return self._values.setdefault(key, None)

    def forget(self, key: bytes) -> None:
        """Looks at a key no more."""
        self._values.pop(key, None)

    def answered_since(self, moment: float) -> bool:
        """Returns whether Ray has answered after a moment of the monotonic clock; it is asked twice a second."""
        return self._watch is not None and self._watch.answered_since(moment)

    def close(self) -> None:
        """Leaves the cluster; a local Ray ends."""
        if self._watch is not None:
            self._watch.stop()
            self._watch = None
        self.ray.shutdown()
        if self._own is not None:
            self._own.close()
            self._own = None
        if self._folder is not None:
            shutil.rmtree(self._folder[0], ignore_errors=True)
            os.close(self._folder[1])
            self._folder = None

    def _ask(self) -> None:
        """Reads the members from the cluster's state store; a local store only has to answer. The watching thread calls it."""
        client = self.ray._private.worker.global_worker.gcs_client  # noqa: SLF001  # all public ways wait without end
        try:
            if self._folder is None:
                self.nodes = members(client, ANSWER_SECONDS)
            keys = list(self._values)
            values = client.internal_kv_multi_get(keys or [b"drivecal"], None, timeout=ANSWER_SECONDS)
            self._values |= {key: values[key] for key in keys if key in values and key in self._values}
        except self.ray.exceptions.AuthenticationError as error:
            raise StartedAnewError("was restarted, or no longer accepts our token") from error


_VITAL = {"raylet", "gcs_server"}
_QUIET: dict[str, Any] = {"namespace": "drivecal", "log_to_driver": False, "configure_logging": False, "logging_level": "ERROR"}


@contextmanager
def _own_signal_handlers() -> Iterator[None]:
    """Ray replaces the handler of SIGTERM."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


_SPARE = ("start_monitor", "start_log_monitor", "start_api_server")


@contextmanager
def _spare_processes_left_out() -> Iterator[None]:
    """A local Ray without autoscaler, log monitor and dashboard (which `include_dashboard=False` makes smaller, no more): nothing uses
    them here, and they take a third of what starting Ray costs, and 160 MB. `ray.init` has no switch for them."""
    from ray._private.node import Node

    theirs = {name: getattr(Node, name) for name in _SPARE}
    for name in _SPARE:
        setattr(Node, name, lambda *_, **__: None)
    try:
        yield
    finally:
        for name, method in theirs.items():
            setattr(Node, name, method)


def private_folder() -> tuple[Path, int]:
    """Returns a new folder for a local Ray's sockets and logs, which only this user can enter, and the descriptor of its lock."""
    parent = Path(tempfile.gettempdir())
    if len(str(parent / "drivecal-ray-abcdefgh" / "r")) > LONGEST_FOLDER:
        parent = Path("/tmp")  # noqa: S108  # mkdtemp makes a private folder in it
    return locked_folder(parent, "drivecal-ray-", partial(shutil.rmtree, ignore_errors=True))
