"""Removal of folders that a simulator has written, however it has left them.

`shutil.rmtree` and `os.walk` of Python 3.11 recurse, so that a thousand nested folders end them with RecursionError, which
`ignore_errors` does not hold back. Here each folder is moved up before its content is removed: two descriptors suffice for any depth,
and no path gets too long.
"""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

TRIES = 5
"""Passes over a folder in which a process still writes."""
_FOLDER = os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC


def remove(folder: Path) -> None:
    """Removes a folder with all that is in it. Follows no link, and leaves a link in the folder's place as it is.

    Raises nothing: what cannot be removed stays, such as files of other users and those of a process that writes faster.
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
