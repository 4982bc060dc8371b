"""Hostile children: what is held back, and what is counted."""

import os
import signal
import socket
import subprocess
import sys
import tempfile
import textwrap
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.support.serve import until
from tests.support.simulators import (
    PYTHON,
    compiled,
    hung,
    is_running,
    lost,
    opened,
    running,
    scratch_of,
    served,
    write_script,
    write_server,
)

from drivecal.adapters import children, files, keeper
from drivecal.adapters.children import Children
from drivecal.adapters.environment import GRANTED, Scratch
from drivecal.cluster import machine
from drivecal.domain.evaluations import Breakdown
from drivecal.plugins.simulators import NoMeasuresError

SLEEPER = "[sys.executable, '-S', '-c', 'import time; time.sleep(600)', {mark!r}]"
DAEMON = """
import os, time
if os.fork() == 0:
    os.setsid()
    if os.fork() == 0:
        time.sleep(600)
    os._exit(0)
"""
"""Leaves its process group and its parent, as a daemon does."""


@pytest.mark.parametrize("body", ["os.abort()", "os.write(1, b'nonsense\\n')", "time.sleep(600)"])
def test_grandchildren_end_with_a_failed_run(tmp_path: Path, mark: str, body: str) -> None:
    spawn = f"subprocess.Popen({SLEEPER.format(mark=mark)})"
    with served(tmp_path, f"if x == 1.0:\n    {spawn}\n    {body}") as session:
        session._timeout = 2.0
        with pytest.raises(NoMeasuresError):
            session.evaluate({"x": 1.0})
        session._timeout = 60.0
        assert running(mark) == []
        assert session.evaluate({"x": 2.0}).measures == {"y": 4.0}


@pytest.fixture
def change_keepers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Keepers begin with a script, which changes the module `keeper`."""

    def change(script: str) -> None:
        root, file = str(Path(keeper.__file__).parents[2]), tmp_path / "changed_keeper.py"
        file.write_text(f"import sys\nsys.path.append({root!r})\nfrom drivecal.adapters import keeper\n{script}\nkeeper.main()")
        monkeypatch.setattr(keeper, "__file__", str(file))

    return change


LATE = """
has_ended, missed = keeper._has_ended, set()

def asked_too_early(child):
    ended = has_ended(child)
    if ended and child not in missed:
        missed.add(child)
        return False
    return ended

keeper._has_ended = asked_too_early
"""


def test_a_child_that_ends_between_two_looks_is_reported(tmp_path: Path, change_keepers: Callable[[str], None]) -> None:
    change_keepers(LATE)
    with served(tmp_path, "if x == 1.0:\n    os._exit(3)") as session:
        for _ in range(2):
            assert "exit code 3" in lost(session, {"x": 1.0}, Breakdown.CRASH)
            assert session.evaluate({"x": 2.0}).measures == {"y": 4.0}


def test_daemons_that_leave_the_group_end_too(tmp_path: Path, mark: str) -> None:
    body = f"subprocess.run([sys.executable, '-S', '-c', {DAEMON!r}, {mark!r}])"
    with served(tmp_path, body) as session:
        session.evaluate({"x": 1.0})
        until(lambda: len(running(mark)) == 1)
    assert running(mark) == []


@pytest.mark.slow
def test_a_child_that_ignores_signals_ends(tmp_path: Path, mark: str) -> None:
    body = "for number in (1, 2, 15): signal.signal(number, signal.SIG_IGN)\ntime.sleep(600)"
    write_server(tmp_path, f"if x == 1.0:\n    {body.replace(chr(10), chr(10) + '    ')}")
    with opened("process", tmp_path, command=[PYTHON, "-S", "sim.py", mark], timeout=1.0) as session:
        lost(session, {"x": 1.0}, Breakdown.HANG)
        assert running(mark) == []


@pytest.fixture
def patient(change_keepers: Callable[[str], None]) -> None:
    """Keepers wait longer for the end of a child, whatever else the machine does."""
    change_keepers("keeper.GRACE_SECONDS = 20.0")


CLEANING = """
import os, signal, sys, time
signal.signal(15, lambda *_: (time.sleep(0.2), open({out!r}, 'a').write('cleaned;'), os._exit(0)))
if len(sys.argv) > 1:
    os.setsid()
