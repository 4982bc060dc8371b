"""CPUs of a process, within the limits of its container, and its temporary folders."""

import fcntl
import math
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

CONTROL_GROUPS = Path("/sys/fs/cgroup")
OWN_GROUPS = Path("/proc/self/cgroup")
"""Control groups of this process, a line each: `number:controllers:path`. Version 2 names no controllers."""


A_MOMENT = 60.0
"""Age (s) from which a folder that its process locks has its lock."""


def locked_folder(parent: Path, prefix: str, remove: Callable[[Path], None]) -> tuple[Path, int]:
    """Returns a new private folder and a descriptor, whose lock holds while this process or a child with it lives. The folders of this
    prefix that killed processes left are removed."""
    for folder in parent.glob(f"{prefix}*"):
        _remove_if_left_behind(folder, remove)
    created = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
    lock = os.open(created, os.O_RDONLY)
    with suppress(OSError):  # a disk without locks: its folders stay
        fcntl.flock(lock, fcntl.LOCK_SH)
    return created, lock


def _remove_if_left_behind(folder: Path, remove: Callable[[Path], None]) -> None:
    with suppress(OSError):  # gone, another user's, or locked: its process lives
        descriptor = os.open(folder, os.O_RDONLY | os.O_NOFOLLOW | os.O_DIRECTORY)
        try:
            status = os.fstat(descriptor)
            if status.st_uid == os.geteuid() and time.time() - status.st_ctime > A_MOMENT:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                remove(folder)
        finally:
            os.close(descriptor)


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
