"""Returns the memory of large requests to the operating system."""

import ctypes
import gc
import sys
from functools import cache
from typing import Any

M_ARENA_MAX = -8
"""Constant of glibc's malloc.h."""


def settle() -> None:
    """Lets all threads share two pools of memory, because glibc's pools per thread do not reuse each other's memory. Call it first."""
    libc = _libc()
    if libc is not None and hasattr(libc, "mallopt"):
        libc.mallopt(M_ARENA_MAX, 2)


def give_back() -> None:
    """Returns freed memory to the system, which glibc otherwise keeps."""
    gc.collect(1)  # what failed holds on to the frames that it failed in
    libc = _libc()
    if libc is not None and hasattr(libc, "malloc_trim"):
        libc.malloc_trim(0)


@cache
def _libc() -> Any:
    return ctypes.CDLL(None) if sys.platform.startswith("linux") else None
