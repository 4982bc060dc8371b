"""`drivecal serve` as a user starts it: a process of its own, a home folder of its own, real Ray and real SUMO."""

import json
import os
import signal
import ssl
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import psutil

TLS = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
"""For requests over plain HTTP: without it httpx reads the system's certificates before each, which was half of the fault suite's work."""


def environment(folder: Path, workers: int = 1) -> dict[str, str]:
    """Returns the environment of a user with an empty home folder."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("DRIVECAL_", "RAY_"))}
    return kept | {"HOME": str(folder), "DRIVECAL_HOME": str(folder / "home"), "DRIVECAL_WORKERS": str(workers)}


def until(condition: Callable[[], object], what: str = "what was awaited", seconds: float = 300.0) -> None:
    """Waits for `condition`; AssertionError where it takes too long."""
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            raise AssertionError(f"{what}: did not happen")
        time.sleep(0.05)


class Server:
    """`drivecal serve` in a folder of its own, on a free port where none is given; ready once made."""

    def __init__(self, folder: Path, workers: int = 1, port: int = 0, **settings: str) -> None:
        self.folder = folder
        self.log = folder / "log"
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "drivecal.cli", "serve", "--port", str(port), "--json"],
                cwd=folder,
                env=environment(folder, workers) | settings,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
            )
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line, self.log.read_text()
        self.url = json.loads(line)["url"]

    def family(self) -> list[psutil.Process]:
        return psutil.Process(self.process.pid).children(recursive=True)

    def alive(self) -> bool:
        try:
            return httpx.get(f"{self.url}/healthz", timeout=60, verify=TLS).status_code == 200
        except httpx.HTTPError:
            return False


@contextmanager
def serving(folder: Path, workers: int = 1, port: int = 0, **settings: str) -> Iterator[Server]:
    """A server until the block is left, where it is stopped as by a user, or killed if it does not. `settings` go into its environment."""
    started = Server(folder, workers, port, **settings)
    try:
        yield started
    finally:
        if started.process.poll() is None:
            started.process.send_signal(signal.SIGTERM)
            try:
                started.process.wait(timeout=20)
            except subprocess.TimeoutExpired:
                started.process.kill()
        started.process.wait()


def gone(family: list[psutil.Process]) -> bool:
    """True where none of these processes runs any more."""
    return not any(map(alive, family))


def alive(process: psutil.Process) -> bool:
    """Returns whether a process runs: it may also end between two questions."""
    try:
        return bool(process.is_running() and process.status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False
