"""Termination of a process with its parent. Imports almost nothing, because the guardian of every process needs it."""

import ctypes
import sys

PR_SET_PDEATHSIG = 1


def end_with_parent(number: int) -> None:
    """Sends signal `number` to this process when its parent is gone, for any reason (Linux only). Call it in the child, before exec."""
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, number)
