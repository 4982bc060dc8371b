"""The API as a process of its own, so that what it costs can be measured from outside."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx
import psutil
from tests.support.server import free_port

from drivecal.storage.engine.database import Database


@dataclass(frozen=True)
class ApiProcess:
    """A running API at `url`, a client of it, and the process."""

    url: str
    http: httpx.Client
    process: psutil.Process

    @property
    def megabytes(self) -> float:
        """Memory that the process holds."""
        return float(self.process.memory_info().rss) / 2**20


@contextmanager
def api_process(database_url: str, folder: Path, **settings: str) -> Iterator[ApiProcess]:
    """The API until the block is left; `settings` as environment variables without their prefix."""
    database = Database.open(database_url)
    database.upgrade()
    database.dispose()
    kept = {name: value for name, value in os.environ.items() if not name.startswith("DRIVECAL_")}
    own = {"DRIVECAL_DATABASE_URL": database_url, "DRIVECAL_HOME": str(folder / "home")}
    own |= {f"DRIVECAL_{name.upper()}": value for name, value in settings.items()}
    port = free_port()
    with (folder / "api.log").open("wb") as log:
        started = subprocess.Popen(
            [sys.executable, "-m", "drivecal.api", "--port", str(port)], env=kept | own, cwd=folder, stdout=log, stderr=log
        )
    url = f"http://127.0.0.1:{port}"
    try:
        with httpx.Client(base_url=url, timeout=60) as http:
            _wait(http, started, folder / "api.log")
            yield ApiProcess(url, http, psutil.Process(started.pid))
    finally:
        started.terminate()
        started.wait(timeout=60)


def _wait(http: httpx.Client, started: subprocess.Popen[bytes], log: Path) -> None:
    deadline = time.monotonic() + 300
    while time.monotonic() < deadline:
        if started.poll() is not None:
            raise AssertionError(log.read_text())
        try:
            http.get("/healthz")
        except httpx.TransportError:
            time.sleep(0.05)
        else:
            return
    raise AssertionError("the API did not answer")
