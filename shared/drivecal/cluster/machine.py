"""CPUs that this process may use: all of its machine, within the limits of its container."""

import math
import os
from collections.abc import Iterator
from pathlib import Path

CONTROL_GROUPS = Path("/sys/fs/cgroup")
OWN_GROUPS = Path("/proc/self/cgroup")
"""Control groups of this process, a line each: `number:controllers:path`. Version 2 names no controllers."""


def cpus() -> int:
    """Returns the number of CPUs that this process may use, with a quota of CPU time rounded up."""
    number = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    for folder in _groups():
        quota, _, period = _content(folder / "cpu.max").partition(" ")
        if not quota:
            quota, period = _content(folder / "cpu.cfs_quota_us"), _content(folder / "cpu.cfs_period_us")
        if quota.isdecimal() and period.isdecimal() and int(period):  # else `max`, or -1
            number = min(number, max(1, math.ceil(int(quota) / int(period))))
    return number


def _groups() -> Iterator[Path]:
    """Yields the folders of the control group of this process and of those around it: each may hold a limit."""
    for line in _content(OWN_GROUPS).splitlines():
        _, controllers, path = line.split(":", 2)
        if controllers and "cpu" not in controllers.split(","):
            continue
        root = CONTROL_GROUPS / "cpu" if controllers else CONTROL_GROUPS
        own = root / path.lstrip("/")
        yield from (folder for folder in (own, *own.parents) if folder.is_relative_to(root))


def _content(file: Path) -> str:
    try:
        return file.read_text().strip()
    except OSError:
        return ""
