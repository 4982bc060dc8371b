"""Scratch folders and environments of child processes."""

import os
import re
import tempfile
from collections.abc import Mapping
from pathlib import Path

from drivecal.adapters.keeper import remove

_OWN = re.compile(r"(DRIVECAL|RAY|PG|PYTHON)", re.IGNORECASE)
"""Start of the names of variables that concern drivecal, its cluster and its database."""
_SECRET = re.compile(r"TOKEN|SECRET|PASSW|CREDENTIAL|PRIVATE|API_?KEY|ACCESS_?KEY|AUTH", re.IGNORECASE)
_ADDRESS_WITH_PASSWORD = re.compile(r"://[^/\s@]*:[^/\s@]*@")
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

    def remove(self) -> None:
        """Removes the folder. Idempotent."""
        remove(self.folder)


def discard(path: Path) -> None:
    """Removes a file, link or folder if it exists."""
    if path.is_dir() and not path.is_symlink():
        remove(path)
    else:
        path.unlink(missing_ok=True)


def environment(home: Path, inherited: Mapping[str, str] | None = None) -> dict[str, str]:
    """Returns the environment of a child: the worker's without drivecal's and Ray's variables and without what looks like a secret.

    This prevents accidents, not theft: a child of the same user can read the worker's memory and files.
    """
    kept = {
        name: value
        for name, value in (os.environ if inherited is None else inherited).items()
        if not (_OWN.match(name) or _SECRET.search(name) or _ADDRESS_WITH_PASSWORD.search(value))
    }
    places = dict.fromkeys(("HOME", "TMPDIR", "TMP", "TEMP"), str(home))
    return _THREADS | kept | places
