"""Cache of unpacked bundles on a node, by digest: private to the worker's user, and checked before a simulator runs from it."""

import os
import re
import stat
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from drivecal.adapters.files import remove
from drivecal.bundles.archives import folder_digest, unpack
from drivecal.bundles.installed import installed
from drivecal.domain.errors import DrivecalError, InvalidInputError, UnavailableError

CACHE = "DRIVECAL_BUNDLE_CACHE"
"""Environment variable: folder of unpacked bundles."""
LEFT_SECONDS = 3600.0
"""Age at which a partly unpacked bundle belongs to no living worker: unpacking takes seconds."""

KEPT_SECONDS = 30 * 86400.0
"""Time since its last use after which a bundle is removed, when another one is unpacked."""
_DIGEST = re.compile(r"[0-9a-f]{64}")

Signature = tuple[tuple[str, int, int, int, int, int], ...]


def cache_folder() -> Path:
    """Returns the folder of unpacked bundles: `DRIVECAL_BUNDLE_CACHE`, or the user's cache, or the user's temporary folder."""
    return writable_folder(os.environ.get(CACHE) or "~/.cache/drivecal/bundles", "drivecal-bundles")


def writable_folder(path: str, name: str) -> Path:
    """Returns a folder, created if it does not exist; the user's temporary folder of this name if that cannot be written."""
    try:
        folder = Path(path).expanduser()
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    except (OSError, RuntimeError):  # a user without a home
        return temporary_folder(name)
    return folder if os.access(folder, os.W_OK) else temporary_folder(name)


def temporary_folder(name: str) -> Path:
    """Returns a temporary folder of this name that all processes of the user share; a new one if others could change that."""
    folder = Path(tempfile.gettempdir(), f"{name}-{os.geteuid()}")
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        _refuse_others(folder)
    except (OSError, UnavailableError):
        return Path(tempfile.mkdtemp(prefix=f"{name}-"))
    return folder


class BundleCache:
    """Unpacked bundles of a node, shared by its workers: a folder for each digest, complete or absent."""

    def __init__(self, folder: Path) -> None:
        """`folder`: is created if it does not exist."""
        self._folder = folder
        self._signatures: dict[str, Signature] = {}
        """Files of bundles whose digest was checked."""
        self._failures: dict[str, str] = {}
        """Reasons why bundles could not be unpacked."""
        self._tidied = False

    def has(self, digest: str) -> bool:
        """Returns whether a bundle is there, or installed with a package."""
        return installed(digest) is not None or (self._folder / digest).is_dir()

    def folder(self, digest: str) -> Path:
        """Returns the folder of a bundle whose content is that of its digest.

        The content is read again only if a file's size, mode or times are others than at the last check. Raises UnavailableError if the
        bundle is not there, if others could change it, and if it was changed: then it is removed and sent again to the next worker, unless
        it is an installed problem.
        """
        own = installed(digest)
        folder = self._folder / digest if own is None else own.folder
        if not self.has(digest):
            reason = f": {self._failures[digest]}" if digest in self._failures else ""
            raise UnavailableError(f"the files of the bundle {digest} are not on this machine{reason}")
        for each in (self._folder, folder) if own is None else ():
            _refuse_others(each)
        signature = _signature(folder)
        if self._signatures.get(digest) != signature:
            if not _has_digest(folder, digest):
                self._signatures.pop(digest, None)
                if own is not None:
                    raise UnavailableError(f"the problem {own.manifest.problem} has changed: restart server and workers")
                remove(folder)
                raise UnavailableError(
                    f"the cached files of the bundle {digest} were changed on this machine, perhaps by its simulator; they are removed and"
                    " fetched again: let the simulator write into its working directory, and run workers as another user than root"
                )
            self._signatures[digest] = signature
        if own is None:
            self._stamp(digest).touch(mode=0o600)
        return folder

    def store(self, digest: str, archive: bytes) -> None:
        """Unpacks a bundle unless it is there. Raises InvalidInputError if the archive is unsafe or has another digest, and
        UnavailableError if others could change the cache.

        Atomic, because workers of a node share the folder.
        """
        if self.has(digest):
            return
        try:
            self._unpack(digest, archive)
        except (DrivecalError, OSError) as error:
            self._failures[digest] = str(error)
            raise
        self._failures.pop(digest, None)

    def _unpack(self, digest: str, archive: bytes) -> None:
        self._folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        _refuse_others(self._folder)
        if not self._tidied:
            self._remove_leftovers()
        try:
            unpack(archive, self._folder / digest, digest)
        except OSError:
            if not self.has(digest):  # else another worker was faster
                raise
        self._remove_unused()

    def _remove_unused(self) -> None:
        """Removes bundles that nothing has used for long."""
        for folder in self._folder.iterdir():
            stamp = self._stamp(folder.name)
            if not _DIGEST.fullmatch(folder.name):
                continue
            with suppress(OSError):  # another worker was faster
                used = (stamp if stamp.exists() else folder).lstat().st_mtime
                if time.time() - used > KEPT_SECONDS:
                    leftover = self._folder / f".{folder.name}-{os.getpid()}"  # removed later if this process is killed now
                    folder.rename(leftover)
                    remove(leftover)
                    stamp.unlink(missing_ok=True)

    def _stamp(self, digest: str) -> Path:
        """Returns the file whose time is that of a bundle's last use."""
        return self._folder / f".{digest}.used"

    def _remove_leftovers(self) -> None:
        """Removes what killed workers left of bundles that they unpacked. Only names that `unpack` makes are touched."""
        self._tidied = True
        for path in self._folder.glob(".*-*"):
            is_digest = _DIGEST.fullmatch(path.name[1:].partition("-")[0]) is not None
            try:
                status = path.lstat()
                is_old = time.time() - status.st_mtime > LEFT_SECONDS
                if is_digest and is_old and stat.S_ISDIR(status.st_mode) and status.st_uid == os.geteuid():
                    remove(path)
            except OSError:  # another worker was faster
                continue


def _refuse_others(folder: Path) -> None:
    """Raises UnavailableError if a user other than this process's could change a folder."""
    status = folder.lstat()
    remedy = f"set {CACHE} to a folder of the worker's user with mode 0700"
    if not stat.S_ISDIR(status.st_mode):
        raise UnavailableError(f"the bundle cache {folder} is a link; {remedy}")
    if status.st_uid != os.geteuid():
        raise UnavailableError(f"the bundle cache {folder} belongs to another user (uid {status.st_uid}); {remedy}")
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise UnavailableError(f"other users may write to the bundle cache {folder}; type: chmod 700 {folder}, or {remedy}")


def _has_digest(folder: Path, digest: str) -> bool:
    try:
        return folder_digest(folder) == digest
    except InvalidInputError:  # a link, a device, or more than a bundle may hold
        return False


def _signature(folder: Path) -> Signature:
    """Returns what the system knows of all files and folders. A change of content changes a time, also of a file that is set back."""
    entries = []
    for parent, folders, files in os.walk(folder):
        for name in (".", *files, *(name for name in folders if Path(parent, name).is_symlink())):
            path = os.path.join(parent, name)  # noqa: PTH118  # ten thousand files, half the time
            status = os.lstat(path)
            entries.append((path, status.st_mode, status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino))
    return tuple(sorted(entries))
