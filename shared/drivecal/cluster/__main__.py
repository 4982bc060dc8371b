"""Runs one node of a Ray cluster: `python -m drivecal.cluster head` on one machine, `... worker HEAD:PORT` on any number of others.

Checks the token, shared memory, the head and its version, reports a fault in one sentence, and then becomes the guard of `ray start`.
Nodes may join and leave while campaigns run; the dispatcher uses all present nodes.

Environment variables: `RAY_AUTH_TOKEN_PATH`, the file with the token that all nodes share; `DRIVECAL_NODE_CPUS`, the number of workers of
this node (default: its CPUs); `DRIVECAL_NODE_ADDRESS`, the address of this node for other nodes (default: detected).
"""

import argparse
import logging
import os
import re
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from drivecal.cluster.guard import start_logging
from drivecal.cluster.members import Node, ask, check_shared_memory, check_token
from drivecal.cluster.settings import ALERT, OBJECT_STORE_BYTES, PORT, QUIET, VERSION_LABEL, release
from drivecal.domain.errors import DrivecalError, InvalidInputError, Problem, UnavailableError

LONGEST_PAUSE = 10.0

log = logging.getLogger("drivecal.cluster")


def main(arguments: Sequence[str] | None = None) -> int:
    """Becomes a node; returns 1 if a check fails."""
    start_logging()
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog="python -m drivecal.cluster", description=__doc__, formatter_class=raw)
    roles = parser.add_subparsers(dest="role", required=True)
    head = roles.add_parser("head", help="the node that the others join; it simulates nothing")
    head.add_argument("--port", type=int, default=PORT)
    worker = roles.add_parser("worker", help="a node with workers")
    worker.add_argument("address", metavar="HEAD:PORT")
    worker.add_argument("--cpus", type=int, help="number of workers; default: DRIVECAL_NODE_CPUS, else this machine's CPUs")
    worker.add_argument("--port", type=int, default=0, help="port of this node for other nodes; 0 takes any free port")
    options = parser.parse_args(arguments)
    os.environ.update(QUIET)
    for name, value in ALERT.items():
        os.environ.setdefault(name, value)
    try:
        check_token(os.environ)
        os.environ.setdefault("RAY_AUTH_MODE", "token")
        check_shared_memory()
        if options.role == "head":
            command = head_command(options.port, os.environ)
            log.info("starting the head at port %d", options.port)
        else:
            cpus = cpus_of(options.cpus, os.environ)
            wait_for_head(options.address, ask)
            command = worker_command(options.address, cpus, options.port, os.environ)
            log.info("joining the head at %s with %s", options.address, "all CPUs" if cpus is None else f"{cpus} CPUs")
    except DrivecalError as error:
        log.error("%s", error)  # noqa: TRY400  # the message is complete; a traceback would bury it
        return 1
    return _exec_guard(command)


def wait_for_head(address: str, nodes_of: Callable[[str], Sequence[Node]], pause: Callable[[float], None] = time.sleep) -> None:
    """Waits until the head responds. Raises NotAuthorisedError if it rejects our token."""
    seconds = 1.0
    while True:
        try:
            nodes_of(address)
        except UnavailableError as error:
            log.warning("waiting for the head: %s", error)
            pause(seconds)
            seconds = min(2 * seconds, LONGEST_PAUSE)
        else:
            return


def head_command(port: int, environment: Mapping[str, str]) -> list[str]:
    """Returns the `ray start` command of a head without workers, autoscaler, and dashboard (which would open Ray's job API)."""
    options = [f"--port={port}", "--num-cpus=0", "--include-dashboard=false", "--no-monitor"]
    return ["ray", "start", "--head", *options, *_common_options(environment)]


def worker_command(address: str, cpus: int | None, port: int, environment: Mapping[str, str]) -> list[str]:
    """Returns the `ray start` command of a node with workers."""
    limit = [] if cpus is None else [f"--num-cpus={cpus}"]
    return ["ray", "start", f"--address={address}", f"--node-manager-port={port}", *limit, *_common_options(environment)]


def _common_options(environment: Mapping[str, str]) -> list[str]:
    address = environment.get("DRIVECAL_NODE_ADDRESS")
    return [
        *([f"--node-ip-address={address}"] if address else []),
        f"--labels={VERSION_LABEL}={release()}",
        f"--object-store-memory={OBJECT_STORE_BYTES}",
        "--num-gpus=0",
        "--include-log-monitor=false",  # saves a process of 80 MB; the output of workers is not forwarded
        "--disable-usage-stats",
        "--block",
    ]


def cpus_of(option: int | None, environment: Mapping[str, str]) -> int | None:
    """Returns the number of workers of a node; None means all its CPUs. Raises InvalidInputError."""
    variable = environment.get("DRIVECAL_NODE_CPUS", "")
    if option is not None or not variable:
        return option
    if not re.fullmatch("[1-9][0-9]*", variable):
        raise InvalidInputError(Problem("DRIVECAL_NODE_CPUS", f"{variable!r} is not a number of workers", "give e.g. 4"))
    return int(variable)


def _exec_guard(command: list[str]) -> int:
    """Replaces this process, which has loaded all of Ray by now, by the small guard of `command`."""
    executable = str(Path(sys.executable).with_name(command[0]))
    os.execv(sys.executable, [sys.executable, "-P", "-m", "drivecal.cluster.guard", executable, *command[1:]])  # noqa: S606  # no shell


if __name__ == "__main__":
    sys.exit(main())
