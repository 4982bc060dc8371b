"""Runs one node of a Ray cluster: `python -m drivecal.cluster head`, or `... worker HEAD:PORT` on as many machines as there are.

Looks first whether the node can work at all (token, shared memory, the head, its version), says in a sentence what is wrong, and then
becomes the guard of `ray start`. Nodes may come and go while campaigns run; the dispatcher gives work to whoever is there.

Settings by environment: `RAY_AUTH_TOKEN_PATH`, a file with the token that all nodes share; `DRIVECAL_NODE_CPUS`, workers of this node
(default: its CPUs); `DRIVECAL_NODE_ADDRESS`, where other nodes find this one (default: found out).
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path

from drivecal.cluster.checks import check_shared_memory, check_token, version_gap
from drivecal.cluster.members import Node, ask
from drivecal.cluster.settings import ALERT, OBJECT_STORE_BYTES, PORT, QUIET, VERSION_LABEL
from drivecal.domain.errors import DrivecalError, InvalidInputError, Problem, UnavailableError

LONGEST_PAUSE = 10.0

log = logging.getLogger("drivecal.cluster")


def main(words: Sequence[str] | None = None) -> int:
    """Becomes a node; returns 1 where it cannot."""
    logging.Formatter.converter = time.gmtime
    logging.basicConfig(
        level=logging.INFO,
        format="%(asctime)s.%(msecs)03dZ %(levelname)-7s node       %(message)s",
        datefmt="%Y-%m-%dT%H:%M:%S",
    )
    parser = argparse.ArgumentParser(prog="python -m drivecal.cluster", description="Runs a node of a Ray cluster.")
    roles = parser.add_subparsers(dest="role", required=True)
    head = roles.add_parser("head", help="the node that the others join; it simulates nothing")
    head.add_argument("--port", type=int, default=PORT)
    worker = roles.add_parser("worker", help="a node with workers")
    worker.add_argument("address", metavar="HEAD:PORT")
    worker.add_argument("--cpus", type=int, help="workers; else DRIVECAL_NODE_CPUS, else the CPUs of this machine")
    worker.add_argument("--port", type=int, default=0, help="where this node listens for the others; 0 takes any free one")
    arguments = parser.parse_args(words)
    os.environ.update(QUIET)
    for name, value in ALERT.items():
        os.environ.setdefault(name, value)
    try:
        check_token(os.environ)
        os.environ.setdefault("RAY_AUTH_MODE", "token")
        check_shared_memory()
        if arguments.role == "head":
            command = head_command(arguments.port, os.environ)
            log.info("the head starts at port %d", arguments.port)
        else:
            cpus = cpus_of(arguments.cpus, os.environ)
            wait_for_head(arguments.address, ask)
            command = worker_command(arguments.address, cpus, arguments.port, os.environ)
            log.info("joining the head at %s with %s", arguments.address, "all CPUs" if cpus is None else f"{cpus} CPUs")
    except DrivecalError as error:
        log.error("%s", error)  # noqa: TRY400  # the sentence says it all; a traceback would bury it
        return 1
    return _become(command)


def wait_for_head(address: str, nodes_of: Callable[[str], Sequence[Node]], pause: Callable[[float], None] = time.sleep) -> None:
    """Returns once the head answers; says so where its version is another one. Raises NotAuthorisedError where it does not accept our
    token."""
    seconds = 1.0
    while True:
        try:
            nodes = nodes_of(address)
        except UnavailableError as error:
            log.warning("waiting for the head: %s", error)
            pause(seconds)
            seconds = min(2 * seconds, LONGEST_PAUSE)
        else:
            break
    for node in nodes:
        gap = version_gap(node.version, address) if node.is_head else None
        if gap is not None:
            log.error("%s", gap)


def head_command(port: int, environment: Mapping[str, str]) -> list[str]:
    """`ray start` of a head that runs no workers and starts no machines, with no dashboard: that is where Ray's job API would be."""
    own = [f"--port={port}", "--num-cpus=0", "--include-dashboard=false", "--no-monitor"]
    return ["ray", "start", "--head", *own, *_common(environment)]


def worker_command(address: str, cpus: int | None, port: int, environment: Mapping[str, str]) -> list[str]:
    """`ray start` of a node with workers."""
    room = [] if cpus is None else [f"--num-cpus={cpus}"]
    return ["ray", "start", f"--address={address}", f"--node-manager-port={port}", *room, *_common(environment)]


def _common(environment: Mapping[str, str]) -> list[str]:
    address = environment.get("DRIVECAL_NODE_ADDRESS")
    return [
        *([f"--node-ip-address={address}"] if address else []),
        f"--labels={VERSION_LABEL}={version('drivecal')}",
        f"--object-store-memory={OBJECT_STORE_BYTES}",
        "--num-gpus=0",
        "--include-log-monitor=false",  # what workers write goes nowhere else; it would be a process of 80 MB
        "--disable-usage-stats",
        "--block",
    ]


def cpus_of(given: int | None, environment: Mapping[str, str]) -> int | None:
    """How many workers a node is to have; None: as many as CPUs. Raises InvalidInputError."""
    words = environment.get("DRIVECAL_NODE_CPUS", "")
    if given is not None or not words:
        return given
    if not words.isdecimal():
        raise InvalidInputError(Problem("DRIVECAL_NODE_CPUS", f"{words!r} is no number of workers", "give e.g. 4"))
    return int(words)


def _become(command: list[str]) -> int:
    """The guard of the command: this process has loaded all of Ray by now, which nobody needs any more."""
    executable = str(Path(sys.executable).with_name(command[0]))
    os.execv(sys.executable, [sys.executable, "-m", "drivecal.cluster.guard", executable, *command[1:]])  # noqa: S606  # no shell


if __name__ == "__main__":
    sys.exit(main())
