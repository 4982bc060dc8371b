"""Files of a session's simulator: the room that they take, its limits, and their removal. Of Linux; standard library only.

Room is counted in folders, and without a name in processes that keep files open or mapped. Folders are removed however a simulator has
left them: `shutil.rmtree` and `os.walk` of Python 3.11 recurse, so that a thousand nested folders end them with RecursionError, which
`ignore_errors` does not hold back. Here each folder is moved up before its content is removed: two descriptors suffice for any depth,
and no path gets too long.
"""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

TRIES = 5
"""Passes over a folder while a process still writes there."""
_FOLDER = os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC


def remove(folder: Path) -> None:
    """Removes a folder with all that is in it. Follows no link, and leaves a link in the folder's place as it is.

    Raises nothing: what cannot be removed stays, such as files of other users and of a process that writes faster.
    """
    for _ in range(TRIES):
        with contextlib.suppress(OSError):
            top = _opened(str(folder))
            try:
                _empty(top)
            finally:
                os.close(top)
        try:
            folder.rmdir()
        except FileNotFoundError:
            return
        except OSError:
            continue
        return


def _empty(top: int) -> None:
    """Removes what is in a folder. Moves deeper folders into it first, under names that nothing else has."""
    prefix = os.urandom(8).hex()
    moved = 0
    waiting = list(_stripped(top))
    while waiting:
        name = waiting.pop()
        with contextlib.suppress(OSError):
            descriptor = _opened(name, top)
            try:
                for deeper in _stripped(descriptor):
                    moved += 1
                    with contextlib.suppress(OSError):
                        _move(deeper, descriptor, f"{prefix}-{moved}", top)
                        waiting.append(f"{prefix}-{moved}")
            finally:
                os.close(descriptor)
            os.rmdir(name, dir_fd=top)


def _stripped(descriptor: int) -> Iterator[str]:
    """Removes everything from a folder but the folders in it, and yields their names."""
    with os.scandir(descriptor) as entries:
        for entry in entries:
            with contextlib.suppress(OSError):
                if entry.is_dir(follow_symlinks=False):
                    yield entry.name
                else:
                    os.unlink(entry.name, dir_fd=descriptor)


def _move(name: str, source: int, new_name: str, target: int) -> None:
    try:
        os.rename(name, new_name, src_dir_fd=source, dst_dir_fd=target)
    except PermissionError:  # a folder changes with its parent, so that moving it takes the right to write to it
        os.close(_opened(name, source))
        os.rename(name, new_name, src_dir_fd=source, dst_dir_fd=target)


def _opened(name: str, parent: int | None = None) -> int:
    """Opens a folder, with all rights for its owner. Raises OSError if it is gone, a link, or another user's."""
    handle = os.open(name, os.O_PATH | _FOLDER, dir_fd=parent)  # takes no rights
    try:
        if os.fstat(handle).st_mode & 0o700 != 0o700:
            os.chmod(f"/proc/self/fd/{handle}", 0o700)  # noqa: PTH101  # a path could meanwhile lead elsewhere
        return os.open(".", os.O_RDONLY | _FOLDER, dir_fd=handle)
    finally:
        os.close(handle)


_DELETED = b" (deleted)"
_IN_MEMORY = ("/memfd:", "/dev/shm/")  # noqa: S108  # only compared with
_DEAD = (b"Z", b"X")


MOST_LOOKS = 200_000
"""Limit of the descriptors at which a count of files without a name looks: a second."""
SOCKET_BYTES = 208 << 10
"""Bytes that each socket counts (`net.core.wmem_default` of Linux); larger buffers are not counted."""
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
    """Bytes of memory by device and inode, of memfd_create, of files that were in /dev/shm, and of sockets."""
    is_complete: bool = True
    """All processes show their files, and all threads were looked at."""


def count_written(folder: str, most: int) -> tuple[int, int]:
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


def find_nameless(numbers: Iterable[int], folder: str, *, of_every_thread: bool = True) -> Nameless:
    """Returns what processes keep open of files without a name, of a folder and in memory.

    `of_every_thread`: a thread can have descriptors of its own, and the first thread's end with it. A look at one takes six microseconds.
    Raises UncountableError if the processes have too many; most threads share the first's, so that too many of threads are left out.
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


def find_mapped(numbers: Iterable[int], folder: str) -> dict[int, int]:
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
    if stat.S_ISSOCK(status.st_mode):
        kept.in_memory[status.st_dev, status.st_ino] = SOCKET_BYTES
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


MOST_DISK_MB = 16_384
"""Limit of the files in a scratch folder. If less of the disk is free when the session opens, nine tenths of that."""
MOST_FILES = 1_000_000
"""Limit of the files and folders in a scratch folder."""
NOTICED_MB, NOTICED_FILES = 64, 10_000
"""Loss of the disk's free room after which the files in the scratch folder are counted."""
SCARCE = 0.05
"""Share of a disk: if less is free, a session whose files take more than that ends, because several fill a disk together."""


@dataclass(frozen=True, slots=True)
class Room:
    """Free megabytes and files of a disk, and whether it is almost full."""

    megabytes: int
    files: int
    is_scarce: bool = False

    @classmethod
    def of(cls, folder: Path) -> Room:
        """Returns what is free on a folder's disk."""
        disk = os.statvfs(folder)
        return cls(disk.f_bavail * disk.f_frsize >> 20, disk.f_favail, disk.f_bavail < SCARCE * disk.f_blocks)

    def lost(self, since: Room) -> bool:
        """Returns whether the disk has lost so much since then that files are worth counting."""
        return self.megabytes <= since.megabytes - NOTICED_MB or self.files <= since.files - NOTICED_FILES


class Disk:
    """The disk below a scratch folder. Files of the session count if they have no name as well, as long as a process has them."""

    def __init__(self, folder: Path, memory_mb: int) -> None:
        """`memory_mb`: the limit of the session's memory, which holds for its files as well if these lie in memory."""
        self._folder = folder
        self._counted = self._opened = Room.of(folder)
        """The room at the last count, and when the session opened."""
        self._most_mb = min(MOST_DISK_MB, self._opened.megabytes * 9 // 10)
        if is_in_memory(str(folder)):
            self._most_mb = min(self._most_mb, memory_mb)

    def excess(self, processes: Collection[int]) -> str | None:
        """Returns how the files exceed a limit, None if they do not. They are counted only if the disk has lost room or is almost full.

        `processes`: the number of a living thread of each process of the session.
        """
        room = Room.of(self._folder)
        if not room.lost(self._counted) and not room.is_scarce:
            return None
        try:
            taken, files = count_written(str(self._folder), MOST_FILES)
            nameless = find_nameless(processes, str(self._folder))
            mapped = find_mapped(processes, str(self._folder))
        except UncountableError as error:
            return f"its files cannot be counted: {error}"
        taken += sum((mapped | nameless.on_disk).values())
        taken >>= 20
        self._counted = room
        if room.is_scarce and taken > max(NOTICED_MB, room.megabytes):
            return f"its files take {taken:,} MB of a disk that has {room.megabytes:,} MB left"
        if room.is_scarce and not nameless.is_complete and room.lost(self._opened):
            return f"it hides its open files, and the disk has {room.megabytes:,} MB left"
        if taken > self._most_mb or files > MOST_FILES:
            most = f"{self._most_mb:,} MB or {MOST_FILES:,} files"
            return f"its files take {taken:,} MB of disk ({files:,} files), more than {most}"
        return None
