"""Simulators whose processes multiply: how many they may be, and how all of them end."""

import os
from pathlib import Path

import pytest
from tests.support.simulators import compiled, lost, running, served

from drivecal.adapters import children, confinement
from drivecal.adapters.environment import GRANTED
from drivecal.domain.evaluations import Breakdown


def test_too_many_processes_end_the_run(tmp_path: Path, mark: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The bomb itself stops at 40, in case that it is not held back."""
    monkeypatch.setattr(children, "MOST_PROCESSES", 20)
    spawn = f"[subprocess.Popen([sys.executable, '-S', '-c', 'import time; time.sleep(600)', {mark!r}]) for _ in range(40)]"
    with served(tmp_path, f"if x == 1.0:\n    {spawn}\n    time.sleep(600)") as session:
        assert "processes, more than 20" in lost(session, {"x": 1.0}, Breakdown.ERROR)
        assert running(mark) == []
        assert session.evaluate({"x": 2.0}).measures == {"y": 4.0}


def test_processes_that_multiply_while_they_are_killed_end(tmp_path: Path, mark: str) -> None:
    """Each leaves the group and starts its successor at once; the chain ends after a while by itself."""
    chain = "import os, time\nfor _ in range(20_000):\n    if os.fork():\n        os._exit(0)\n    os.setsid()\ntime.sleep(600)"
    with served(tmp_path, f"subprocess.Popen([sys.executable, '-S', '-c', {chain!r}, {mark!r}])\nos.abort()") as session:
        for _ in range(3):
            lost(session, {"x": 1.0}, Breakdown.CRASH)
            assert running(mark) == []


CHAINS = """
#include <fcntl.h>
#include <unistd.h>
int main(int count, char **arguments) {
    int fifo = open(arguments[1], O_WRONLY);
    if (write(fifo, "x", 1) != 1) _exit(4);
    for (int chain = 0; chain < 16; chain++)
        if (fork() == 0)
            for (int hop = 0; hop < 200000; hop++) {
                if (fork()) _exit(0);
                setsid();
            }
    usleep(20000);
    _exit(3);
}
"""
"""Sixteen chains of processes that live for some microseconds, so that a look at /proc finds them when they are gone. All keep a FIFO open,
and end by themselves some time."""


@pytest.mark.skipif(confinement.version() < confinement.SCOPES_SINCE, reason="this kernel (before 6.12) holds back no signals")
def test_chains_faster_than_any_look_at_processes_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(GRANTED, str(tmp_path))
    (tmp_path / "chains.c").write_text(CHAINS)
    compiled("gcc", tmp_path / "chains.c", tmp_path / "chains")
    kept_open = tmp_path / "fifo"
    os.mkfifo(kept_open)
    reader = os.open(kept_open, os.O_RDONLY | os.O_NONBLOCK)
    run = f"os.execv({str(tmp_path / 'chains')!r}, ['chains', {str(kept_open)!r}])"
    with served(tmp_path, f"if x == 1.0:\n    {run}") as session:
        assert "exit code 3" in lost(session, {"x": 1.0}, Breakdown.CRASH)
        assert os.read(reader, 1) == b"x"
        assert os.read(reader, 1) == b""  # nothing has it open; else it would block
        assert session.evaluate({"x": 2.0}).measures == {"y": 4.0}
    os.close(reader)
