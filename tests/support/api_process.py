"""The API as a process of its own, so that what it costs can be measured from outside."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import httpx
import psutil
from tests.support.databases import migrated
from tests.support.serve import until
from tests.support.server import free_port


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
def api_process(database_url: str, folder: Path) -> Iterator[ApiProcess]:
    """The API until the block is left."""
    migrated(database_url).dispose()
    kept = {name: value for name, value in os.environ.items() if not name.startswith("DRIVECAL_")}
    own = {"DRIVECAL_DATABASE_URL": database_url, "DRIVECAL_HOME": str(folder / "home")}
    port = free_port()
    with (folder / "api.log").open("wb") as log:
        started = subprocess.Popen(
            [sys.executable, "-m", "drivecal.api", "--port", str(port)], env=kept | own, cwd=folder, stdout=log, stderr=log
        )
    url = f"http://127.0.0.1:{port}"
    try:
        with httpx.Client(base_url=url, timeout=60) as http:

            def answers() -> bool:
                assert started.poll() is None, (folder / "api.log").read_text()
                with suppress(httpx.TransportError):
                    return http.get("/healthz").is_success
                return False

            until(answers, "the answer of the API")
            yield ApiProcess(url, http, psutil.Process(started.pid))
    finally:
        started.terminate()
        started.wait(timeout=60)
