"""Returns memory that a server's process no longer uses to the operating system."""

import ctypes
import gc
import sys
import time
from functools import cache
from threading import Thread
from typing import Any

M_ARENA_MAX = -8
"""Constant of glibc's malloc.h."""
EVERY_SECONDS = 60.0
"""Pause between two times at which memory is given back; one takes some milliseconds."""


def settle() -> None:
    """Lets all threads share two pools of memory, because glibc's pools per thread do not reuse each other's memory, and gives memory back
    from time to time. Call it first in a process."""
    libc = _libc()
    if libc is not None and hasattr(libc, "mallopt"):
        libc.mallopt(M_ARENA_MAX, 2)
        Thread(target=_give_back_now_and_then, name="memory", daemon=True).start()


def give_back() -> None:
    """Returns freed memory to the system, which glibc otherwise keeps."""
    gc.collect(1)  # what failed holds on to the frames that it failed in
    libc = _libc()
    if libc is not None and hasattr(libc, "malloc_trim"):
        libc.malloc_trim(0)


def _give_back_now_and_then() -> None:
    while True:
        time.sleep(EVERY_SECONDS)
        give_back()


@cache
def _libc() -> Any:
    return ctypes.CDLL(None) if sys.platform.startswith("linux") else None