print('up', file=open({out!r}, 'a'), flush=True)
time.sleep(600)
"""
"""A program that takes a while to clean up when it is asked to end."""


@pytest.mark.slow
@pytest.mark.usefixtures("patient")
def test_programs_behind_a_shell_may_clean_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    monkeypatch.setenv(GRANTED, str(tmp_path))
    (tmp_path / "clean.py").write_text(CLEANING.format(out=str(out)))
    write_script(tmp_path / "run.sh", f"#!/bin/sh\n{PYTHON} -S clean.py own &\n{PYTHON} -S clean.py\nexit 0\n")
    with opened("command", tmp_path, command=["./run.sh"], timeout=3.0) as session:
        began = time.monotonic()
        lost(session, {}, Breakdown.HANG)
        taken = time.monotonic() - began
    assert sorted(out.read_text().replace("up\n", "").split(";")) == ["", "cleaned", "cleaned"]
    assert 3.2 < taken < 120.0  # no longer than it takes


@pytest.mark.usefixtures("patient")
def test_programs_may_clean_up_when_their_worker_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    monkeypatch.setenv(GRANTED, str(tmp_path))
    cleaning = f"signal.signal(15, lambda *_: (time.sleep(0.2), open({str(out)!r}, 'w').write('cleaned'), os._exit(0)))"
    write_server(tmp_path, start=f"{cleaning}\nsubprocess.Popen(['sleep', '600'])")
    write_script(tmp_path / "run.sh", f"#!/bin/sh\n{PYTHON} -S sim.py\nexit 0\n")
    with opened("process", tmp_path, command=["./run.sh"]) as session:
        session.evaluate({"x": 1.0})
        session._children._control.shutdown(socket.SHUT_RDWR)  # type: ignore[attr-defined]  # as the end of the worker does
        until(out.exists, seconds=10.0)
        until(lambda: not scratch_of(session).folder.exists(), seconds=10.0)
    assert out.read_text() == "cleaned"


@pytest.mark.parametrize("limit", ["MOST_PROCESSES", "MOST_THREADS"])
def test_a_child_beyond_a_limit_gets_no_time_to_clean_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str) -> None:
    out = tmp_path / "out"
    monkeypatch.setenv(GRANTED, str(tmp_path))
    monkeypatch.setattr(children, limit, 0)
    start = f"signal.signal(15, lambda *_: open({str(out)!r}, 'w').write('asked'))\nwhile True: time.sleep(600)"
    with served(tmp_path, start=start) as session:
        assert "more than 0" in lost(session, {"x": 1.0}, Breakdown.ERROR)
    assert not out.exists()


def test_sockets_count_as_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "SOCKET_BYTES", 1 << 40)
    with served(tmp_path, start="import socket\nkept = socket.socket()\ntime.sleep(600)") as session:
        assert "MB of memory" in lost(session, {"x": 1.0}, Breakdown.MEMORY)


@pytest.fixture
def unconfined(monkeypatch: pytest.MonkeyPatch) -> None:
    """Children may do what Linux permits without Landlock."""
    monkeypatch.setenv(GRANTED, "/")


@pytest.mark.usefixtures("unconfined")
def test_a_child_that_kills_its_keeper_costs_its_run_and_session_only(tmp_path: Path, mark: str) -> None:
    """A process that outlives the keeper could change the session's folder."""
    spawn = f"subprocess.Popen({SLEEPER.format(mark=mark)})"
    body = f"if x == 1.0:\n    {spawn}\n    os.kill(os.getppid(), 9)\n    time.sleep(600)"
    with served(tmp_path, body) as session:
        lost(session, {"x": 1.0}, Breakdown.CRASH)
        with pytest.raises(PermissionError):
            session.evaluate({"x": 2.0})
    assert not scratch_of(session).folder.exists()
    until(lambda: running(mark) == [])
    with served(tmp_path, body) as another:
        assert another.evaluate({"x": 2.0}).measures == {"y": 4.0}


@pytest.mark.slow
@pytest.mark.usefixtures("unconfined")
def test_a_child_that_stops_its_keeper_costs_its_run_and_session_only(tmp_path: Path, mark: str) -> None:
    spawn = f"subprocess.Popen({SLEEPER.format(mark=mark)})"
    with served(tmp_path, f"if x == 1.0:\n    {spawn}\n    os.kill(os.getppid(), 19)\n    time.sleep(600)") as session:
        stopped = session._children._keeper
        session._children._control.settimeout(2.0)  # of this keeper, which will not answer
        hung(session, {"x": 1.0}, 5.0)
        with pytest.raises(PermissionError):
            session.evaluate({"x": 2.0})
    until(lambda: running(mark) == [] and not is_running(stopped))


