"""Starts a local Ray or joins a cluster: quiet, private, and without taking over the process."""

from __future__ import annotations

import os
import re
import secrets
import shutil
import signal
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

from drivecal.domain.errors import UnavailableError

OBJECT_STORE_BYTES = 80 * 2**20
"""Ray's least: batches and results travel with the calls, the object store stays empty."""
LONGEST_FOLDER = 40
"""Ray's sockets lie 65 characters deep, and a Unix socket's path ends at 107."""

_ALWAYS = {
    "RAY_USAGE_STATS_ENABLED": "0",
    # what the backend reports in one line, Ray would print in a paragraph
    "RAY_DEDUP_LOGS": "1",
    "RAY_DEDUP_LOGS_SKIP_REGEX": "A worker died or was killed|died or was killed by",
    # bookkeeping of every call for a dashboard that is not there: a fifth of a call's CPU time
    "RAY_task_events_report_interval_ms": "0",
    "RAY_enable_metrics_collection": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
}
_LOCAL = {
    "RAY_AUTH_MODE": "token",
    # despite its name it makes Ray on Linux, too, listen on 127.0.0.1 only
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
}


class Cluster:
    """A connection to Ray: `ray` is the module, imported only after its environment was set."""

    def __init__(self, address: str | None, cpus: int | None) -> None:
        """Starts a local Ray with `cpus` CPUs (None: all), or joins the cluster at `address`. Raises UnavailableError."""
        self.address = address
        self._folder: Path | None = None
        os.environ.update(_ALWAYS)
        if address is None:
            os.environ.update(_LOCAL, RAY_AUTH_TOKEN=secrets.token_hex(32))
            self._folder = _private_folder()
        elif "RAY_AUTH_MODE" not in os.environ:
            with_token = "RAY_AUTH_TOKEN" in os.environ or "RAY_AUTH_TOKEN_PATH" in os.environ
            os.environ["RAY_AUTH_MODE"] = "token" if with_token else "disabled"
        import ray  # reads its environment at import

        self.ray: ModuleType = ray
        try:
            with _own_signal_handlers():
                if address is None:
                    ray.init(
                        num_cpus=cpus,
                        include_dashboard=False,
                        object_store_memory=OBJECT_STORE_BYTES,
                        _temp_dir=str(self._folder),
                        **_QUIET,
                    )
                else:
                    ray.init(address=address, **_QUIET)
        except Exception as error:
            self.close()
            where = "a local Ray" if address is None else f"the Ray cluster at {address}"
            reason = " ".join(str(error).split()) or type(error).__name__
            raise UnavailableError(f"{where} cannot be used: {reason[:500]}") from error

    def cpus(self) -> int:
        """The CPUs of all nodes."""
        return int(self.ray.cluster_resources().get("CPU", 0))

    def close(self) -> None:
        """Leaves the cluster; a local Ray ends."""
        self.ray.shutdown()
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)


_QUIET: dict[str, Any] = {"namespace": "drivecal", "log_to_driver": False, "configure_logging": False, "logging_level": "ERROR"}


@contextmanager
def _own_signal_handlers() -> Iterator[None]:
    """Ray replaces the handler of SIGTERM."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def _private_folder() -> Path:
    """A new folder for a local Ray's sockets and logs that only this user can enter; those of processes that were killed go."""
    parent = Path(tempfile.gettempdir())
    if len(str(parent)) > LONGEST_FOLDER - 27:
        parent = Path("/tmp")  # noqa: S108  # mkdtemp makes a private folder in it
    for folder in parent.glob("drivecal-ray-*"):
        match = re.fullmatch(r"drivecal-ray-(\d+)-.*", folder.name)
        if (
            match
            and not Path(f"/proc/{match[1]}").exists()
            and Path("/proc/self").exists()
            and folder.stat().st_uid == os.getuid()
        ):
            shutil.rmtree(folder, ignore_errors=True)
    return Path(tempfile.mkdtemp(prefix=f"drivecal-ray-{os.getpid()}-", dir=parent))
