"""Confinement of simulators: rules of Landlock, and a filter of system calls. The keeper imports this: standard library only.

Landlock (https://docs.kernel.org/userspace-api/landlock.html): a confined process writes below its own folders only, cannot read hidden
files, cannot debug processes outside, and reads neither their memory nor their environment. From Linux 6.12 on it cannot signal them,
nor connect to their abstract sockets. Its descendants inherit all of that, and none can leave it. It needs no privileges and holds root
as well.

What Landlock does not hold back, the filter of `system_calls` and the mounts of `seclusion` do.
"""

import contextlib
import ctypes
import glob
import os
from collections.abc import Collection, Iterator
from pathlib import Path

_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446
"""System calls; equal numbers on all architectures."""
_VERSION, _PATH_BENEATH = 1, 1
_SCOPE_ABSTRACT_SOCKET, _SCOPE_SIGNAL = 1 << 0, 1 << 1
_PR_SET_NO_NEW_PRIVS = 38
_WRITE_FILE, _READ_FILE = 1 << 1, 1 << 2
_REMOVE_FILE, _MAKE_REGULAR, _REFER, _TRUNCATE = 1 << 5, 1 << 8, 1 << 13, 1 << 14
_CHANGE_TREE = 0x1FF0
"""Removes and makes entries of folders, of all kinds."""
_OF_FILES = _WRITE_FILE | _READ_FILE | _TRUNCATE
_CAPABILITIES_3 = 0x20080522
_KEPT = 0x8464FB
"""Capabilities of root that a simulator may need: for files of all users, other users, low ports, locked memory, priorities."""
_DEVICES = ("null", "zero", "full", "random", "urandom", "tty", "ptmx", "dri", "dxg", "infiniband", "kfd", "nvidia*")
"""Devices in /dev that simulators use: the standard ones, GPUs, and fast networks. Others would be the user's terminals and root's
disks. `tty` is a process's own terminal, which a simulator has not."""
SHARED_MEMORY = "/dev/shm"  # noqa: S108  # semaphores and shared memory of the C library
SCOPES_SINCE, TRUNCATION_SINCE = 6, 3
"""Versions of Landlock that hold back signals and abstract sockets, and that hold back `truncate`."""
AUDITS_SINCE = SCOPES_SINCE + 1
"""Version that tells the audit log."""
_QUIET = 1 << 0
"""Flag: refusals of this program are not logged. A signal to all processes is refused for each that is no descendant."""
MOST_RULES = 20_000
"""Limit of the rules of a session; a rule takes four microseconds at its start. A path that would need more is not hidden."""

_library = ctypes.CDLL(None, use_errno=True)


class _Ruleset(ctypes.Structure):
    _fields_ = [("files", ctypes.c_uint64), ("network", ctypes.c_uint64), ("scoped", ctypes.c_uint64)]  # ctypes reads it


class _Capabilities(ctypes.Structure):
    _fields_ = [("effective", ctypes.c_uint32), ("permitted", ctypes.c_uint32), ("inheritable", ctypes.c_uint32)]  # as above


class _Beneath(ctypes.Structure):
    _pack_ = 1
    _fields_ = [("access", ctypes.c_uint64), ("parent", ctypes.c_int32)]  # ctypes reads it


def version() -> int:
    """Returns the version of Landlock on this machine, 0 without it."""
    return max(0, int(_library.syscall(_CREATE_RULESET, None, ctypes.c_size_t(0), _VERSION)))


def ruleset(
    writable: Collection[str], readable: Collection[str] = (), hidden: Collection[str] = (), shared_memory: str | None = None
) -> int | None:
    """Returns a descriptor of rules for `confine`, None without Landlock.

    Paths that are not `hidden` may be read if they exist now; if some are, of /dev only the usual devices and what is `writable`.

    Args:
        writable: folders that may be read and changed.
        readable: what may be read in hidden folders.
        hidden: files and folders that may not be read.
        shared_memory: a /dev/shm of the session's own.
    """
    known = version()
    if not known:
        return None
    writing = _WRITE_FILE | _CHANGE_TREE | (_REFER if known > 1 else 0) | (_TRUNCATE if known >= TRUNCATION_SINCE else 0)
    secret = {os.path.realpath(path) for path in (*hidden, "/dev")} if hidden else set()
    beside = _beside(secret) if secret else []
    if secret and not beside:
        secret = _affordable(secret)
        beside = _beside(secret) if secret else []
    reading = _READ_FILE if beside else 0
    attributes = _Ruleset(writing | reading, 0, _SCOPE_SIGNAL | _SCOPE_ABSTRACT_SOCKET if known >= SCOPES_SINCE else 0)
    size = ctypes.c_size_t(ctypes.sizeof(attributes) if known >= SCOPES_SINCE else 8)
    rules = int(_library.syscall(_CREATE_RULESET, ctypes.byref(attributes), size, 0))
    if rules < 0:
        return None
    devices = writing & (_WRITE_FILE | _TRUNCATE)
    for path, access in (
        *((path, writing | reading) for path in writable),
        *((path, devices | reading) for name in _DEVICES for path in glob.glob(f"/dev/{name}")),  # noqa: PTH207  # fewer imports
        *(((shared_memory, devices | reading | _MAKE_REGULAR | _REMOVE_FILE),) if shared_memory else ()),
        *((path, reading) for path in readable if beside and _is_below(path, secret)),
        *((path, reading) for path in beside),
    ):
        _allow(rules, path, access)
    return rules


