"""`drivecal serve` in a cage: its processes found by parentage, killed, and started again on the same database and port."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import httpx
import psutil
from tests.support.effort import LONG
from tests.support.faults import cage
from tests.support.faults.patience import Patience
from tests.support.serve import TLS, alive, environment
from tests.support.server import free_port

from drivecal.domain.errors import DrivecalError
from drivecal.storage import processes
from drivecal.storage.engine.database import Database
from drivecal.storage.processes import StoredProcess

READY_SECONDS = 60.0 if LONG else 240.0
"""Longest time until a server is ready again after any kill. Time that the machine spends on other work does not count, here and below."""
STOP_SECONDS = 10.0 if LONG else 60.0
"""Longest time until SIGTERM has ended the server."""
ORPHAN_SECONDS = 5.0 if LONG else 60.0
"""Longest time until all processes are gone after a kill. Long runs test the promised limits; short runs share slow machines."""


class Coordinator:
    """A server with a folder, a port and a database that outlive its processes. Does nothing by itself: `start` it."""

    def __init__(
        self,
        folder: Path,
        database_url: str | None = None,
        settings: Mapping[str, str] | None = None,
        plugins: Path | None = None,
    ) -> None:
        """`settings`: environment variables. `plugins`: a folder whose packages are installed for it."""
        self.folder = folder
        self.port = free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self.database_url = database_url or f"sqlite:///{folder / 'home' / 'drivecal.db'}"
        self.log = folder / "log"
        self._environment = environment(folder, workers=2) | {"DRIVECAL_DATABASE_URL": self.database_url} | dict(settings or {})
        if plugins is not None:
            path = self._environment.get("PYTHONPATH")
            self._environment["PYTHONPATH"] = os.pathsep.join(filter(None, (str(plugins), path)))
        self._database: Database | None = None
        self._cage: subprocess.Popen[bytes] | None = None

    @property
    def database(self) -> Database:
        """The database, for looking at what is in it."""
        self._database = self._database or Database.open(self.database_url)
        return self._database

    def start(self) -> None:
        """Starts the server and waits for nothing."""
        assert self._cage is None, "it runs already"
        command = [sys.executable, "-m", "drivecal.cli", "serve", "--port", str(self.port)]
        with self.log.open("ab") as log:
            self._cage = subprocess.Popen(
                [sys.executable, cage.__file__, *command],
                cwd=self.folder,
                env=self._environment,
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )

    def start_ready(self) -> None:
        """Starts the server and waits until it can work."""
        self.start()
        self.wait_ready()

    @property
    def running(self) -> bool:
        """Returns whether anything of it runs."""
        return self._cage is not None and self._cage.poll() is None

    def family(self) -> list[psutil.Process]:
        """All processes of the server, the orphans among them included."""
        if self._cage is None:
            return []
        with suppress(psutil.NoSuchProcess):
            return [process for process in psutil.Process(self._cage.pid).children(recursive=True) if alive(process)]
        return []

    def supervisor(self) -> psutil.Process:
        """The process that was started."""
        return self._one("drivecal.cli", "serve")

    def api(self) -> psutil.Process:
        """The process that answers requests."""
        return self._one("drivecal.api")

    def dispatcher(self) -> psutil.Process:
        """The process that carries campaigns out."""
        return self._one("drivecal.dispatch")

    def ray_part(self, name: str) -> psutil.Process:
        """`raylet` or `gcs_server` of the local Ray."""
        result = [each for each in self.dispatcher().children(recursive=True) if alive(each) and each.name() == name]
        assert result, f"no {name} runs"
        return result[0]

    def workers(self) -> list[psutil.Process]:
        """The workers' processes that the dispatcher knows, as far as they run, by its last heartbeat; on this machine only."""
        told = self.heartbeat()
        known = {worker["pid"] for worker in told.detail.get("workers", ())} if told else set()
        return [process for process in self.family() if process.pid in known]

    def heartbeat(self) -> StoredProcess | None:
        """Returns what the dispatcher last said."""
        with self.database.read() as connection:
            return processes.read(connection, "dispatcher")

    def answers(self, path: str) -> httpx.Response | None:
        """The answer to GET, None where there is none."""
        try:
            return httpx.get(self.url + path, timeout=30.0, verify=TLS)
        except httpx.HTTPError:
            return None

    @property
    def ready(self) -> bool:
        """Returns whether the API is ready, names the running dispatcher, and this dispatcher has a worker."""
        answer = self.answers("/readyz")
        if answer is None or answer.status_code != httpx.codes.OK:
            return False
        try:
            told, dispatcher = self.heartbeat(), self.dispatcher()
        except (DrivecalError, AssertionError):
            return False
        if told is None or told.pid != dispatcher.pid:
            return False
        return any(worker["state"] != "starting" for worker in told.detail.get("workers", ()))

    def until(self, condition: Callable[[], bool], what: str, seconds: float) -> str:
        """Waits for `condition` and returns the time that it took, in words. Raises AssertionError after `seconds`, not counting the
        machine's other work."""
        patience = Patience(seconds, self.family)
        while not condition():
            assert not patience.over, f"{what}: did not happen within {patience.told()}\n{self.told()}"
            time.sleep(0.1)
        return patience.told()

    def awaited(self, find: Callable[[], psutil.Process]) -> psutil.Process:
        """A process of the server, waited for if it is only being started."""
        result: list[psutil.Process] = []

        def is_there() -> bool:
            with suppress(AssertionError, psutil.NoSuchProcess):
                result[:] = [find()]
            return bool(result)

        self.until(is_there, "a process that is looked for", READY_SECONDS)
        return result[0]

    def wait_ready(self) -> str:
        """Waits until the server can work; gives the time that it took, in words."""

        def ready() -> bool:
            assert self.running, f"the server has ended:\n{self.told()}"
            return self.ready

        return self.until(ready, "a server that is ready", READY_SECONDS)

    def kill_all(self) -> None:
        """Sends SIGKILL to all processes of the server at once, then to processes that started meanwhile."""
        patience = Patience(ORPHAN_SECONDS, self.family)
        while self.running and not patience.over:
            for process in self.family():
                with suppress(psutil.NoSuchProcess):
                    process.kill()
            time.sleep(0.02)
        self.wait_gone()

    def kill_supervisor(self) -> None:
        """SIGKILL to the process that was started; the others have to notice."""
        self.awaited(self.supervisor).kill()
        self.wait_gone()

    def terminate(self) -> str:
        """SIGTERM to the process that was started, as a user or an init system sends it; gives the time until nothing was left."""
        self.supervisor().send_signal(signal.SIGTERM)
        return self.wait_gone(STOP_SECONDS)

    def wait_gone(self, seconds: float = ORPHAN_SECONDS) -> str:
        """Waits until the server has no process left and its port is free. Returns the time that it took. Raises AssertionError with
        the remaining processes."""
        patience = Patience(seconds, self.family)
        while self.running:
            if patience.over:
                left = [f"{process.pid} {' '.join(process.cmdline())[:120]}" for process in self.family()]
                raise AssertionError(f"after {patience.told()} there are still {left}:\n{self.told()}")
            time.sleep(0.02)
        self._forget_cage()
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(("127.0.0.1", self.port))
        return patience.told()

    def told(self) -> str:
        """The end of what it said, of all its lives."""
        return self.log.read_text(errors="replace")[-6000:]

    def close(self) -> None:
        """Ends what is left of it, without asking."""
        if self._cage is not None:
            if self._cage.stdin:
                self._cage.stdin.close()
            self._cage.wait(60)
            self._forget_cage()
        self.close_database()

    def close_database(self) -> None:
        """Closes the connections of the test to the database; the next query opens new ones."""
        if self._database is not None:
            self._database.dispose()
            self._database = None

    def _forget_cage(self) -> None:
        assert self._cage is not None
        if self._cage.stdin:
            self._cage.stdin.close()
        self._cage = None

    def _one(self, *words: str) -> psutil.Process:
        """The process with these words in its command line; its guardian has them as well."""
        for process in self.family():
            with suppress(psutil.NoSuchProcess):
                line = process.cmdline()
                if all(word in line for word in words) and "drivecal.server.guardian" not in line:
                    return process
        raise AssertionError(f"no {' '.join(words)} runs")


def coordinator(
    folder: Path, database_url: str | None = None, settings: Mapping[str, str] | None = None, plugins: Path | None = None
) -> closing[Coordinator]:
    """A server that is not started yet; whatever runs of it at the end is killed."""
    folder.mkdir(parents=True, exist_ok=True)
    return closing(Coordinator(folder, database_url, settings, plugins))


@contextmanager
def suspended(family: list[psutil.Process]) -> Iterator[None]:
    """Processes stand still (SIGSTOP) until the block is left."""
    for process in family:
        with suppress(psutil.NoSuchProcess):
            process.suspend()
    try:
        yield
    finally:
        for process in family:
            with suppress(psutil.NoSuchProcess):
                process.resume()
