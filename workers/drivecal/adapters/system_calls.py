"""Filter of the system calls of simulators. The keeper imports this: standard library only.

Landlock holds back signals, but neither `prlimit`, which ends a process by a limit of its CPU time and keeps a server from opening files,
nor changes of priority and processors. The filter (https://docs.kernel.org/userspace-api/seccomp_filter.html) lets a program make these
calls on itself: with 0 for the calling thread, or with its own number. It passes to all descendants, which may use 0. What schedules other
threads has no effect, and no error, because libraries that place their threads (OpenMP) would end.

Nor does Landlock hold back connections to Unix sockets with a path: Ray's object store, databases, session buses and Docker trust every
process of their user there. A simulator makes no Unix socket but a connected pair: one of datagrams could still send elsewhere, so that
pairs are streams. `io_uring` makes sockets without these calls, and VM sockets lead to the host. Memory, semaphores and queues of System V,
queues of POSIX and keyrings are the user's, not the process's.
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
_LOAD, _EQUAL, _AT_LEAST, _AND, _RETURN = 0x20, 0x15, 0x35, 0x54, 0x06
_NUMBER, _ARCHITECTURE, _ARGUMENTS = 0, 4, 16
"""Offsets in `struct seccomp_data`."""
_ALLOW, _REFUSE, _UNKNOWN, _PRETEND = 0x7FFF0000, 0x00050000 | errno.EPERM, 0x00050000 | errno.ENOSYS, 0x00050000
_X32 = 0x40000000
"""Larger numbers belong to a second table of x86-64, which hardly any kernel has."""


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

_UNIX, _VM, _SOCKET, _PAIR, _STREAM, _PACKETS, _TYPE = 1, 40, 1, 8, 1, 5, 0xF
"""Families of sockets, `socket` and `socketpair` as the first argument of `socketcall`, and types of sockets below their flags."""
_SOCKETS = {
    "socket": {0xC000003E: 41, 0x40000003: 359, 0xC00000B7: 198, 0x40000028: 281},
    "socketpair": {0xC000003E: 53, 0x40000003: 360, 0xC00000B7: 199, 0x40000028: 288},
    "socketcall": {0x40000003: 102},
}
"""Calls that make sockets; `socketcall` hides its family in memory, so that 32-bit programs that use it make none."""
_REFUSED = {
    0xC000003E: (425, 248, 249, 250),
    0x40000003: (425, 286, 287, 288),
    0xC00000B7: (425, 217, 218, 219),
    0x40000028: (425, 309, 310, 311),
}
"""Numbers of `io_uring_setup`, `add_key`, `request_key`, `keyctl`: programs do without, as on a kernel that lacks them."""
_OF_THE_USER = {
    0xC000003E: (29, 30, 31, 64, 65, 66, 68, 69, 70, 71, 220, 240, 241),
    0x40000003: (117, 277, 278, 393, 394, 395, 396, 397, 399, 400, 401, 402, 420),
    0xC00000B7: (180, 181, 186, 187, 188, 189, 190, 191, 192, 193, 194, 195, 196),
    0x40000028: (274, 275, 298, 299, 300, 301, 302, 303, 304, 305, 307, 308, 312, 420),
}
"""Numbers of `shm*`, `sem*`, `msg*` and `ipc` of System V, `mq_open` and `mq_unlink` of POSIX."""


class _Instruction(ctypes.Structure):
    _fields_ = [("code", ctypes.c_uint16), ("yes", ctypes.c_uint8), ("no", ctypes.c_uint8), ("value", ctypes.c_uint32)]


class _Program(ctypes.Structure):
    _fields_ = [("length", ctypes.c_uint16), ("instructions", ctypes.POINTER(_Instruction))]


def hold_to_itself(*, shares_memory: bool) -> None:
    """Holds this process and its descendants to calls on themselves, for good; nothing on a kernel without seccomp. It must have no way to
    gain privileges (`no_new_privs`). Raises OSError.

    Args:
        shares_memory: memory of System V would be that of all processes of the user, so that it is refused.
    """
    if sys.byteorder != "little":  # the filter reads the lower halves of arguments; none of the architectures is another
        return
    code = [_Instruction(*instruction) for instruction in _program(os.getpid(), shares_memory=shares_memory)]
    program = _Program(len(code), (_Instruction * len(code))(*code))
    library = ctypes.CDLL(None, use_errno=True)
    call = _SECCOMP.get(os.uname().machine)
    if call is not None and library.syscall(call, _SET_FILTER, _SPECULATION_AS_BEFORE, ctypes.byref(program)) == 0:
        return
    if library.prctl(_PR_SET_SECCOMP, _MODE_FILTER, ctypes.byref(program), 0, 0):
        number = ctypes.get_errno()
        if number != errno.EINVAL:
            raise OSError(number, os.strerror(number))


def _program(own: int, *, shares_memory: bool) -> Iterator[tuple[int, int, int, int]]:
    for architecture, numbers in _NUMBERS.items():
        block = [(_LOAD, 0, 0, _NUMBER)]
        if architecture == next(iter(_NUMBERS)):
            block += [(_AT_LEAST, 0, 1, _X32), (_RETURN, 0, 0, _UNKNOWN)]
        for number, call in zip(numbers, _CALLS.values(), strict=True):
            checks = list(itertools.chain.from_iterable(_checks(call, own)))
            block += [(_EQUAL, 0, len(checks), number), *checks]
        for name, known in _SOCKETS.items():
            if architecture in known:
                checks = list(_socket_checks(name))
                block += [(_EQUAL, 0, len(checks), known[architecture]), *checks]
        for number in (*_REFUSED[architecture], *(_OF_THE_USER[architecture] if shares_memory else ())):
            block += [(_EQUAL, 0, 1, number), (_RETURN, 0, 0, _UNKNOWN)]
        block.append((_RETURN, 0, 0, _ALLOW))
        yield from [(_LOAD, 0, 0, _ARCHITECTURE), (_EQUAL, 0, len(block), architecture), *block]
    yield _RETURN, 0, 0, _ALLOW


def _checks(call: _Call, own: int) -> Iterator[list[tuple[int, int, int, int]]]:
    """Yields instructions that end with an answer. The kernel takes process numbers from the lower halves of their arguments."""

    if call.wide is not None:
        argument, value = call.wide
        yield [_low(argument), *_if(value, _REFUSE)]
    if call.change is not None:
        place = _ARGUMENTS + 8 * call.change
        yield [_low(call.change), (_EQUAL, 0, 3, 0), (_LOAD, 0, 0, place + 4), *_if(0, _ALLOW)]
    yield [_low(call.process), *_if(0, _ALLOW), *_if(own, _ALLOW), (_RETURN, 0, 0, call.answer)]


def _socket_checks(name: str) -> Iterator[tuple[int, int, int, int]]:
    yield _low(0)
    if name == "socket":
        yield from (*_if(_UNIX, _REFUSE), *_if(_VM, _REFUSE))
    elif name == "socketpair":
        yield from ((_EQUAL, 1, 0, _UNIX), (_RETURN, 0, 0, _ALLOW), _low(1), (_AND, 0, 0, _TYPE))
        yield from (*_if(_STREAM, _ALLOW), *_if(_PACKETS, _ALLOW), (_RETURN, 0, 0, _REFUSE))
    else:
        yield from (*_if(_SOCKET, _UNKNOWN), *_if(_PAIR, _UNKNOWN))
    yield _RETURN, 0, 0, _ALLOW


def _low(argument: int) -> tuple[int, int, int, int]:
    return _LOAD, 0, 0, _ARGUMENTS + 8 * argument


def _if(value: int, answer: int) -> tuple[tuple[int, int, int, int], tuple[int, int, int, int]]:
    return (_EQUAL, 0, 1, value), (_RETURN, 0, 0, answer)
