"""Parts of a cell's result that every kind of simulation reports alike: CPU time and compressed time series."""

import gzip
import json
import time
from collections.abc import Mapping
from typing import Any

from drivecal.domain.errors import ConflictError

LARGEST_SERIES = 8_000_000
"""Largest size of compressed time series in bytes; the built-in scenarios stay far below."""


def milliseconds_since(start: int) -> float:
    """Returns the CPU time of this thread since `start` (of `time.thread_time_ns`), without Ray's own threads."""
    return (time.thread_time_ns() - start) / 1e6


def compressed(document: Mapping[str, Any]) -> bytes:
    """Returns a run with its time series as compressed JSON.

    Raises ConflictError if it is too large, and ValueError if a number is not finite.
    """
    content = gzip.compress(json.dumps(document, separators=(",", ":"), allow_nan=False).encode(), mtime=0)
    if len(content) > LARGEST_SERIES:
        raise ConflictError(
            f"the time series of the run take {len(content):,} bytes, more than the limit of {LARGEST_SERIES:,}"
        )
    return content
