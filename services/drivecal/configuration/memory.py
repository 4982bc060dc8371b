"""Returns memory that a server's process no longer uses to the operating system."""

import ctypes
import gc
import time
from threading import Thread

M_ARENA_MAX = -8
"""Constant of glibc's malloc.h."""
EVERY_SECONDS = 60.0
"""Pause between two times at which memory is given back; one takes some milliseconds."""
_LIBC = ctypes.CDLL(None)  # which has the functions below if it is glibc


def settle() -> None:
    """Lets all threads share two pools of memory, because glibc's pools per thread do not reuse each other's memory, and gives memory back
    from time to time. Call it first in a process."""
    if hasattr(_LIBC, "mallopt"):
        _LIBC.mallopt(M_ARENA_MAX, 2)
        Thread(target=_give_back_now_and_then, name="memory", daemon=True).start()


def give_back() -> None:
    """Returns freed memory to the system, which glibc otherwise keeps."""
    gc.collect(1)  # what failed holds on to the frames that it failed in
    if hasattr(_LIBC, "malloc_trim"):
        _LIBC.malloc_trim(0)


def _give_back_now_and_then() -> None:
    while True:
        time.sleep(EVERY_SECONDS)
        give_back()