def test_everything_ends_with_a_worker_that_is_killed(tmp_path: Path, mark: str) -> None:
    bundle = tmp_path / "bundle"
    bundle.mkdir()
    write_server(bundle, f"subprocess.Popen({SLEEPER.format(mark=mark)})")
    worker = textwrap.dedent(f"""
        import time
        from pathlib import Path
        from drivecal.adapters.kinds import simulator_of
        from drivecal.plugins.simulators import Declared
        section = {{"kind": "process", "command": [{PYTHON!r}, "-S", "sim.py", {mark!r}], "timeout": 60.0, "memory_mb": 1000}}
        session = simulator_of(section).open(section, "S", {{}}, Path({str(bundle)!r}), Declared("p", ("y",)))
        session.evaluate({{"x": 1.0}})
        print(session._scratch.folder, flush=True)
        time.sleep(600)
    """)
    with subprocess.Popen([sys.executable, "-c", worker], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            scratch = Path(process.stdout.readline().strip())
            assert scratch.is_dir()
            until(lambda: len([child for child in running(mark) if child.pid != process.pid]) == 2)
        finally:
            process.kill()
    until(lambda: running(mark) == [] and not scratch.exists())


def test_memory_of_all_processes_together_is_limited(tmp_path: Path) -> None:
    """Shared memory does not count as data of a process."""
    body = (
        "import mmap\nhold = mmap.mmap(-1, 200 << 20)\nfor start in range(0, 200 << 20, 4096): hold[start] = 1\ntime.sleep(600)"
    )
    with served(tmp_path, f"if x == 1.0:\n    {body.replace(chr(10), chr(10) + '    ')}", memory_mb=100) as session:
        assert "MB of memory" in lost(session, {"x": 1.0}, Breakdown.MEMORY)
        assert session.evaluate({"x": 2.0}).measures == {"y": 4.0}


def test_a_run_without_an_answer_is_told_by_the_memory_that_it_takes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(children, "LOOK_SECONDS", 600.0)
    body = "global hold\nif x == 1.0:\n    import mmap\n    hold = mmap.mmap(-1, 200 << 20)\n    hold.write(bytes(200 << 20))"
    with served(tmp_path, body + "\nelse:\n    time.sleep(600)", memory_mb=300) as session:
        assert session.evaluate({"x": 1.0}).measures == {"y": 2.0}
        session._children._memory_mb, session._timeout = 100, 0.5
        assert "MB of memory" in lost(session, {"x": 2.0}, Breakdown.MEMORY)


def test_memory_counts_when_the_first_thread_of_a_process_has_ended(tmp_path: Path) -> None:
    """Linux then shows none of it under the number of the process."""
    body = """
import ctypes, threading
if x == 1.0:
    for _ in range(3):
        if os.fork() == 0:
            threading.Thread(target=lambda: [bytearray(b"1") * (150 << 20), time.sleep(600)]).start()
            ctypes.CDLL(None).pthread_exit(None)
    time.sleep(600)
"""
    with served(tmp_path, body, memory_mb=300, timeout=20.0) as session:
        assert "MB of memory" in lost(session, {"x": 1.0}, Breakdown.MEMORY)


def test_pages_that_forks_share_count_once(tmp_path: Path) -> None:
    body = """
hold = bytearray(b'x' * (60 << 20))
forks = []
for _ in range(4):
    forks.append(os.fork())
    if not forks[-1]:
        sum(hold[::4096])
        time.sleep(600)
time.sleep(0.5)"""
    with served(tmp_path, body, memory_mb=150) as session:
        assert session.evaluate({"x": 1.0}).measures == {"y": 2.0}
        assert sum(process.resident for process in keeper.descendants(session._children._keeper)) > 200 << 20
        session._children.look()


def test_a_program_in_c_that_runs_out_of_memory_is_told_from_a_crash(tmp_path: Path) -> None:
    source = tmp_path / "sim.cpp"
    source.write_text(
        "#include <iostream>\n#include <string>\n#include <vector>\nint main() { std::string line; std::getline(std::cin, line);"
        ' std::cout << "{\\"ready\\": true}" << std::endl; std::getline(std::cin, line);'
        " std::vector<char> hold(3000000000u, 1); std::cout << hold[5] << std::endl; }\n"
    )
    compiled("g++", source, tmp_path / "sim")
    with opened("process", tmp_path, command=["./sim"], memory_mb=500) as session:
        assert "bad_alloc" in lost(session, {"x": 1.0}, Breakdown.MEMORY)


LIMITS = """
import resource
core, size = (resource.getrlimit(limit)[0] for limit in (resource.RLIMIT_CORE, resource.RLIMIT_FSIZE))
x = float(core == 0 < size < 1 << 40)
"""
"""A child cannot dump core or fill the disk with one file."""
SURROUNDINGS = """
handlers = [signal.getsignal(number) for number in (1, 15)]
descriptors = sorted(os.listdir('/proc/self/fd'))  # the last is that of the folder itself
x = float(os.getsid(0) == os.getpid() and handlers == [signal.SIG_DFL] * 2 and descriptors == ['0', '1', '2', '3'])
"""
"""A child leads a session with default signals and no foreign descriptors."""


@pytest.mark.parametrize("body", [LIMITS, SURROUNDINGS], ids=["limits", "surroundings"])
def test_a_child_finds_itself_apart_and_limited(tmp_path: Path, body: str) -> None:
    with served(tmp_path, body) as session:
        assert session.evaluate({"x": 0.0}).measures == {"y": 2.0}


def test_cpu_time_is_that_of_the_run(tmp_path: Path) -> None:
    """Compared with what the child itself measured."""
    body = """
start = time.process_time()
while time.process_time() < start + x: pass
if x == 0.0: time.sleep(1.0)
answer(id=request['id'], measures=dict(y=time.process_time() - start))
continue"""
    with served(tmp_path, body) as session:
        session.evaluate({"x": 0.1})
        for x in (0.3, 0.0):
            outcome = session.evaluate({"x": x})
            assert outcome.measures["y"] - 0.02 <= outcome.cpu_seconds < outcome.measures["y"] + 0.3


def test_cpu_time_behind_a_shell_script_and_of_short_lived_programs_counts(tmp_path: Path) -> None:
    busy = "import time\nstart = time.process_time()\nwhile time.process_time() < start + 0.3: pass"
    write_server(
        tmp_path,
        "start = time.process_time()\nwhile x and time.process_time() < start + 0.3: pass\n"
        f"if not x: subprocess.run([sys.executable, '-S', '-c', {busy!r}])",
    )
    write_script(tmp_path / "run.sh", f"#!/bin/sh\n{PYTHON} -S sim.py\nexit 0\n")
    with opened("process", tmp_path, command=["./run.sh"]) as session:
        assert session.evaluate({"x": 1.0}).cpu_seconds >= 0.2
        assert session.evaluate({"x": 0.0}).cpu_seconds >= 0.25


def test_the_time_of_a_start_is_no_runs(tmp_path: Path) -> None:
    start = "while time.process_time() < 0.4: pass"
    with served(tmp_path, "if x == 1.0:\n    os._exit(0)", start) as session:
        assert session.evaluate({"x": 0.0}).start_seconds == 0.0
        lost(session, {"x": 1.0}, Breakdown.CRASH)
        outcome = session.evaluate({"x": 0.0})
        assert outcome.start_seconds >= 0.4
        assert outcome.cpu_seconds < 0.3


@pytest.mark.slow("time.sleep(600)")
@pytest.mark.parametrize("body", ["os.abort()", "time.sleep(600)"])
def test_cpu_time_of_a_lost_run_counts(tmp_path: Path, body: str) -> None:
    with (
        served(
            tmp_path, f"start = time.process_time()\nwhile time.process_time() < start + 0.2: pass\n{body}", timeout=5.0
        ) as session,
        pytest.raises(NoMeasuresError) as error,
    ):
        session.evaluate({"x": 1.0})
    assert 0.19 <= error.value.cpu_seconds < 2.0


def test_descendants_are_found_and_none_besides(mark: str) -> None:
    with subprocess.Popen(["sh", "-c", f"{sys.executable} -S -c 'import time; time.sleep(600)' {mark}; exit 0"]) as process:
        until(lambda: len(keeper.descendants(process.pid)) == 1)
        (sleeper,) = keeper.descendants(process.pid)
        assert sleeper.parent == process.pid
        assert process.pid in [seen.pid for seen in keeper.descendants(os.getpid())]
        os.kill(sleeper.pid, signal.SIGKILL)
    assert keeper.seen(process.pid) is None


def test_folders_of_killed_workers_and_keepers_are_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    living, kept, dead = (Scratch(tmp_path) for _ in range(3))
    family = Children(["true"], {"memory_mb": 500}, kept)
    family._start_keeper()
    for killed in (kept, dead):
        os.close(killed.lock)
        killed.lock = -1
    Scratch(tmp_path).remove()
    assert dead.folder.exists(), "too young: its worker may be about to lock it"
    monkeypatch.setattr(machine, "A_MOMENT", -1.0)
    Scratch(tmp_path).remove()
    assert [each.folder.exists() for each in (living, kept, dead)] == [True, True, False]
    family.close()
    living.remove()
