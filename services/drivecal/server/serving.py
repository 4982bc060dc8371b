"""The server: its socket and database, its processes, and its readiness."""

import errno
import http.client
import logging
import os
import socket
import sys
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path

from drivecal.cluster.homes import DATABASE_ENDINGS, remember
from drivecal.configuration.settings import Settings
from drivecal.configuration.tokens import is_loopback
from drivecal.domain.errors import ConflictError, DrivecalError, InvalidInputError, Problem
from drivecal.server.supervisor import ChildProcess, Supervisor
from drivecal.storage import processes
from drivecal.storage.engine import server_lock
from drivecal.storage.engine.database import PROMPT, Database
from drivecal.storage.engine.urls import parse, sqlite_file

DISPATCHER = (sys.executable, "-P", "-m", "drivecal.dispatch")
BACKLOG = 512
PROBE_SECONDS = 2.0

log = logging.getLogger(__name__)


def listen(host: str, port: int) -> socket.socket:
    """Returns a listening socket; port 0 takes any free port.

    The supervisor holds it, so that the port is taken before anything starts, and connections wait while the API restarts. Raises
    InvalidInputError if the host is not an address of this machine, and ConflictError if the port cannot be used.
    """
    foreign = Problem("--host", f"{host!r} is not an address of this machine", "give e.g. 127.0.0.1")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
    except (OSError, UnicodeError) as error:
        raise InvalidInputError(foreign) from error
    listener = socket.socket(family, kind, protocol)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(BACKLOG)
    except OSError as error:
        listener.close()
        if error.errno == errno.EADDRNOTAVAIL:
            raise InvalidInputError(foreign) from error
        reason = "is in use" if error.errno == errno.EADDRINUSE else f"cannot be used: {error.strerror}"
        raise ConflictError(f"port {port} of {host} {reason}; choose another one by --port (0 takes any free one)") from error
    return listener


def url_of(listener: socket.socket, host: str) -> str:
    """Returns the server's address for clients on this machine."""
    address, port = listener.getsockname()[:2]
    if is_loopback(address) and host != "localhost":
        host = address  # a server without tokens answers to this address, whatever name was given
    if host in {"0.0.0.0", "::", ""}:  # noqa: S104  # compared, not bound
        host = "127.0.0.1"
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def prepare_database(settings: Settings) -> Database:
    """Creates or upgrades the database and returns it.

    Raises DatabaseError if it cannot be used or another server uses it, and InvalidInputError if the home folder cannot be created.
    """
    try:
        settings.home.mkdir(parents=True, exist_ok=True, mode=0o700)
    except OSError as error:
        problem = Problem("home", f"{settings.home} cannot be made: {error.strerror}", "set DRIVECAL_HOME to a folder of yours")
        raise InvalidInputError(problem) from error
    database = Database.open(settings.database_url)
    file = sqlite_file(parse(settings.database_url))
    files = [] if file is None else [Path(f"{file}{ending}") for ending in DATABASE_ENDINGS]
    remember([settings.home, *filter(None, (settings.tokens_file, settings.database_password_file)), *files])
    with server_lock.hold(settings.database_url):  # the dispatcher takes it for good
        database.upgrade()
    return database


class Startup:
    """Looks for what a new server still waits for."""

    def __init__(self, database: Database, url: str) -> None:
        """Call it before the dispatcher starts, whose term is compared with the last one: the clock may be set meanwhile."""
        self._database, self._url = database, url
        self._last_term = database.query(processes.term_in_office)

    def missing(self) -> list[str]:
        """Returns what is not ready yet."""
        lacking = [] if _answers(self._url) else ["API"]
        try:
            dispatcher = self._database.query(processes.read, processes.DISPATCHER)
        except DrivecalError as error:
            return [*lacking, str(error)]
        if dispatcher is None or dispatcher.term == self._last_term:
            return [*lacking, "dispatcher"]
        if all(worker["state"] == "starting" for worker in dispatcher.detail.get("workers", [])):
            reason = dispatcher.detail.get("degraded")
            return [*lacking, f"workers ({reason})" if reason else "workers"]
        return lacking


def run_server(settings: Settings, listener: socket.socket, url: str, ready: Callable[[], None]) -> int:
    """Runs API and dispatcher until a signal and returns the exit code. Calls `ready` once both work."""
    database = Database.open(settings.database_url, PROMPT)  # a signal waits for what is asked
    startup = Startup(database, url)
    descriptor = listener.fileno()
    api = (sys.executable, "-P", "-m", "drivecal.api", "--socket", str(descriptor))
    children = [
        ChildProcess("API", api, settings.environment | {"DRIVECAL_WEBHOOK": ""}, (descriptor,)),  # a secret
        ChildProcess("dispatcher", (*DISPATCHER, str(os.getpid())), settings.environment),
    ]
    try:
        return Supervisor(children, startup.missing, ready).run()
    finally:
        database.dispose()


def _answers(url: str) -> bool:
    with (
        closing(http.client.HTTPConnection(url.removeprefix("http://"), timeout=PROBE_SECONDS)) as connection,
        suppress(OSError, http.client.HTTPException),
    ):
        connection.request("GET", "/healthz")
        return connection.getresponse().status == http.client.OK
    return False
