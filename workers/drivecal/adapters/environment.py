"""Scratch folders and environments of child processes."""

import errno
import os
import re
import stat
import sys
import tempfile
from collections.abc import Collection
from pathlib import Path
from typing import Any

import drivecal
from drivecal.adapters.files import remove
from drivecal.bundles.archives import MANIFEST
from drivecal.cluster.homes import DATABASE_ENDINGS, remembered
from drivecal.cluster.machine import locked_folder
from drivecal.domain.errors import UnavailableError

GRANTED = "DRIVECAL_SIMULATOR_FOLDERS"
"""Environment variable: folders, separated by colons, that simulators may change besides their scratch folder. `/`: no confinement."""
_SECRETS = ("DRIVECAL_TOKENS_FILE", "DRIVECAL_DATABASE_PASSWORD_FILE", "RAY_AUTH_TOKEN_PATH")
"""Variables that name files with secrets."""

_INHERITED = re.compile(r"PATH|LANG|LC_\w+|TZ|LD_LIBRARY_PATH|\w+_LICENSE\w*")
"""Names of variables that every child gets: what programs need to start, to write numbers and dates, and to reach licence servers."""
_REFUSALS = ("ermission denied", "EACCES", "ead-only file system", "EROFS")
_DIGEST = re.compile(r"[0-9a-f]{64}")
_THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""A worker is one of several on its machine, so that a simulator gets one thread if nothing else is set."""
DRIVER = (sys.executable, "-P", "-s", "-B", "-m")
"""Start of a driver's command: no modules of the working directory, no user packages, no bytecode in the bundle's folder."""
_ONE_ORDER = {"PYTHONHASHSEED": "0"}
"""Python orders sets of texts by a secret of each process: equal runs in two processes would differ."""


class Scratch:
    """Folder of one session: `work`, a working directory with links to the bundle's files, and `home` for temporary files.

    Programs find the bundle's files by relative paths and write next to the links, so that the bundle stays as it is.
    """

    def __init__(self, bundle: Path) -> None:
        """Creates the folder in the user's private folder of sessions. Raises UnavailableError if another user could change that."""
        self.bundle = bundle.resolve()
        self.folder, self.lock = locked_folder(sessions(), "drivecal-run-l-", remove)
        self.work, self.home = self.folder / "work", self.folder / "home"
        self.is_spoilt = False
        """A process may live that nothing ends, and put links where the worker writes."""
        try:
            self.clear()
        except OSError:
            self.remove()
            raise

    def clear(self) -> None:
        """Empties all folders: what a child has left, or changed in files that its driver unpacked, would meet the next one. The manifest
        is not in the working directory: results do not depend on it. Raises OSError if the folder is spoilt."""
        if self.is_spoilt:
            raise PermissionError(errno.EPERM, "a process that cannot be ended may change the folder", str(self.folder))
        self.folder.chmod(0o700)  # a child may have taken rights away
        for path in self.folder.iterdir():
            discard(path)
        self.home.mkdir()
        self.work.mkdir()
        for path in self.bundle.iterdir():
            if path.name != MANIFEST:
                (self.work / path.name).symlink_to(path)

    def confinement(self, writable: Collection[str] = ()) -> dict[str, Any] | None:
        """Returns what the keeper's `ruleset` takes; None if the machine's owner wants no confinement. `writable`: further folders."""
        granted = [path for path in os.environ.get(GRANTED, "").split(":") if path]
        if "/" in granted:
            return None
        installed = (sys.prefix, sys.base_prefix, *(str(Path(root).parent) for root in drivecal.__path__))
        return {
            "writable": [str(self.folder), *granted, *writable],
            "readable": [*(str(path) for path in self.bundle.iterdir() if path.name != MANIFEST), *installed],
            "hidden": [str(path) for path in map(_absolute, self._hidden()) if path is not None],
        }

    def _hidden(self) -> list[Path]:
        """Files and folders with secrets of the user's servers and of other users' problems."""
        paths = [
            *remembered(),
            Path(os.environ.get("DRIVECAL_HOME") or ".drivecal"),
            Path("drivecal.toml"),
            Path("~/.ray/auth_token"),
        ]
        paths.extend(Path(os.environ[name]) for name in _SECRETS if os.environ.get(name))
        scheme, _, file = os.environ.get("DRIVECAL_DATABASE_URL", "").partition(":///")
        if scheme.startswith("sqlite") and file:
            paths.extend(Path(file + ending) for ending in DATABASE_ENDINGS)
        if _DIGEST.fullmatch(self.bundle.name):
            paths.append(self.bundle.parent)  # the cache, with others' bundles
        paths.append(self.folder.parent)  # with what other sessions have unpacked
        return paths

    def shown(self, text: str) -> str:
        """Returns a message for people, whose paths begin in the bundle and not in temporary folders."""
        for folder in (self.work, self.home, self.folder, self.bundle):
            text = text.replace(f"{folder}/", "").replace(str(folder), ".")
        if any(refusal in text for refusal in _REFUSALS):
            text += f"; it may change its working directory and $TMPDIR, and the folders of {GRANTED} on the worker"
        return text

    def remove(self) -> None:
        """Removes the folder. Idempotent."""
        if self.lock >= 0:
            let_go(self.folder, self.lock)
            self.lock = -1


def let_go(folder: Path, lock: int) -> None:
    """Removes a locked folder."""
    remove(folder)
    os.close(lock)


def sessions() -> Path:
    """Returns the private folder of all sessions of this user; creates it in the system's temporary folder."""
    folder = Path(tempfile.gettempdir(), f"drivecal-runs-{os.geteuid()}")
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.geteuid():
        raise UnavailableError(f"{folder} belongs to another user or is a link; set TMPDIR to a folder of the worker's user")
    if status.st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        folder.chmod(0o700)
    return folder


def _absolute(path: Path) -> Path | None:
    """Returns an absolute path; None if it is below the home of a user who has none."""
    try:
        return path.expanduser().absolute()
    except RuntimeError:
        return None


def discard(path: Path) -> None:
    """Removes a file, link or folder if it exists."""
    if path.is_dir() and not path.is_symlink():
        remove(path)
    else:
        path.unlink(missing_ok=True)


def environment(home: Path, named: Collection[str]) -> dict[str, str]:
    """Returns the environment of a child: a few of the worker's variables, and the ones `named` by the manifest.

    An allow list, because no pattern knows all secrets. This prevents accidents; where Landlock is missing, a child of the same user can
    read the worker's memory and files all the same.
    """
    kept = {key: value for key, value in os.environ.items() if key in named or key in _THREADS or _INHERITED.fullmatch(key)}
    places = dict.fromkeys(("HOME", "TMPDIR", "TMP", "TEMP"), str(home))
    return _THREADS | _ONE_ORDER | kept | places
