"""System calls on other processes of the user that the kernel refuses a simulator, by seccomp (https://docs.kernel.org/userspace-api/seccomp_filter.html).

Landlock holds back signals, but neither `prlimit`, which ends a process by a limit of its CPU time and keeps a server from opening files,
nor changes of priority and processors. The filter lets a program make these calls on itself: with 0 for the calling thread, or with its own
number. It passes to all descendants, which may use 0. What schedules other threads has no effect, and no error, because libraries that
place their threads (OpenMP) would end. The keeper imports this module: standard library only.
"""

import ctypes
import errno
import itertools
import os
import sys
from collections.abc import Iterator
from typing import NamedTuple

_PR_SET_SECCOMP, _MODE_FILTER = 22, 2
_SECCOMP = {"x86_64": 317, "aarch64": 277}
"""Number of the call `seccomp`."""
_SET_FILTER, _SPECULATION_AS_BEFORE = 1, 4
"""Without the flag, kernels before 5.16 slow the program down."""
_LOAD, _EQUAL, _AT_LEAST, _RETURN = 0x20, 0x15, 0x35, 0x06
_NUMBER, _ARCHITECTURE, _ARGUMENTS = 0, 4, 16
"""Offsets in `struct seccomp_data`."""
_ALLOW, _REFUSE, _UNKNOWN, _PRETEND = 0x7FFF0000, 0x00050000 | errno.EPERM, 0x00050000 | errno.ENOSYS, 0x00050000
_X32 = 0x40000000
"""Numbers from here on are those of a second table of x86-64, which hardly any kernel has."""


class _Call(NamedTuple):
    """A call whose argument `process` names a process, 0 the caller. `wide`: an argument and its value that means all processes of the
    user; `change`: a pointer without which the call only reads; `answer`: that for others."""

    process: int
    wide: tuple[int, int] | None = None
    change: int | None = None
    answer: int = _REFUSE


_CALLS = {
    "setpriority": _Call(1, wide=(0, 2)),
    "ioprio_set": _Call(1, wide=(0, 3)),
    "sched_setparam": _Call(0, answer=_PRETEND),
    "sched_setscheduler": _Call(0, answer=_PRETEND),
    "sched_setaffinity": _Call(0, answer=_PRETEND),
    "sched_setattr": _Call(0, answer=_PRETEND),
    "migrate_pages": _Call(0),
    "move_pages": _Call(0),
    "prlimit64": _Call(0, change=2),
}
_NUMBERS = {
    0xC000003E: (141, 251, 142, 144, 203, 314, 256, 279, 302),  # x86-64
    0x40000003: (97, 289, 154, 156, 241, 351, 294, 317, 340),  # its 32-bit programs
    0xC00000B7: (140, 30, 118, 119, 122, 274, 238, 239, 261),  # AArch64
    0x40000028: (97, 314, 154, 156, 241, 380, 400, 344, 369),  # its 32-bit programs
}
"""Numbers of `_CALLS`, in its order, by architecture as audits name it; Linux's syscall tables."""


class _Instruction(ctypes.Structure):
    _fields_ = [("code", ctypes.c_uint16), ("yes", ctypes.c_uint8), ("no", ctypes.c_uint8), ("value", ctypes.c_uint32)]


class _Program(ctypes.Structure):
    _fields_ = [("length", ctypes.c_uint16), ("instructions", ctypes.POINTER(_Instruction))]


def hold_to_itself() -> None:
    """Holds this process and its descendants to calls on themselves, for good; nothing on a kernel without seccomp. It must have no way to
    gain privileges (`no_new_privs`). Raises OSError."""
    if sys.byteorder != "little":  # the filter reads the lower halves of arguments; none of the architectures is another
        return
    code = [_Instruction(*instruction) for instruction in _program(os.getpid())]
    program = _Program(len(code), (_Instruction * len(code))(*code))
    library = ctypes.CDLL(None, use_errno=True)
    call = _SECCOMP.get(os.uname().machine)
    if call is not None and library.syscall(call, _SET_FILTER, _SPECULATION_AS_BEFORE, ctypes.byref(program)) == 0:
        return
    if library.prctl(_PR_SET_SECCOMP, _MODE_FILTER, ctypes.byref(program), 0, 0):
        number = ctypes.get_errno()
        if number != errno.EINVAL:
            raise OSError(number, os.strerror(number))


def _program(own: int) -> Iterator[tuple[int, int, int, int]]:
    for architecture, numbers in _NUMBERS.items():
        block = [(_LOAD, 0, 0, _NUMBER)]
        if architecture == next(iter(_NUMBERS)):
            block += [(_AT_LEAST, 0, 1, _X32), (_RETURN, 0, 0, _UNKNOWN)]
        for number, call in zip(numbers, _CALLS.values(), strict=True):
            checks = list(itertools.chain.from_iterable(_checks(call, own)))
            block += [(_EQUAL, 0, len(checks), number), *checks]
        block.append((_RETURN, 0, 0, _ALLOW))
        yield from [(_LOAD, 0, 0, _ARCHITECTURE), (_EQUAL, 0, len(block), architecture), *block]
    yield _RETURN, 0, 0, _ALLOW


def _checks(call: _Call, own: int) -> Iterator[list[tuple[int, int, int, int]]]:
    """Yields instructions that end with an answer. The kernel takes process numbers from the lower halves of their arguments."""

    def low(argument: int) -> tuple[int, int, int, int]:
        return _LOAD, 0, 0, _ARGUMENTS + 8 * argument

    def answer_if(value: int, answer: int) -> list[tuple[int, int, int, int]]:
        return [(_EQUAL, 0, 1, value), (_RETURN, 0, 0, answer)]

    if call.wide is not None:
        argument, value = call.wide
        yield [low(argument), *answer_if(value, _REFUSE)]
    if call.change is not None:
        place = _ARGUMENTS + 8 * call.change
        yield [low(call.change), (_EQUAL, 0, 3, 0), (_LOAD, 0, 0, place + 4), *answer_if(0, _ALLOW)]
    yield [low(call.process), *answer_if(0, _ALLOW), *answer_if(own, _ALLOW), (_RETURN, 0, 0, call.answer)]
