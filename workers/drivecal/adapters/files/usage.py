"""Room that a simulator's files take: in folders, and without a name in processes that keep them open or mapped. Of Linux."""

import contextlib
import os
import stat
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

_DELETED = b" (deleted)"
_IN_MEMORY = ("/memfd:", "/dev/shm/")  # noqa: S108  # only compared with
_DEAD = (b"Z", b"X")


MOST_LOOKS = 200_000
"""Limit of the descriptors at which a count of files without a name looks: a second."""
MOST_MAPPINGS = 1_000_000
"""Limit of the mappings, as above."""


class UncountableError(Exception):
    """Files cannot be counted: a folder hides them, or they are too many."""


@dataclass(slots=True)
class Nameless:
    """Files that processes keep open after their removal, or that never had a name."""

    on_disk: dict[int, int] = field(default_factory=dict)
    """Bytes of disk by inode, of files that were in the folder."""
    in_memory: dict[tuple[int, int], int] = field(default_factory=dict)
    """Bytes of memory by device and inode, of memfd_create and of files that were in /dev/shm."""
    is_complete: bool = True
    """Whether all processes show their files, and all threads were looked at."""


def written(folder: str, most: int) -> tuple[int, int]:
    """Returns how many bytes of disk the files below a folder take, and how many files and folders there are; counts `most` + 1 at most.

    Raises UncountableError at a folder that cannot be read, or whose path is too long.
    """
    taken = entries = 0
    folders = [folder]
    while folders:
        path = folders.pop()
        try:
            with os.scandir(path) as listed:
                for entry in listed:
                    entries += 1
                    if entries > most:
                        return taken, entries
                    if entry.is_dir(follow_symlinks=False):
                        folders.append(entry.path)
                        continue
                    try:
                        taken += entry.stat(follow_symlinks=False).st_blocks * 512
                    except FileNotFoundError:  # removed meanwhile; the others count all the same
                        continue
        except (FileNotFoundError, NotADirectoryError):  # removed or replaced meanwhile
            continue
        except OSError as error:
            raise UncountableError(f"{os.strerror(error.errno or 0)}: {path[:200]}") from error
    return taken, entries


def nameless(numbers: Iterable[int], folder: str, *, of_every_thread: bool = True) -> Nameless:
    """Returns what processes keep open of files without a name, of a folder and in memory.

    `of_every_thread`: a thread can have descriptors of its own, and those of the first end with it. A look at one takes six microseconds.
    Raises UncountableError if the processes have too many; most threads share those of the first, so that too many of threads are left out.
    """
    kept, looks = Nameless(), 0
    for number in numbers:
        tasks = _listed(f"/proc/{number}/task") if of_every_thread else [str(number)]
        for path in (f"/proc/{number}/task/{task}" for task in tasks):
            looks += 1
            try:
                descriptors = os.listdir(f"{path}/fd")  # noqa: PTH208  # often
            except PermissionError:
                kept.is_complete = kept.is_complete and _is_dead(path)
                continue
            except OSError:  # ended
                continue
            looks += len(descriptors)
            if looks > MOST_LOOKS:
                if of_every_thread:
                    kept.is_complete = False
                    return kept
                raise UncountableError(f"its processes have more than {MOST_LOOKS:,} files open")
            for descriptor in descriptors:
                with contextlib.suppress(OSError):  # closed meanwhile
                    _add(kept, f"{path}/fd/{descriptor}", folder)
    return kept


def mapped(numbers: Iterable[int], folder: str) -> dict[int, int]:
    """Returns the sizes in bytes, by inode, that files of a folder have at least in mappings of processes, after their removal.

    Raises UncountableError if there are too many mappings.
    """
    beginning = os.fsencode(folder) + b"/"
    sizes: dict[int, int] = {}
    looks = 0
    for number in numbers:
        for line in _lines(f"/proc/{number}/maps"):
            looks += 1
            if looks > MOST_MAPPINGS:
                raise UncountableError(f"its processes have more than {MOST_MAPPINGS:,} mappings")
            if not line.endswith(_DELETED):
                continue
            addresses, _, offset, _, inode, path = line.split(maxsplit=5)
            if path.startswith(beginning):
                start, end = (int(address, 16) for address in addresses.split(b"-"))
                sizes[int(inode)] = max(sizes.get(int(inode), 0), int(offset, 16) + end - start)
    return sizes


def is_in_memory(folder: str) -> bool:
    """Returns whether a folder lies in a file system of memory."""
    device = os.stat(folder).st_dev  # noqa: PTH116  # a text, as everywhere here
    named = f"{os.major(device)}:{os.minor(device)}".encode()
    for line in _lines("/proc/self/mountinfo"):
        mount, _, system = line.partition(b" - ")
        if mount.split()[2] == named:
            return system.split()[0] in {b"tmpfs", b"ramfs"}
    return False


def _add(kept: Nameless, descriptor: str, folder: str) -> None:
    status = os.stat(descriptor)  # noqa: PTH116  # follows the link to the file itself
    if status.st_nlink or not stat.S_ISREG(status.st_mode):
        return
    path = os.readlink(descriptor)  # noqa: PTH115  # as above
    if path.startswith(f"{folder}/"):
        kept.on_disk[status.st_ino] = status.st_blocks * 512
    elif path.startswith(_IN_MEMORY):
        kept.in_memory[status.st_dev, status.st_ino] = status.st_blocks * 512


def _is_dead(task: str) -> bool:
    """Returns whether a thread has ended, so that it keeps no files; /proc then shows them to root only."""
    return not any(not line.rpartition(b") ")[2].startswith(_DEAD) for line in _lines(f"{task}/stat"))


def _listed(folder: str) -> list[str]:
    try:
        return os.listdir(folder)  # noqa: PTH208  # as above
    except OSError:
        return []


def _lines(path: str) -> Iterator[bytes]:
    """Yields the lines of a file without their ends; none of a process that is gone or hides them."""
    with contextlib.suppress(OSError), open(path, "rb") as file:  # noqa: PTH123  # as above
        for line in file:
            yield line.rstrip(b"\n")
