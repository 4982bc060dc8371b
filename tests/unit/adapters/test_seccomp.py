"""The filter of system calls, carried out as Linux does it, on all architectures."""

import errno
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from tests.support.simulators import compiled

from drivecal.adapters import confinement

OWN, OTHER = 4711, 4712
ALLOWED, REFUSED, UNKNOWN, PRETENDED = 0x7FFF0000, 0x00050000 | errno.EPERM, 0x00050000 | errno.ENOSYS, 0x00050000
HIGH = 7 << 32
X86_64, I386, AARCH64, ARM = confinement._NUMBERS


def answer(architecture: int, number: int, *arguments: int) -> int:
    """The answer of the filter of process OWN to a call."""
    data = number.to_bytes(4, "little") + architecture.to_bytes(4, "little") + bytes(8)
    data += b"".join(argument.to_bytes(8, "little") for argument in arguments).ljust(48, b"\0")
    program, place, loaded = list(confinement._program(OWN)), 0, 0
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
            case 0x06:
                return value


@pytest.mark.parametrize("architecture", [X86_64, I386, AARCH64, ARM])
def test_calls_on_others_are_refused_and_those_on_itself_are_not(architecture: int) -> None:
    for number, (name, call) in zip(confinement._NUMBERS[architecture], confinement._CALLS.items(), strict=True):
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
    held = "import ctypes, os, sys; from drivecal.adapters import confinement; ctypes.CDLL(None).prctl(38, 1, 0, 0, 0)"
    run = [sys.executable, "-c", f"{held}; confinement.hold_to_itself(); os.execvp(sys.argv[1], sys.argv[1:])"]
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
    of_x86_64 = set(confinement._NUMBERS[X86_64])
    assert all(answer(X86_64, number, OTHER, OTHER) == ALLOWED for number in range(500) if number not in of_x86_64)
    assert answer(0xC00000F3, 302, OTHER) == ALLOWED  # RISC-V
    assert answer(X86_64, 0x40000000 | 302, OTHER, 7, HIGH) == UNKNOWN


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
    assert [int(known[name]) for name in confinement._CALLS] == list(confinement._NUMBERS[architecture])
