"""The dispatcher's own node in a Ray cluster: a program joins only through a node on its machine. It has no CPUs and simulates nothing."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Collection
from importlib import import_module
from typing import Any

from drivecal.cluster.guard import end_with_parent
from drivecal.cluster.members import Node, ask, check_shared_memory
from drivecal.domain.errors import UnavailableError

START_SECONDS = 60.0
END_SECONDS = 8.0
LOOK_SECONDS = 0.5


class OwnNode:
    """Runs until `close`, or until this process ends in any way."""

    def __init__(self, address: str) -> None:
        """Starts the node and waits until the cluster accepts it. Raises UnavailableError if it does not, and ConflictError if there is
        too little shared memory."""
        check_shared_memory()
        self._process = subprocess.Popen(  # noqa: S603  # drivecal's own command
            [sys.executable, "-m", "drivecal.cluster", "worker", address, "--cpus", "0"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            preexec_fn=_end_with_parent,  # noqa: PLW1509  # called by the main thread, before Ray starts others
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


def _end_with_parent() -> None:
    """Runs in the child before the command: a killed process takes its node along."""
    end_with_parent(signal.SIGTERM)
    os.setpgid(0, 0)  # Ctrl-C in a terminal is for the dispatcher, which ends its node in order
