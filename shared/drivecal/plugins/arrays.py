"""Files of arrays that learned plug-ins are shipped with: plain `.npz`, nothing in it can be executed, and every bit of it is checked.

Beside the arrays a file holds a `format` (what it is for, with the version of its layout) and the `digest` of all of them.
"""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from drivecal.domain.errors import UnavailableError
from drivecal.domain.setups import digest

LARGEST = 4_000_000
"""Bytes; what is larger is not ours."""
_FORMAT, _DIGEST = "format", "digest"

Array = npt.NDArray[Any]


class DamagedArraysError(UnavailableError):
    """A file of arrays is missing, damaged, or for something else; nothing of it was used. Installing drivecal anew mends it."""

    def __init__(self, path: str, reason: str) -> None:
        super().__init__(path, reason)
        self.path, self.reason = path, reason

    def __str__(self) -> str:
        return f"{self.path} cannot be used: {self.reason}; install the package that it belongs to anew, or train it anew"


@dataclass(frozen=True, slots=True)
class Expected:
    """An array's kind and shape: `dtype` as numpy writes it (`float64`); None stands for any length."""

    dtype: str
    shape: tuple[int | None, ...]


def content_digest(arrays: Mapping[str, Array]) -> str:
    """Of names, kinds, shapes and values, whatever order they come in and however they are packed."""
    parts = []
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        parts.append(f"{name} {array.dtype.str} {array.shape}\n".encode() + array.tobytes())
    return digest(b"".join(parts))


def write_arrays(path: Path, kind: str, arrays: Mapping[str, Array]) -> None:
    """Writes a file of arrays; the same arrays give the same bytes. `kind` names what they are for and their layout's version."""
    labels = {_FORMAT: np.array(kind), _DIGEST: np.array(content_digest(arrays))}
    with path.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **labels, **arrays)


def read_arrays(path: Path, kind: str, expected: Mapping[str, Expected]) -> dict[str, Array]:
    """All arrays of a file. Raises DamagedArraysError unless it is of this `kind`, has exactly the `expected` arrays, finite all of them,
    and is what was written."""
    try:
        if path.stat().st_size > LARGEST:
            raise DamagedArraysError(path.name, f"it has more than {LARGEST} bytes")
        with np.load(path, allow_pickle=False) as file:
            found: dict[str, Array] = dict(file)
    except (
        OSError,
        ValueError,
        KeyError,
        EOFError,
        zipfile.BadZipFile,
        zlib.error,
        AttributeError,
        RuntimeError,  # of zipfile: encrypted, or packed in a way that it does not know
    ) as error:
        raise DamagedArraysError(
            path.name, f"it cannot be read ({' '.join(str(error).split()) or type(error).__name__})"
        ) from error
    label, written = found.pop(_FORMAT, None), found.pop(_DIGEST, None)
    if label is None or str(label) != kind:
        raise DamagedArraysError(path.name, f"it is no {kind}" + ("" if label is None else f", but {str(label)[:80]}"))
    if found.keys() != expected.keys():
        raise DamagedArraysError(path.name, f"it holds {', '.join(sorted(found))} instead of {', '.join(sorted(expected))}")
    for name, array in found.items():
        _check(path, name, array, expected[name])
    if written is None or str(written) != content_digest(found):
        raise DamagedArraysError(path.name, "its content is not what was written (the digest differs)")
    return found


def _check(path: Path, name: str, array: Array, expected: Expected) -> None:
    lengths = zip(array.shape, expected.shape, strict=False)
    fits = array.ndim == len(expected.shape) and all(wanted in {None, length} for length, wanted in lengths)
    if array.dtype != np.dtype(expected.dtype) or not fits:
        shape = tuple("any" if length is None else length for length in expected.shape)
        raise DamagedArraysError(
            path.name, f"{name} is {array.dtype} of shape {array.shape} instead of {expected.dtype} of shape {shape}"
        )
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise DamagedArraysError(path.name, f"{name} holds a value that is not finite")
