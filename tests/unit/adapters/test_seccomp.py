"""The filter of system calls, carried out as Linux does it, on all architectures."""

import errno
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from tests.support.simulators import compiled

from drivecal.adapters import system_calls

OWN, OTHER = 4711, 4712
ALLOWED, REFUSED, UNKNOWN, PRETENDED = 0x7FFF0000, 0x00050000 | errno.EPERM, 0x00050000 | errno.ENOSYS, 0x00050000
HIGH = 7 << 32
X86_64, I386, AARCH64, ARM = system_calls._NUMBERS


def answer(architecture: int, number: int, *arguments: int) -> int:
    """The answer of the filter of process OWN to a call."""
    data = number.to_bytes(4, "little") + architecture.to_bytes(4, "little") + bytes(8)
    data += b"".join(argument.to_bytes(8, "little") for argument in arguments).ljust(48, b"\0")
    program, place, loaded = list(system_calls._program(OWN, shares_memory=True)), 0, 0
    while True:
        code, yes, no, value = program[place]
        place += 1
        match code:
            case 0x20:
                loaded = int.from_bytes(data[value : value + 4], "little")
            case 0x15:
                place += yes if loaded == value else no
            case 0x35:
                place += yes if loaded >= value else no
            case 0x54:
                loaded &= value
            case 0x06:
                return value


@pytest.mark.parametrize("architecture", [X86_64, I386, AARCH64, ARM])
def test_calls_on_others_are_refused_and_those_on_itself_are_not(architecture: int) -> None:
    for number, (name, call) in zip(system_calls._NUMBERS[architecture], system_calls._CALLS.items(), strict=True):
        other = PRETENDED if name.startswith("sched_") else REFUSED
        for process, expected in ((0, ALLOWED), (OWN, ALLOWED), (OTHER, other), (HIGH, ALLOWED), (HIGH | OTHER, other)):
            arguments = [0] * 6
            arguments[call.process] = process
            if call.change is not None:
                arguments[call.change] = HIGH
            assert answer(architecture, number, *arguments) == expected, (name, process)


def test_threads_start_that_a_library_places_and_placing_them_has_no_effect(tmp_path: Path) -> None:
    """As OpenMP starts its threads, by an attribute."""
    source = tmp_path / "placed.c"
    source.write_text(PLACED)
    program = compiled("gcc", source, tmp_path / "placed", "-pthread")
    held = "import ctypes, os, sys; from drivecal.adapters import system_calls; ctypes.CDLL(None).prctl(38, 1, 0, 0, 0)"
    run = [
        sys.executable,
        "-c",
        f"{held}; system_calls.hold_to_itself(shares_memory=True); os.execvp(sys.argv[1], sys.argv[1:])",
    ]
    status = subprocess.run([*run, "cat", "/proc/self/status"], capture_output=True, text=True, check=True).stdout
    if "Seccomp:\t2" not in status:
        pytest.skip("this kernel has no filters of system calls")
    ended = subprocess.run([*run, str(program)], capture_output=True, text=True, check=True)
    assert int(ended.stdout) == len(os.sched_getaffinity(0))


PLACED = """
#define _GNU_SOURCE
#include <pthread.h>
#include <sched.h>
#include <stdio.h>
static void *work(void *unused) {
    cpu_set_t set;
    sched_getaffinity(0, sizeof set, &set);
    printf("%d", CPU_COUNT(&set));
    return 0;
}
int main(void) {
    cpu_set_t set, one;
    pthread_attr_t attributes;
    pthread_t thread;
    sched_getaffinity(0, sizeof set, &set);
    CPU_ZERO(&one);
    for (int cpu = 0; cpu < CPU_SETSIZE; cpu++)
        if (CPU_ISSET(cpu, &set)) { CPU_SET(cpu, &one); break; }
    pthread_attr_init(&attributes);
    pthread_attr_setaffinity_np(&attributes, sizeof one, &one);
    if (pthread_create(&thread, &attributes, work, 0)) return 1;
    pthread_join(thread, 0);
    return 0;
}
"""


