"""A node ends with its vital parts."""

import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

PARENT = "import subprocess, sys, time; subprocess.Popen(sys.argv[1:]); time.sleep(60)"


def guarded(folder: Path, name: str, seconds: str) -> subprocess.Popen[str]:
    """A guard of something that has started a program of that name, which ends by itself after so many seconds."""
    part = folder / name
    sleep = shutil.which("sleep")
    assert sleep is not None
    shutil.copy(sleep, part)
    command = [sys.executable, "-m", "drivecal.cluster.guard", sys.executable, "-c", PARENT, str(part), seconds]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks at /proc")
def test_a_node_whose_raylet_gives_up_ends_and_says_so(tmp_path: Path) -> None:
    process = guarded(tmp_path, "raylet", "5")
    _, said = process.communicate(timeout=120)
    assert process.returncode == 1
    assert "ERROR" in said
    assert "raylet" in said


def test_a_node_that_is_asked_to_ends_in_order(tmp_path: Path) -> None:
    process = guarded(tmp_path, "other", "2")
    time.sleep(1.0)
    process.send_signal(signal.SIGTERM)
    assert process.wait(30) in {0, -signal.SIGTERM, 256 - signal.SIGTERM, 128 + signal.SIGTERM}
    process.communicate()
