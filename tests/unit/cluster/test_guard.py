"""A node ends with its vital parts."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from tests.support.serve import until

from drivecal.cluster.guard import POLL_SECONDS

PARENT = "import subprocess, sys, time; subprocess.Popen(sys.argv[1:]); time.sleep(60)"


def guarded(folder: Path, name: str, seconds: str) -> subprocess.Popen[str]:
    """Starts a guard whose command has started a program `name`; the program ends by itself after `seconds`."""
    part = folder / name
    sleep = shutil.which("sleep")
    assert sleep is not None
    shutil.copy(sleep, part)
    command = [sys.executable, "-m", "drivecal.cluster.guard", sys.executable, "-c", PARENT, str(part), seconds]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True)


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks at /proc")
def test_a_node_whose_raylet_gives_up_ends_and_says_so(tmp_path: Path) -> None:
    process = guarded(tmp_path, "raylet", "5")
    _, said = process.communicate(timeout=1800)
    assert process.returncode == 1
    assert "ERROR" in said
    assert "raylet" in said


def test_a_node_that_is_asked_to_ends_in_order(tmp_path: Path) -> None:
    process = guarded(tmp_path, "other", "2")
    time.sleep(1.0)
    process.send_signal(signal.SIGTERM)
    assert process.wait(30) in {0, -signal.SIGTERM, 256 - signal.SIGTERM, 128 + signal.SIGTERM}
    process.communicate()


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks at /proc")
def test_a_node_whose_raylet_is_stopped_ends(tmp_path: Path) -> None:
    process = guarded(tmp_path, "raylet", "600")
    pids: list[int] = []

    def started() -> bool:
        pids[:] = [found.pid for found in psutil.Process(process.pid).children(recursive=True) if found.name() == "raylet"]
        return bool(pids)

    until(started, "a raylet")
    time.sleep(2 * POLL_SECONDS)  # it must have been seen alive; a later stop is noticed as well
    os.kill(pids[0], signal.SIGSTOP)
    assert process.wait(300) == 1
    os.kill(pids[0], signal.SIGKILL)
    assert "raylet" in process.communicate()[1]


SHOWS = "import time; from drivecal.cluster.pulse import *; pipe = take_descriptor(); sign(pipe); show(pipe); time.sleep(3600)"


@pytest.mark.slow
def test_a_process_without_further_signs_of_life_ends_so_that_it_is_started_again() -> None:
    command = [sys.executable, "-m", "drivecal.cluster.guard", sys.executable, "-c", SHOWS]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    until(lambda: bool(psutil.Process(process.pid).children()), "the process")
    (child,) = psutil.Process(process.pid).children()
    until(lambda: child.num_threads() == 2, "its signs of life")
    child.send_signal(signal.SIGSTOP)
    _, said = process.communicate(timeout=1800)
    assert process.returncode == 1
    assert "no sign of life" in said
    assert not child.is_running()
