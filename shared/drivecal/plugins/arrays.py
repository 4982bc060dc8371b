"""Array files of learned plug-ins: plain `.npz` files that contain no executable content and are checked bit by bit.

In addition to its arrays a file holds a `format` (purpose and version of the layout) and the `digest` of all arrays.
"""

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
"""Largest size of a file in bytes; drivecal writes no larger ones."""
_FORMAT, _DIGEST = "format", "digest"

Array = npt.NDArray[Any]


class DamagedArraysError(UnavailableError):
    """An array file is missing, damaged or of another kind, and none of it was used. Reinstalling drivecal repairs it."""

    def __init__(self, path: str, reason: str) -> None:
        super().__init__(path, reason)
        self.path, self.reason = path, reason

    def __str__(self) -> str:
        return f"{self.path} cannot be used: {self.reason}; reinstall the package that it belongs to, or train it again"


@dataclass(frozen=True, slots=True)
class Expected:
    """Data type and shape of an array: `dtype` is numpy's name (`float64`); None stands for any length."""

    dtype: str
    shape: tuple[int | None, ...]


def content_digest(arrays: Mapping[str, Array]) -> str:
    """Returns the digest of names, data types, shapes and values, independent of order and compression."""
    parts = []
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        parts.append(f"{name} {array.dtype.str} {array.shape}\n".encode() + array.tobytes())
    return digest(b"".join(parts))


def write_arrays(path: Path, kind: str, arrays: Mapping[str, Array]) -> None:
    """Writes an array file; equal arrays give equal bytes. `kind` names their purpose and the version of their layout."""
    labels = {_FORMAT: np.array(kind), _DIGEST: np.array(content_digest(arrays))}
    with path.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **labels, **arrays)


def read_arrays(path: Path, kind: str, expected: Mapping[str, Expected]) -> dict[str, Array]:
    """Reads all arrays of a file.

    Raises DamagedArraysError unless the file is of this `kind`, holds exactly the `expected` arrays, all values are finite, and the digest
    matches.
    """
    try:
        if path.stat().st_size > LARGEST:
            raise DamagedArraysError(path.name, f"it has more than {LARGEST} bytes")
        with np.load(path, allow_pickle=False) as file:
            arrays: dict[str, Array] = dict(file)
    except (
        OSError,
        ValueError,
        KeyError,
        EOFError,
        zipfile.BadZipFile,
        zlib.error,
        AttributeError,
        RuntimeError,  # of zipfile: an encrypted entry or an unknown compression
    ) as error:
        raise DamagedArraysError(
            path.name, f"it cannot be read ({' '.join(str(error).split()) or type(error).__name__})"
        ) from error
    label, stored_digest = arrays.pop(_FORMAT, None), arrays.pop(_DIGEST, None)
    if label is None or str(label) != kind:
        raise DamagedArraysError(path.name, f"it is no {kind}" + ("" if label is None else f", but {str(label)[:80]}"))
    if arrays.keys() != expected.keys():
        raise DamagedArraysError(path.name, f"it holds {', '.join(sorted(arrays))} instead of {', '.join(sorted(expected))}")
    for name, array in arrays.items():
        _check(path, name, array, expected[name])
    if stored_digest is None or str(stored_digest) != content_digest(arrays):
        raise DamagedArraysError(path.name, "its content has changed (the digest differs)")
    return arrays


def _check(path: Path, name: str, array: Array, expected: Expected) -> None:
    lengths = zip(array.shape, expected.shape, strict=False)
    fits = array.ndim == len(expected.shape) and all(required in {None, length} for length, required in lengths)
    if array.dtype != np.dtype(expected.dtype) or not fits:
        shape = tuple("any" if length is None else length for length in expected.shape)
        raise DamagedArraysError(
            path.name, f"{name} is {array.dtype} of shape {array.shape} instead of {expected.dtype} of shape {shape}"
        )
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise DamagedArraysError(path.name, f"{name} holds a value that is not finite")
