"""Runs the API alone: `python -m drivecal.api --host 127.0.0.1 --port 8000`. `drivecal serve` starts it together with the dispatcher."""

import argparse
import gc
import logging
import socket
import sys
from importlib.metadata import version

from drivecal.api.app import create_app
from drivecal.api.http.protocol import Server, configuration
from drivecal.cluster import pulse
from drivecal.configuration import logs, memory
from drivecal.configuration.pushing import OFF, Pushing
from drivecal.configuration.settings import Settings, load_settings
from drivecal.configuration.tokens import check_exposure
from drivecal.domain.errors import DrivecalError, InvalidInputError

log = logging.getLogger(__name__)


def main() -> int:
    """Serves until SIGTERM or SIGINT; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m drivecal.api", description="Serves the API; settings are in DRIVECAL_*.")
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=8000)
    parser.add_argument("--socket", type=int, help="file descriptor of a socket that listens already, instead of host and port")
    arguments = parser.parse_args()
    descriptor = pulse.take_descriptor()
    memory.settle()
    try:
        settings = load_settings()
        logs.configure("api", settings)
        if arguments.socket is not None:
            listener = socket.socket(fileno=arguments.socket)
        else:
            family = socket.AF_INET6 if ":" in arguments.host else socket.AF_INET
            created = socket.create_server((arguments.host, arguments.port), family=family)
            listener = socket.socket(fileno=created.detach())  # with its protocol: asyncio then sends small answers at once
        check_exposure(listener.getsockname()[0], settings)
        app = create_app(settings, _pushing(settings, listener.getsockname()[0]))
        server = Server(configuration(app, descriptor))
    except (DrivecalError, OSError) as error:
        log.error("%s", error)  # noqa: TRY400  # the sentence says it all; a traceback would bury it
        return 1
    if arguments.socket is None:  # else `drivecal serve` says so
        log.info("drivecal %s listens at %s port %d", version("drivecal"), *listener.getsockname()[:2])
    gc.collect()
    gc.freeze()  # what is loaded stays: looking through all of it again and again would stop the API for half a second each time
    server.run(sockets=[listener])
    return 0 if server.started else 1


def _pushing(settings: Settings, address: str) -> Pushing:
    """Returns who may push problems: no user if the secret for it cannot be written; everything else works without it."""
    try:
        return Pushing.of(settings, address)
    except InvalidInputError as error:
        log.warning("no problem can be pushed: %s", error)
        return OFF


if __name__ == "__main__":
    sys.exit(main())
