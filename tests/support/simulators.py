"""Users' simulators for tests: sessions of scripts, and what a machine still runs of them."""

import os
import shutil
import stat
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from drivecal.adapters.environment import Scratch
from drivecal.adapters.kinds import simulator_of
from drivecal.domain.evaluations import Breakdown
from drivecal.domain.values import Setting
from drivecal.plugins.simulators import Declared, NoMeasuresError, RunOutcome, SimulatorSession

DECLARED = Declared("trial", ("y",), series=("t",))
DATA = {"k": 3}
PYTHON = sys.executable

SERVER = """
import json, os, signal, subprocess, sys, time

def answer(**fields):
    sys.stdout.write(json.dumps(fields) + "\\n")
    sys.stdout.flush()

def started():
    {start}
    answer(ready=True)

runs = 0
for line in sys.stdin:
    request = json.loads(line)
    if "quit" in request:
        {quit}
        break
    if "drivecal" in request:
        greeting = request
        started()
        continue
    x = request["parameters"].get("x")
    runs += 1
    {body}
    answer(id=request["id"], measures=dict(y=2.0 * x))
"""
"""A simulator in Python. Answers twice x, unless its `body` does something else before."""


def write_server(folder: Path, body: str = "", start: str = "", ending: str = "") -> list[str]:
    """Writes a simulator into a bundle and returns its command."""
    shown = {"body": body, "start": start, "quit": ending}
    text = SERVER
    for name, code in shown.items():
        indent = "        " if name == "quit" else "    "
        text = text.replace(f"{{{name}}}", (code or "pass").strip().replace("\n", f"\n{indent}"))
    (folder / "sim.py").write_text(text)
    return [PYTHON, "-S", "sim.py"]


def write_script(path: Path, text: str) -> Path:
    """Writes an executable file."""
    path.write_text(text)
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


def opened(
    kind: str, folder: Path, declared: Declared = DECLARED, data: Mapping[str, Any] = DATA, **section: Any
) -> closing[SimulatorSession]:
    """Opens a session of scenario `S`."""
    defaults = {"function": "evaluate"} if kind == "python" else {}
    settings = {"kind": kind, "timeout": 300.0, "memory_mb": 1000} | defaults | section
    return closing(simulator_of(settings).open(settings, "S", data, folder, declared))


def served(folder: Path, body: str = "", start: str = "", ending: str = "", **section: Any) -> Any:
    """Opens a session of a `process` simulator with this body."""
    return opened("process", folder, command=write_server(folder, body, start, ending), **section)


def scratch_of(session: Any) -> Scratch:
    """The folders of a session."""
    scratch: Scratch = session._scratch
    return scratch


def lost(session: SimulatorSession, parameters: Mapping[str, Setting], breakdown: Breakdown) -> str:
    """Runs a parameter set that has no result for this reason; returns the detail."""
    with pytest.raises(NoMeasuresError) as error:
        session.evaluate(parameters)
    assert error.value.breakdown is breakdown, error.value.detail
    return error.value.detail


def hung(session: Any, parameters: Mapping[str, Setting], seconds: float = 2.0) -> str:
    """As `lost`, by a hang. Only this run has so short a limit: others of the test may meet a machine that stands still for a while."""
    limit, session._timeout = session._timeout, seconds
    try:
        return lost(session, parameters, Breakdown.HANG)
    finally:
        session._timeout = limit


def compiled(compiler: str, source: Path, target: Path, *options: str) -> Path:
    """Compiles a C or C++ file."""
    assert shutil.which(compiler), f"the tests need a compiler: {compiler}"
    subprocess.run([compiler, "-O1", *options, "-o", str(target), str(source)], check=True, capture_output=True)
    return target


def running(mark: str) -> list[psutil.Process]:
    """The living processes whose command has a mark."""
    processes = []
    for process in psutil.process_iter():
        try:
            if process.status() != psutil.STATUS_ZOMBIE and any(mark in part for part in process.cmdline()):
                processes.append(process)
        except psutil.Error:
            continue
    return processes


def is_running(pid: int) -> bool:
    """Returns whether a process lives; a zombie does not."""
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


ANOTHER_USER = 65_534
"""`nobody`: rights of files mean something to it."""


def as_another_user(action: Callable[[Path], None]) -> None:
    """Runs an action in a process of another user than root, in a folder of its own. Raises AssertionError if it raises an error."""
    folder = Path(tempfile.mkdtemp())  # `tmp_path` lets no other user in
    os.chown(folder, *((ANOTHER_USER, ANOTHER_USER) if os.geteuid() == 0 else (-1, -1)))
    child = os.fork()
    if child == 0:
        try:
            if os.geteuid() == 0:
                os.setgid(ANOTHER_USER)
                os.setuid(ANOTHER_USER)
            action(folder)
        except BaseException:  # noqa: BLE001  # this process is the test's own copy, and must not go on as it
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    status = os.waitpid(child, 0)[1]
    for path in (folder, *folder.rglob("*")):
        if not path.is_symlink():
            path.chmod(0o700)
    shutil.rmtree(folder, ignore_errors=True)
    assert status == 0, "its error is in standard error"


def nest(folder: Path, name: str, depth: int) -> None:
    """Makes nested folders, deeper than a path can name."""
    descriptor = os.open(folder, os.O_RDONLY)
    for _ in range(depth):
        os.mkdir(name, dir_fd=descriptor)
        deeper = os.open(name, os.O_RDONLY, dir_fd=descriptor)
        os.close(descriptor)
        descriptor = deeper
    os.close(descriptor)


def series(outcome: RunOutcome, name: str) -> np.ndarray:
    """A time series of a run."""
    return np.array(outcome.series[name])
