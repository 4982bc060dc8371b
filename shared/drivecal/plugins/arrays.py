"""Array files of learned plug-ins: plain `.npz` files, which contain no executable content."""

import zipfile
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np
import numpy.typing as npt

from drivecal.domain.errors import UnavailableError
from drivecal.domain.setups import digest

Array = npt.NDArray[Any]


class DamagedArraysError(UnavailableError):
    """An array file is missing or damaged, and none of it was used. Reinstalling drivecal repairs it."""

    def __init__(self, path: str, reason: str) -> None:
        super().__init__(path, reason)
        self.path, self.reason = path, reason

    def __str__(self) -> str:
        return f"{self.path} cannot be used: {self.reason}; reinstall the package that it belongs to, or train it again"


def content_digest(arrays: Mapping[str, Array]) -> str:
    """Returns the digest of names, data types, shapes and values, independent of order and compression."""
    parts = []
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        parts.append(f"{name} {array.dtype.str} {array.shape}\n".encode() + array.tobytes())
    return digest(b"".join(parts))


def read_arrays(path: Path, names: Iterable[str]) -> dict[str, Array]:
    """Returns the arrays of these names of a file. Raises DamagedArraysError if it cannot be read, or lacks one."""
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in names}
    except (OSError, ValueError, KeyError, EOFError, RuntimeError, TokenError, zipfile.BadZipFile, zlib.error) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise DamagedArraysError(path.name, f"it cannot be read ({reason})") from error
