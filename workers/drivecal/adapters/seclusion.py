"""A view of the machine that is a session's own: files outside of its folders are read-only, shared memory is new and empty.

The keeper imports this: standard library only. Landlock knows neither owner, mode, times and attributes of files, nor whose memory lies in
/dev/shm. A mount namespace holds both: on a read-only mount none of them changes. Root makes one directly, others
in a user namespace that maps them to themselves (https://man7.org/linux/man-pages/man7/user_namespaces.7.html). Docker's profile,
Ubuntu 24.04 and kernels before 5.12 allow none: then a simulator uses nothing of /dev/shm, and can change what `security.md` lists.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
from collections.abc import Collection
from pathlib import Path

from drivecal.adapters.confinement import SHARED_MEMORY, check_call

_NEW_USER, _NEW_MOUNTS, _NEW_IPC = 0x10000000, 0x00020000, 0x08000000
_BIND, _RECURSIVE, _PRIVATE, _NO_SUID, _NO_DEVICES = 1 << 12, 1 << 14, 1 << 18, 1 << 1, 1 << 2
_MOUNT_SETATTR, _AT_RECURSIVE, _HERE, _READ_ONLY = 442, 0x8000, -100, 1

_library = ctypes.CDLL(None, use_errno=True)


class _Attributes(ctypes.Structure):
    _fields_ = [(name, ctypes.c_uint64) for name in ("set", "clear", "propagation", "user_namespace")]  # ctypes reads it


class Seclusion:
    """Namespaces that children enter. They last as long as this process."""

    def __init__(self, maker: int) -> None:
        """Opens the namespaces that a process has made. Raises OSError."""
        user, self._mounts = (os.open(f"/proc/{maker}/ns/{name}", os.O_RDONLY | os.O_CLOEXEC) for name in ("user", "mnt"))
        self._user = None if os.path.samestat(os.fstat(user), os.stat("/proc/self/ns/user")) else user  # noqa: PTH116  # as above
        self._memory = os.open(f"/proc/{maker}/root{SHARED_MEMORY}", os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)

    @classmethod
    def make(cls, writable: Collection[str], memory: int) -> Seclusion | None:
        """Returns new namespaces, None if the system allows none. Another process makes them, so that a failure leaves no half.

        Args:
            writable: files and folders that stay writable. /dev/shm among them stays everybody's.
            memory: limit of the files in the new /dev/shm, in bytes.
        """
        made, done = os.pipe2(os.O_CLOEXEC), os.pipe2(os.O_CLOEXEC)
        maker = os.fork()
        if maker == 0:
            with contextlib.suppress(BaseException):
                os.close(done[1])
                _separate(writable, memory)
                os.write(made[1], b"1")
                os.read(done[0], 1)  # until its namespaces are open elsewhere
            os._exit(0)
        os.close(made[1])
        try:
            return cls(maker) if os.read(made[0], 1) else None
        except OSError:
            return None
        finally:
            for descriptor in (made[0], *done):
                os.close(descriptor)
            os.waitpid(maker, 0)

    @property
    def shared_memory(self) -> str:
        """Path of the own /dev/shm, for this process."""
        return f"/proc/self/fd/{self._memory}"

    def enter(self, folder: str) -> None:
        """Moves this process into the namespaces, with semaphores, queues and memory of System V and POSIX of its own. Raises OSError.

        `folder`: its working directory, which is lost otherwise.
        """
        if self._user is not None:
            check_call(_library.setns(self._user, _NEW_USER))
        check_call(_library.setns(self._mounts, _NEW_MOUNTS))
        check_call(_library.unshare(_NEW_IPC))
        os.chdir(folder)

    def clear(self) -> None:
        """Removes what an ended child has left in /dev/shm. Does nothing if that is everybody's."""
        if os.fstat(self._memory).st_dev == os.stat(SHARED_MEMORY).st_dev:  # noqa: PTH116  # as above
            return
        for name in os.listdir(self._memory):  # noqa: PTH208  # by descriptor
            with contextlib.suppress(OSError):
                os.unlink(name, dir_fd=self._memory)


def _separate(writable: Collection[str], memory: int) -> None:
    """Makes namespaces for this process. Raises OSError."""
    if _library.unshare(_NEW_MOUNTS):
        user, group = os.geteuid(), os.getegid()
        check_call(_library.unshare(_NEW_USER | _NEW_MOUNTS))
        for name, text in (("setgroups", "deny"), ("uid_map", f"{user} {user} 1"), ("gid_map", f"{group} {group} 1")):
            Path("/proc/self", name).write_text(text)
    check_call(_library.mount(None, b"/", None, _RECURSIVE | _PRIVATE, None))
    granted = sorted({os.path.realpath(path) for path in writable if os.path.exists(path)})  # noqa: PTH110  # as below
    mounted = [line.split(" ")[4] for line in Path("/proc/self/mountinfo").read_text().splitlines()]
    below = [point for point in mounted if any(Path(point).is_relative_to(path) for path in granted)]
    kept = [path for path in ("/proc", *granted, *below) if not os.statvfs(path).f_flag & os.ST_RDONLY]
    _set("/", _Attributes(set=_READ_ONLY), _AT_RECURSIVE)
    if SHARED_MEMORY not in granted:
        options = f"size={memory},nr_inodes={memory >> 12},mode=1777".encode()
        check_call(_library.mount(b"tmpfs", SHARED_MEMORY.encode(), b"tmpfs", _NO_SUID | _NO_DEVICES, options))
    for path in granted:
        check_call(_library.mount(path.encode(), path.encode(), None, _BIND | _RECURSIVE, None))
    for path in kept:
        _set(path, _Attributes(clear=_READ_ONLY))


def _set(path: str, attributes: _Attributes, flags: int = 0) -> None:
    size = ctypes.c_size_t(ctypes.sizeof(attributes))
    check_call(_library.syscall(_MOUNT_SETATTR, _HERE, path.encode(), flags, ctypes.byref(attributes), size))
