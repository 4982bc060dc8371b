"""The demo's coordinator: `drivecal serve` in a child process, on a free loopback port and a fresh database."""

import fcntl
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from drivecal.client.client import Client
from drivecal.configuration.settings import load_settings
from drivecal.domain.errors import ConflictError, DrivecalError

SECONDS_TO_START = 600.0
"""Ray needs some seconds, compiling the kernels for the first time half a minute on a slow machine, and many times that on a busy one."""
SECONDS_TO_STOP = 20.0
ANNOUNCEMENT = "serve.json"
"""File with the address of the ready coordinator."""
LOG = "serve.log"
SECONDS_BETWEEN_SIGNS = 15.0
"""Longest silence while the workers start."""


@contextmanager
def fresh_folder(folder: Path) -> Iterator[None]:
    """Empties `folder` and keeps other demos out of it.

    Raises ConflictError if a demo is running there, and DatabaseError if a server uses the last demo's database.
    """
    from drivecal.storage.engine import locks

    folder.parent.mkdir(parents=True, exist_ok=True)
    with folder.with_suffix(".lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise ConflictError(f"another demo is running in {folder}; wait for it or stop it") from error
        with locks.hold(_database_url(folder), "set DRIVECAL_HOME to another folder: a new demo empties this one"):
            shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(exist_ok=True)
        yield


def _database_url(folder: Path) -> str:
    return f"sqlite:///{folder / 'drivecal.db'}"


@contextmanager
def coordinator(home: Path, tell: Callable[[str], None] = lambda _: None) -> Iterator[Client]:
    """Runs a coordinator with its files in `home` until the block is left, and yields a client of it once its workers are ready.

    Calls `tell` with what it waits for. Raises DrivecalError with the end of the log if it does not start.
    """
    settings = load_settings(home=str(home), database_url=_database_url(home)).environment
    environment = {name: value for name, value in (os.environ | settings).items() if name != "DRIVECAL_TOKENS_FILE"}
    # The guardian ends the server, whatever becomes of the demo: it notices when our end of its standard input is gone.
    guardian = [sys.executable, "-m", "drivecal.server.guardian", str(SECONDS_TO_STOP), ""]
    serve = [sys.executable, "-m", "drivecal.cli", "serve", "--host", "127.0.0.1", "--port", "0", "--json"]
    with (home / ANNOUNCEMENT).open("wb") as announcement, (home / LOG).open("wb") as log:
        # In a session of its own: Ctrl-C reaches the demo alone, which then stops the server as it should be stopped.
        process = subprocess.Popen(  # noqa: S603  # our own command
            [*guardian, *serve],
            env=environment,
            cwd=home,  # where no config file is: a demo on loopback asks for no token, whatever the user's own server does
            stdin=subprocess.PIPE,
            stdout=announcement,
            stderr=log,
            start_new_session=True,
        )
    try:
        with _interrupted_by_sigterm(), Client(url_when_ready(process, home, tell), token="") as client:
            yield client
    finally:
        process.terminate()
        process.wait()


@contextmanager
def _interrupted_by_sigterm() -> Iterator[None]:
    """Turns SIGTERM into KeyboardInterrupt, as Ctrl-C does, so that everything is cleaned up."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def url_when_ready(process: subprocess.Popen[bytes], home: Path, tell: Callable[[str], None]) -> str:
    """Returns the address once the workers are ready. Tells it as soon as the page answers, and how long the workers have been starting."""
    began = last_sign = time.monotonic()
    page: str | None = None
    while (now := time.monotonic()) < began + SECONDS_TO_START:
        line, newline, _ = (home / ANNOUNCEMENT).read_text().partition("\n")
        if newline:
            url = str(json.loads(line)["url"])
            tell(f"the workers are ready after {now - began:.0f} s; watch the campaign at {url}")
            return url
        if process.poll() is not None:
            raise DrivecalError(f"the coordinator did not start (exit status {process.returncode}):\n{_end_of(home / LOG)}")
        if page is None and (page := _answering(home / LOG)) is not None:
            tell(f"the page is at {page}; the workers are starting")
            last_sign = now
        elif now >= last_sign + SECONDS_BETWEEN_SIGNS:
            tell(f"{'the server is' if page is None else 'the workers are'} still starting ({now - began:.0f} s)")
            last_sign = now
        time.sleep(0.1)
    raise DrivecalError(
        f"the coordinator is not ready after {SECONDS_TO_START:.0f} s; if the machine was busy, try again:\n{_end_of(home / LOG)}"
    )


def _answering(log: Path) -> str | None:
    """Returns the address of the page once the log says that it answers."""
    from drivecal.server.serving import ANSWERING

    pattern = re.escape(ANSWERING).replace("%s", r"(http://\S+)")
    answering = re.search(pattern, log.read_text(errors="replace"))
    return None if answering is None else answering[1]


def _end_of(log: Path) -> str:
    return "\n".join(log.read_text(errors="replace").splitlines()[-15:])
