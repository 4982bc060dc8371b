"""Scratch folders and environments of child processes."""

import os
import re
import tempfile
from collections.abc import Collection, Mapping
from pathlib import Path

from drivecal.adapters.keeper import remove

_INHERITED = re.compile(r"PATH|LANG|LC_\w+|TZ|LD_LIBRARY_PATH|PYTHONHASHSEED|\w+_LICENSE\w*")
"""Names of variables that every child gets: what programs need to start, to write numbers and dates, and to reach licence servers."""
_THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""A worker is one of several on its machine, so that a simulator gets one thread if nothing else is set."""


class Scratch:
    """Folder of one session: `work`, a working directory with links to the bundle's files, and `home` for temporary files.

    Programs find the bundle's files by relative paths and write beside the links, so that the bundle stays as it is.
    """

    def __init__(self, bundle: Path) -> None:
        """Creates the folder in the system's temporary folder."""
        self._bundle = bundle.resolve()
        self.folder = Path(tempfile.mkdtemp(prefix="drivecal-run-"))
        self.work, self.home = self.folder / "work", self.folder / "home"
        self.home.mkdir()
        self.renew()

    def renew(self) -> None:
        """Empties the working directory."""
        discard(self.work)
        self.work.mkdir()
        for path in self._bundle.iterdir():
            (self.work / path.name).symlink_to(path)

    def shown(self, text: str) -> str:
        """Returns a message for people, whose paths begin in the bundle and not in temporary folders."""
        for folder in (self.work, self.home, self.folder, self._bundle):
            text = text.replace(f"{folder}/", "").replace(str(folder), ".")
        return text

    def remove(self) -> None:
        """Removes the folder. Idempotent."""
        remove(self.folder)


def discard(path: Path) -> None:
    """Removes a file, link or folder if it exists."""
    if path.is_dir() and not path.is_symlink():
        remove(path)
    else:
        path.unlink(missing_ok=True)


def environment(home: Path, named: Collection[str] = (), inherited: Mapping[str, str] | None = None) -> dict[str, str]:
    """Returns the environment of a child: a few of the worker's variables, and those that the manifest has `named`.

    An allow list, because no pattern knows all secrets. This prevents accidents, not theft: a child of the same
    user can read the worker's memory and files.
    """
    kept = {
        name: value
        for name, value in (os.environ if inherited is None else inherited).items()
        if name in named or name in _THREADS or _INHERITED.fullmatch(name)
    }
    places = dict.fromkeys(("HOME", "TMPDIR", "TMP", "TEMP"), str(home))
    return _THREADS | kept | places