def test_all_processes_of_the_user_are_others_and_a_look_is_no_change() -> None:
    assert answer(X86_64, 141, 2, 0) == answer(X86_64, 251, 3, 0) == REFUSED
    assert answer(X86_64, 302, OTHER, 7, 0, HIGH) == ALLOWED


def test_other_calls_and_architectures_are_left_alone() -> None:
    of_x86_64 = {*system_calls._NUMBERS[X86_64], *system_calls._REFUSED[X86_64], *system_calls._OF_THE_USER[X86_64]}
    assert all(answer(X86_64, number, OTHER, OTHER) == ALLOWED for number in range(500) if number not in of_x86_64)
    assert answer(0xC00000F3, 302, OTHER) == ALLOWED  # RISC-V
    assert answer(X86_64, 0x40000000 | 302, OTHER, 7, HIGH) == UNKNOWN


@pytest.mark.parametrize("architecture", [X86_64, I386, AARCH64, ARM])
def test_no_socket_of_unix_is_made_but_a_pair_of_streams(architecture: int) -> None:
    known = {name: numbers[architecture] for name, numbers in system_calls._SOCKETS.items() if architecture in numbers}
    close_on_exec = 0o2000000
    for family, kind, of_socket, of_pair in (
        (1, 1, REFUSED, ALLOWED),
        (1, 5 | close_on_exec, REFUSED, ALLOWED),
        (HIGH | 1, 2, REFUSED, REFUSED),
        (1, 3 | close_on_exec, REFUSED, REFUSED),
        (40, 1, REFUSED, ALLOWED),
        (2, 1, ALLOWED, ALLOWED),
        (16, 3, ALLOWED, ALLOWED),
    ):
        assert answer(architecture, known["socket"], family, kind) == of_socket, (family, kind)
        assert answer(architecture, known["socketpair"], family, kind) == of_pair, (family, kind)
    for call in (1, 8):
        assert answer(architecture, 102, call) == (UNKNOWN if architecture == I386 else ALLOWED)


def test_memory_of_the_user_is_refused_unless_it_is_a_sessions_own() -> None:
    for architecture, numbers in system_calls._OF_THE_USER.items():
        assert {answer(architecture, number) for number in numbers} == {UNKNOWN}
    assert len(list(system_calls._program(OWN, shares_memory=False))) < len(
        list(system_calls._program(OWN, shares_memory=True))
    )


HEADERS = {
    X86_64: Path("/usr/include/x86_64-linux-gnu/asm/unistd_64.h"),
    I386: Path("/usr/include/x86_64-linux-gnu/asm/unistd_32.h"),
    AARCH64: Path("/usr/include/asm-generic/unistd.h"),
}


@pytest.mark.parametrize("architecture", HEADERS)
def test_numbers_are_those_of_linux(architecture: int) -> None:
    header = HEADERS[architecture]
    if not header.is_file():
        pytest.skip("the kernel's headers are not installed")
    known = dict(re.findall(r"#define __NR_(\w+) (\d+)", header.read_text()))
    refused = [int(known[name]) for name in ("io_uring_setup", "add_key", "request_key", "keyctl")]
    shared = {name for name, number in known.items() if int(number) in system_calls._OF_THE_USER[architecture]}
    assert refused == list(system_calls._REFUSED[architecture])
    assert len(shared) == len(system_calls._OF_THE_USER[architecture])
    assert all(re.match("shm|sem|msg|ipc|mq_open|mq_unlink", name) for name in shared)
    assert all(
        int(known[name]) == numbers[architecture] for name, numbers in system_calls._SOCKETS.items() if architecture in numbers
    )
    assert [int(known[name]) for name in system_calls._CALLS] == list(system_calls._NUMBERS[architecture])
