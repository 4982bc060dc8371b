"""Stopped processes of a real server are noticed, reported and replaced, and what was accepted is computed all the same."""

import signal
from pathlib import Path

import httpx
import psutil
import pytest
from tests.support.hostile import NEIGHBOUR, WORKING, push
from tests.support.serve import Server, alive, serving, until

from drivecal.client import Client

pytestmark = pytest.mark.slow
WORKS = "import time\ndef evaluate(parameters, data):\n    time.sleep(0.1)\n    return {'y': parameters['x']}\n"


def running(server: Server, part: str) -> psutil.Process:
    """Returns the process of the server that has this part in its command."""
    commands = {process: process.cmdline() for process in server.family() if alive(process)}
    return next(
        process
        for process, command in commands.items()
        if any(word.startswith(part) for word in command) and "drivecal.server.guardian" not in command
    )


@pytest.mark.parametrize(
    ("backend", "part"),
    [
        ("processes", "drivecal.api"),
        ("processes", "drivecal.dispatch"),
        ("processes", "drivecal.execution.processes.child"),
        ("ray", "drivecal.dispatch"),
        ("ray", "ray::RayWorker"),
    ],
    ids=["API", "dispatcher", "worker", "dispatcher on Ray", "worker on Ray"],
)
@pytest.mark.parametrize("database", ["sqlite", "postgresql"])
def test_a_stopped_process_is_replaced_and_no_work_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest, backend: str, part: str, database: str
) -> None:
    monkeypatch.setenv("DRIVECAL_HOME", str(tmp_path / "home"))
    settings = {"DRIVECAL_BACKEND": backend, "DRIVECAL_BUNDLE_CACHE": str(tmp_path / "cache")}
    if database == "postgresql":
        settings["DRIVECAL_DATABASE_URL"] = request.getfixturevalue("postgres_url")
    with serving(tmp_path, 1, 0, **settings) as server, Client(server.url) as client:
        push(client, tmp_path, WORKING, WORKS)
        submitted = client.submit(NEIGHBOUR).id
        until(lambda: client.campaign(submitted).cells.simulated > 0, "the first results", 300)
        stopped = running(server, part)
        stopped.send_signal(signal.SIGSTOP)
        until(lambda: not alive(stopped), "the end of the stopped process", 300)
        until(server.alive, "an API", 300)
        ended = client.wait(submitted)
        assert (ended.state, ended.cells.failed) == ("succeeded", 0)
        again = client.wait(client.submit(NEIGHBOUR).id)
        assert (again.state, again.best) == ("succeeded", ended.best)
        assert (again.cells.requested, again.cells.simulated) == (ended.cells.requested, ended.cells.simulated)
        assert httpx.get(f"{server.url}/readyz", timeout=60).json() == {"ready": True, "problems": []}
