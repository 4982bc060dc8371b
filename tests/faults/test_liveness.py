"""Stopped and killed processes of a server are noticed and replaced within 20 s, and the campaigns that ran find the same."""

import random
import signal
import statistics
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil
import pytest
from tests.support.faults.coordinator import Coordinator
from tests.support.faults.patience import Patience
from tests.support.hostile import NEIGHBOUR, WORKING, push
from tests.support.serve import alive

from drivecal.client import Client

REPLACED_SECONDS = 20.0
"""From the signal until another process is there, without what the machine does for others."""
PARTS = {
    "API": ("processes", "drivecal.api"),
    "dispatcher": ("processes", "drivecal.dispatch"),
    "worker": ("processes", "drivecal.execution.processes.child"),
    "dispatcher on Ray": ("ray", "drivecal.dispatch"),
    "worker on Ray": ("ray", "ray::RayWorker"),
}
"""Backend, and a word that only the command of the process has."""
ONCE = [("API", "sqlite", 1), ("dispatcher", "postgresql", 1), ("worker", "sqlite", 1), ("worker on Ray", "postgresql", 1)]
OFTEN = [(part, database, 20) for part in PARTS for database in ("sqlite", "postgresql")]
WORKS = "import time\ndef evaluate(parameters, data):\n    time.sleep(0.1)\n    return {'y': parameters['x']}\n"


def running(server: Coordinator, word: str) -> list[psutil.Process]:
    """Returns the server's processes that have this word in their command."""
    result = []
    for process in server.family():
        with suppress(psutil.NoSuchProcess):
            command = process.cmdline()
            if any(part.startswith(word) for part in command) and "drivecal.server.guardian" not in command:
                result.append(process)
    return result


def seconds_to_replace(server: Coordinator, word: str, number: int) -> float:
    """Sends a signal to a process; returns the seconds of the wall until it has ended and another has its place."""
    before = running(server, word)
    patience, begin = Patience(REPLACED_SECONDS, server.family), time.monotonic()
    before[0].send_signal(number)
    while alive(before[0]) or set(running(server, word)) <= set(before):
        assert not patience.over, f"{word} was not replaced within {patience.told()}\n{server.told()}"
        time.sleep(0.05)
    return time.monotonic() - begin


@pytest.mark.slow(*(f"{part}-{database}-{signals}" for part, database, signals in ONCE))
@pytest.mark.faults(*(f"{part}-{database}-{signals}" for part, database, signals in OFTEN))
@pytest.mark.timeout(7200)
@pytest.mark.parametrize(("part", "database", "signals"), ONCE + OFTEN)
def test_a_stopped_or_killed_process_is_replaced_and_no_work_is_lost(
    server_on: Callable[..., Coordinator],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    base_seed: int,
    part: str,
    database: str,
    signals: int,
) -> None:
    """The process is stopped as often as `signals` says, and killed a quarter as often, while campaigns run."""
    monkeypatch.setenv("DRIVECAL_HOME", str(tmp_path / "home"))
    backend, word = PARTS[part]
    kinds = [*[signal.SIGSTOP] * signals, *[signal.SIGKILL] * (signals // 4)]
    random.Random(base_seed).shuffle(kinds)
    server = server_on(database, DRIVECAL_BACKEND=backend, DRIVECAL_WORKERS="1", DRIVECAL_BUNDLE_CACHE=str(tmp_path / "cache"))
    server.start_ready()
    campaigns: list[Any] = []
    took: dict[int, list[float]] = {int(signal.SIGSTOP): [], int(signal.SIGKILL): []}
    with Client(server.url) as client:
        push(client, tmp_path, WORKING, WORKS)
        undisturbed = client.wait(client.submit(NEIGHBOUR).id)
        for kind in kinds:
            submitted = client.submit(NEIGHBOUR).id
            while client.campaign(submitted).cells.simulated == 0:
                time.sleep(0.05)
            took[int(kind)].append(seconds_to_replace(server, word, kind))
            print(f"{kind.name}: replaced after {took[int(kind)][-1]:.1f} s, ready {server.wait_ready()} later", flush=True)
            campaigns.append(client.wait(submitted))
    for sent, seconds in took.items():
        if seconds:
            print(f"{part}, {database}, {signal.Signals(sent).name}: {len(seconds)} times, replaced after", end=" ")
            print(f"{statistics.median(seconds):.1f} s in the median, {max(seconds):.1f} s at most")
    for ended in campaigns:
        assert (ended.state, ended.best, ended.cells.failed) == ("succeeded", undisturbed.best, 0)
        assert (ended.cells.requested, ended.cells.simulated) == (undisturbed.cells.requested, undisturbed.cells.simulated)
