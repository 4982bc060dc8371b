"""Runs a command and exits with it: `python -m drivecal.cluster.guard COMMAND...`. A restart policy then starts it again.

When a raylet exits in order, e.g. after the death of one of its agents, `ray start` takes that for a requested end and blocks forever.
This guard ends a node that has lost its raylet or its GCS server, or whose raylet is stopped, so that it can join again. API and dispatcher
in containers show signs of life (`pulse`), and are ended without them. Standard library only, to stay small.
"""

import ctypes
import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from drivecal.cluster import pulse

PR_SET_PDEATHSIG = 1


def processes() -> Iterator[tuple[int, str, list[str]]]:
    """Yields id, name, and the fields from the state on (proc(5)) of every process; nothing on systems without /proc."""
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            # pid (name) state ppid pgrp session ...; the name may contain any character
            head, _, rest = entry.read_text(errors="replace").rpartition(")")
        except OSError:
            continue
        yield int(entry.parent.name), head.partition("(")[2], rest.split()


def end_with_parent(number: int) -> None:
    """Sends signal `number` to this process when its parent is gone, for any reason (Linux only). Call it in the child, before exec."""
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, number)


VITAL = {"raylet", "gcs_server"}
"""Ray's processes that must not end; without /proc they cannot be watched."""
POLL_SECONDS = 1.0
END_SECONDS = 10.0

log = logging.getLogger("drivecal.cluster")


def guard(command: Sequence[str], poll_seconds: float = POLL_SECONDS) -> int:
    """Returns the command's exit code, or 1 if one of its vital processes ended first, or if it shows no more signs of life. SIGTERM and
    SIGINT end it in order."""
    signs = pulse.Pipe()
    process = subprocess.Popen(  # noqa: S603  # `ray start`
        command,
        stdout=subprocess.DEVNULL,  # Ray's welcome; its errors are on standard error
        env=os.environ | {pulse.VARIABLE: str(signs.writer)},
        pass_fds=[signs.writer],
        preexec_fn=partial(end_with_parent, signal.SIGTERM),  # noqa: PLW1509  # this process has no threads
    )
    signals: list[int] = []

    def end(number: int, _frame: object) -> None:
        signals.append(number)
        process.terminate()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, end)
    seen: set[str] = set()
    while process.poll() is None:
        if signs.is_silent() and signs.process > 0:  # Ray shows none
            log.error("the process shows no sign of life; ending it")
            process.kill()
            process.wait()
            return 1
        running = VITAL & {name for _, name, fields in processes() if int(fields[1]) == process.pid and fields[0] not in "ZT"}
        if seen - running and not signals and process.poll() is None:
            log.error("Ray's %s ended; stopping this node", " and ".join(sorted(seen - running)))
            process.terminate()
            try:
                process.wait(END_SECONDS)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            return 1
        seen |= running
        time.sleep(poll_seconds)
    if seen and not signals:
        log.error("Ray ended with code %d, and this node with it; start it again", process.returncode)
    return process.returncode


def start_logging() -> None:
    """Logs to standard error, as the server does."""
    logging.Formatter.converter = time.gmtime
    logging.basicConfig(
        level=logging.INFO,
        format="%(asctime)s.%(msecs)03dZ %(levelname)-7s node       %(message)s",
        datefmt="%Y-%m-%dT%H:%M:%S",
    )


if __name__ == "__main__":
    start_logging()
    sys.exit(guard(sys.argv[1:]))