def keep_signals() -> bool:
    """Holds the signals of this process and its descendants to each other, for good, and takes the right to gain privileges from them;
    returns whether the kernel does that."""
    if version() < SCOPES_SINCE:
        return False
    attributes = _Ruleset(_REFER, 0, _SCOPE_SIGNAL)
    rules = int(_library.syscall(_CREATE_RULESET, ctypes.byref(attributes), ctypes.c_size_t(ctypes.sizeof(attributes)), 0))
    if rules < 0:
        return False
    try:
        if not _allow(rules, "/", _REFER):  # else forbidden by all rules
            return False
        check_call(_library.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0))
        check_call(_library.syscall(_RESTRICT_SELF, rules, _QUIET if version() >= AUDITS_SINCE else 0))
    except OSError:
        return False
    finally:
        os.close(rules)
    return True


def confine(rules: int | None) -> None:
    """Confines this process for good, and takes the right to gain privileges from it, and from root most capabilities. Raises OSError."""
    check_call(_library.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0))
    _drop_capabilities()
    if rules is not None:
        check_call(_library.syscall(_RESTRICT_SELF, rules, 0))


def _drop_capabilities() -> None:
    """Root may read the environment of all processes, load modules, set clocks. `no_new_privs` keeps it from getting that back."""
    header, sets = (ctypes.c_uint32 * 2)(_CAPABILITIES_3, 0), (_Capabilities * 2)()
    check_call(_library.capget(header, sets))
    for half, kept in zip(sets, (_KEPT & 0xFFFFFFFF, _KEPT >> 32), strict=True):
        half.effective, half.permitted, half.inheritable = half.effective & kept, half.permitted & kept, half.inheritable & kept
    check_call(_library.capset(header, sets))


def _allow(rules: int, path: str, access: int) -> bool:
    """Adds a rule; a path that is gone, or that no rule can name, stays forbidden. Returns whether it was added."""
    with contextlib.suppress(OSError):
        descriptor = os.open(path, os.O_PATH | os.O_CLOEXEC)
        try:
            is_folder = os.path.isdir(path)  # noqa: PTH112  # many paths
            rule = _Beneath(access if is_folder else access & _OF_FILES, descriptor)
            return bool(_library.syscall(_ADD_RULE, rules, _PATH_BENEATH, ctypes.byref(rule), 0) == 0)
        finally:
            os.close(descriptor)
    return False


def _is_below(path: str, folders: Collection[str]) -> bool:
    real = Path(os.path.realpath(path))
    return any(real.is_relative_to(folder) for folder in folders)


def check_call(result: int) -> None:
    """Raises OSError with the reason of a call of the C library, unless its result is 0."""
    if result:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def _beside(hidden: Collection[str]) -> list[str]:
    """Returns paths that together hold everything but the hidden ones: their siblings and the siblings of each folder above them.

    Returns nothing if these are too many.
    """
    above = {str(parent) for path in hidden for parent in Path(path).parents}
    paths: list[str] = []
    for path in _walk("/", above, hidden):
        paths.append(path)
        if len(paths) > MOST_RULES:
            return []
    return paths


def _affordable(hidden: Collection[str]) -> set[str]:
    """Returns the paths that can be hidden together, by number of rules needed, least first."""
    chosen: set[str] = set()
    needed = {path: beside for path in hidden if (beside := _beside({path}))}
    for path in sorted(needed, key=lambda path: len(needed[path])):
        if _beside(chosen | {path}):
            chosen.add(path)
    return chosen


def _walk(folder: str, above: Collection[str], hidden: Collection[str]) -> Iterator[str]:
    try:
        entries = os.scandir(folder)
    except OSError:
        return
    with entries:
        for entry in entries:
            if entry.path in hidden or entry.is_symlink():  # where a link leads is among the paths
                continue
            if entry.path in above:
                yield from _walk(entry.path, above, hidden)
            else:
                yield entry.path
