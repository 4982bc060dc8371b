"""Runs `ray start --block` and ends with it: `python -m drivecal.cluster.guard COMMAND...`.

Ray's own watch takes a raylet that gives up in order, as when one of its agents has died, for a wanted end, and blocks for ever beside
nothing. Here a node without its raylet or its store of state ends, and whoever restarts it joins anew. Standard library only, so that the
guard is small.
"""

from __future__ import annotations

import logging
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from drivecal.cluster.lineage import end_with_parent

VITAL = {"raylet", "gcs_server"}
LOOK_SECONDS = 1.0
END_SECONDS = 10.0

log = logging.getLogger("drivecal.cluster")


def vital_parts(parent: int) -> set[str]:
    """Those of Ray's vital processes that run as children of a process; none on systems without /proc."""
    found = set()
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            # pid (name) state ppid ...; the name may hold anything
            head, _, rest = entry.read_text(errors="replace").rpartition(")")
        except OSError:
            continue
        state, its_parent = rest.split()[:2]
        if int(its_parent) == parent and state != "Z":
            found.add(head.partition("(")[2])
    return found & VITAL


def guard(command: Sequence[str], look_seconds: float = LOOK_SECONDS) -> int:
    """Returns the command's exit code, 1 where one of its vital parts ended before it. SIGTERM and SIGINT end it in order."""
    process = subprocess.Popen(  # noqa: S603  # `ray start`
        command,
        stdout=subprocess.DEVNULL,  # Ray's welcome; its errors are on standard error
        preexec_fn=partial(end_with_parent, signal.SIGTERM),  # noqa: PLW1509  # there are no threads here
    )
    asked: list[int] = []

    def end(number: int, _frame: object) -> None:
        asked.append(number)
        process.terminate()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, end)
    seen: set[str] = set()
    while process.poll() is None:
        running = vital_parts(process.pid)
        if seen - running and not asked and process.poll() is None:
            log.error("Ray's %s ended, and so does this node", " and ".join(sorted(seen - running)))
            process.terminate()
            try:
                process.wait(END_SECONDS)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            return 1
        seen |= running
        time.sleep(look_seconds)
    return process.returncode


if __name__ == "__main__":
    logging.basicConfig(
        format="%(asctime)s.%(msecs)03dZ %(levelname)-7s node       %(message)s", datefmt="%Y-%m-%dT%H:%M:%S", force=True
    )
    logging.Formatter.converter = time.gmtime
    sys.exit(guard(sys.argv[1:]))
