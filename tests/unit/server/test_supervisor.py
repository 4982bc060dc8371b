import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import psutil
import pytest
from tests.support.serve import until
from tests.support.simulators import is_running

from drivecal.server.guardian import members
from drivecal.server.supervisor import ChildProcess, Pauses, Supervisor, _Child

SCRIPT = """
import logging, sys
from pathlib import Path
from drivecal.server import supervisor
from drivecal.server.supervisor import ChildProcess, Supervisor
supervisor.GRACE_SECONDS = 100.0  # ends by itself or by the second signal, not by the clock
logging.basicConfig(level="INFO", format="%(message)s")
folder = Path(sys.argv[1])
def missing():
    return [name for name in ("one", "two") if not (folder / name).exists()]
children = [ChildProcess(name, [sys.executable, "-c", (folder / f"{name}.py").read_text(), str(folder), name]) for name in ("one", "two")]
sys.exit(Supervisor(children, missing, lambda: logging.info("ready")).run())
"""
SLEEPER = """
import os, sys, time
from pathlib import Path
folder, name = Path(sys.argv[1]), sys.argv[2]
def note():
    (folder / f"{name}.new").write_text(str(os.getpid()))
    (folder / f"{name}.new").rename(folder / name)
"""
PEACEFUL = SLEEPER + "note(); time.sleep(600)"
STUBBORN = SLEEPER + "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); note(); time.sleep(600)"
WITH_FAMILY = (
    SLEEPER
    + """
import subprocess
child = subprocess.Popen([sys.executable, "-c", "import os, time; os.setpgid(0, 0); time.sleep(600)"])
(folder / "grandchild").write_text(str(child.pid))
note(); time.sleep(600)
"""
)


class Server:
    """A supervisor with two scripted children."""

    def __init__(self, folder: Path, one: str, two: str) -> None:
        self.folder = folder
        (folder / "one.py").write_text(one)
        (folder / "two.py").write_text(two)
        self.log = folder / "log"
        with self.log.open("wb") as log:
            self.process = subprocess.Popen([sys.executable, "-c", SCRIPT, str(folder)], stderr=log)

    def pid(self, name: str) -> int:
        return int((self.folder / name).read_text())

    def ready(self) -> None:
        until(lambda: "ready" in self.log.read_text(), "ready")


@pytest.fixture
def server(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Server]:
    started = Server(tmp_path, *getattr(request, "param", (PEACEFUL, WITH_FAMILY)))
    yield started
    if started.process.poll() is None:
        started.process.kill()
        started.process.wait()


def test_pauses_double_up_to_a_limit_and_begin_again_after_good_health() -> None:
    pauses = Pauses()
    assert [pauses.next(1.0, 1) for _ in range(8)] == [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0]
    assert pauses.next(61.0, 1) == 0.5
    assert pauses.next(1.0, 1) == 1.0
    assert [pauses.next(1.0, 128 + signal.SIGKILL) for _ in range(4)] == [2.0, 4.0, 4.0, 4.0], "killed: not its own fault"
    assert {pauses.next(1.0, 1) for _ in range(2000)} == {30.0}


def test_sigterm_ends_children_and_grandchildren(server: Server) -> None:
    server.ready()
    pids = [server.pid(name) for name in ("one", "two", "grandchild")]
    assert all(is_running(pid) for pid in pids)
    server.process.terminate()
    assert server.process.wait(timeout=1800) == 0
    until(lambda: not any(is_running(pid) for pid in pids), "the end of all")


@pytest.mark.parametrize("server", [(STUBBORN, PEACEFUL)], indirect=True)
def test_a_second_signal_ends_even_those_that_will_not(server: Server) -> None:
    server.ready()
    pids = [server.pid(name) for name in ("one", "two")]
    server.process.send_signal(signal.SIGINT)
    until(lambda: not is_running(pids[1]), "the end of the peaceful child")
    assert is_running(pids[0])
    server.process.send_signal(signal.SIGINT)
    assert server.process.wait(timeout=1800) == 0
    until(lambda: not any(is_running(pid) for pid in pids), "the end of all")


def test_a_supervisor_that_is_killed_takes_everything_with_it(server: Server) -> None:
    server.ready()
    pids = [server.pid(name) for name in ("one", "two", "grandchild")]
    server.process.kill()
    until(lambda: not any(is_running(pid) for pid in pids), "the end of all children")


@pytest.mark.parametrize("killed", ["child", "guardian"])
def test_what_dies_is_started_again_and_leaves_nothing_behind(server: Server, killed: str) -> None:
    server.ready()
    old, orphan = server.pid("two"), server.pid("grandchild")
    os.kill(old if killed == "child" else psutil.Process(old).ppid(), signal.SIGKILL)
    until(lambda: server.pid("two") != old, "the restart")
    until(lambda: not is_running(old) and not is_running(orphan), "the end of the old ones")
    assert is_running(server.pid("two"))
    assert "the two ended unexpectedly" in server.log.read_text()


@pytest.mark.parametrize("server", [(PEACEFUL, "import sys; sys.exit('no such thing')")], indirect=True)
def test_a_child_that_never_starts_ends_the_server_with_a_word(server: Server) -> None:
    assert server.process.wait(timeout=1800) == 1
    log = server.log.read_text()
    assert log.count("no such thing") == 3
    assert "the two does not start (exit code 1)" in log
    assert not (server.folder / "one").exists() or not is_running(server.pid("one"))


KILLED_THRICE = (
    SLEEPER
    + """
import signal
lives = folder / "lives"
lives.write_text(lives.read_text() + "x" if lives.exists() else "x")
if len(lives.read_text()) <= 3:
    os.kill(os.getpid(), signal.SIGKILL)
note(); time.sleep(600)
"""
)


@pytest.mark.slow
@pytest.mark.parametrize("server", [(PEACEFUL, KILLED_THRICE)], indirect=True)
def test_a_child_that_is_killed_while_it_starts_is_started_again(server: Server) -> None:
    server.ready()
    assert server.log.read_text().count("the two ended unexpectedly (exit code 137)") == 3


def test_ends_count_as_failed_starts_within_a_minute_only() -> None:
    child = _Child(ChildProcess("one", ["true"]))
    counts = []
    for lived, code in ((1.0, 1), (1.0, 137), (1.0, 1), (70.0, 1), (1.0, 0)):
        process: Any = SimpleNamespace(poll=lambda: 0, returncode=code, stdin=None)
        child.process, child.started_at = process, time.monotonic() - lived
        assert child.ended() == code
        counts.append(child.gave_up)
    assert counts == [1, 1, 2, 1, 2]


@pytest.mark.parametrize("lacks", ["os.pipe2", "subprocess.Popen"])
def test_a_child_without_room_on_the_machine_is_started_later(monkeypatch: pytest.MonkeyPatch, lacks: str) -> None:
    server = Supervisor([ChildProcess("one", ["true"])], lambda: (), lambda: None)
    [child], begin = server._children, time.monotonic()
    with monkeypatch.context() as crowded:
        crowded.setattr(lacks, Mock(side_effect=OSError("no room")))
        server._start(child)
    assert child.process is None
    assert child.start_at > begin
    server._start(child)
    server._stop()
    assert child.ended() is not None


def test_the_members_of_a_session_are_found_by_it() -> None:
    child = subprocess.Popen(["sh", "-c", "sleep 60 & sleep 60 & wait"], start_new_session=True)
    until(lambda: len(members(child.pid)) == 2, "two members")
    for pid in [*members(child.pid), child.pid]:
        os.kill(pid, signal.SIGKILL)
    child.wait()
    until(lambda: not members(child.pid), "no members")
