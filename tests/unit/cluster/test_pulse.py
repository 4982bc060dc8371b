"""Signs of life, and how long a process may go without them."""

import os
import signal
import subprocess
import sys

import pytest
from tests.support.serve import until

from drivecal.cluster import pulse
from drivecal.cluster.pulse import BUSY_SECONDS, IDLE_SECONDS, LOOKS, SILENT_SECONDS, START_SECONDS, Pipe, Silence, is_idle

BUSY = os.getpid()
"""A process that runs while the test looks at it."""


class Clock:
    """Time that passes by looks only."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def __call__(self) -> float:
        return self.seconds


def looks_until_replaced(silence: Silence, clock: Clock, process: int | None) -> float:
    """Returns the seconds of silence after which a process is replaced."""
    silence.is_too_long(process, heard=True)
    begun = clock.seconds
    while not silence.is_too_long(process, heard=False):
        clock.seconds += 0.5
    return clock.seconds - begun


def test_a_silent_process_is_replaced_within_the_promise_and_one_that_computes_later() -> None:
    sleeper = subprocess.Popen(["sleep", "600"])
    try:
        until(lambda: is_idle(sleeper.pid), "a sleeping process")
        for process, seconds in ((sleeper.pid, IDLE_SECONDS), (None, SILENT_SECONDS)):
            clock = Clock()
            assert seconds <= looks_until_replaced(Silence(clock), clock, process) <= seconds + LOOKS
    finally:
        sleeper.kill()
        sleeper.wait()
    assert is_idle(sleeper.pid), "it has ended"
    clock = Clock()
    assert looks_until_replaced(Silence(clock), clock, BUSY) >= BUSY_SECONDS


def test_a_process_that_never_showed_a_sign_has_time_to_start() -> None:
    clock = Clock()
    silence = Silence(clock)
    while not silence.is_too_long(None, heard=False):
        clock.seconds += 1.0
    assert clock.seconds >= START_SECONDS


def test_pauses_of_the_looking_process_are_no_silence() -> None:
    clock = Clock()
    silence = Silence(clock)
    silence.is_too_long(None, heard=True)
    for _ in range(int(SILENT_SECONDS) - 1):
        clock.seconds += 3600.0
        assert not silence.is_too_long(None, heard=False)


def test_signs_arrive_until_a_process_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    pipe = Pipe()
    program = "import sys, time; from drivecal.cluster import pulse; pulse.show(pulse.take_descriptor()); time.sleep(600)"
    shown = os.environ | {pulse.VARIABLE: str(pipe.writer)}
    child = subprocess.Popen([sys.executable, "-c", program], env=shown, pass_fds=[pipe.writer])
    monkeypatch.setattr(pulse, "IDLE_SECONDS", 1.0)
    try:
        until(lambda: not pipe.is_silent() and pipe.process == child.pid, "a sign")
        child.send_signal(signal.SIGSTOP)
        until(pipe.is_silent, "silence")
    finally:
        child.kill()
        child.wait()
        pipe.close()
