"""A Ray cluster of one node on this machine that can be killed and started again at the same address."""

import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import psutil
from tests.support.faults import cage
from tests.support.serve import environment
from tests.support.server import free_port
from tests.support.values import present

START_SECONDS = 60.0


class RayHead:
    """The head, in a cage: found and ended by parentage, never by `ray stop`, which would end every Ray of the machine."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._port = free_port()
        self._cage: subprocess.Popen[bytes] | None = None
        self.address = f"127.0.0.1:{self._port}"
        self.environment = {
            "RAY_AUTH_MODE": "disabled",
            "RAY_USAGE_STATS_ENABLED": "0",
            "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
        }

    def start(self) -> None:
        """Starts it and waits until it can be joined."""
        command = [str(Path(sys.executable).with_name("ray")), "start", "--head", "--block", "--include-dashboard=false"]
        command += ["--node-ip-address=127.0.0.1", f"--port={self._port}", "--num-cpus=2", "--disable-usage-stats"]
        command += [f"--dashboard-agent-listen-port={free_port()}"]
        command += [f"--temp-dir={tempfile.mkdtemp(dir=self._folder)}", f"--object-store-memory={80 * 2**20}"]
        log_file = self._folder / "log"
        with log_file.open("ab") as log:
            self._cage = subprocess.Popen(
                [sys.executable, cage.__file__, *command],
                env=environment(self._folder) | self.environment,
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        deadline = time.monotonic() + START_SECONDS
        while not self._listens():
            assert time.monotonic() < deadline, f"no Ray head:\n{log_file.read_text()[-3000:]}"
            time.sleep(0.1)

    def kill(self) -> None:
        """SIGKILL to all its processes, the workers on it included."""
        for process in psutil.Process(present(self._cage).pid).children(recursive=True):
            with suppress(psutil.NoSuchProcess):
                process.kill()
        self.close()

    def close(self) -> None:
        """Ends what is left of it."""
        if self._cage is not None:
            present(self._cage.stdin).close()
            self._cage.wait(60)
            self._cage = None

    def _listens(self) -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self._port)) == 0


@contextmanager
def ray_head() -> Iterator[RayHead]:
    """A head that runs; its folder, near the root because Ray's sockets lie deep in it, is gone afterwards."""
    with (
        tempfile.TemporaryDirectory(prefix="ray-", dir="/tmp", ignore_cleanup_errors=True) as folder,
        closing(RayHead(Path(folder))) as head,
    ):
        head.start()
        yield head
