"""Runs the API alone: `python -m drivecal.api --host 127.0.0.1 --port 8000`. `drivecal serve` starts it together with the dispatcher."""

from __future__ import annotations

import argparse
import socket
import sys

import uvicorn

from drivecal.api.app import create_app
from drivecal.configuration.settings import load_settings


def main() -> int:
    """Serves until SIGTERM or SIGINT."""
    parser = argparse.ArgumentParser(
        prog="python -m drivecal.api", description="Serves the API; settings come from DRIVECAL_*."
    )
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=8000)
    parser.add_argument("--socket", type=int, help="file descriptor of a socket that listens already, instead of host and port")
    arguments = parser.parse_args()
    configuration = uvicorn.Config(
        create_app(load_settings()),
        host=arguments.host,
        port=arguments.port,
        log_level="warning",
        server_header=False,
        timeout_graceful_shutdown=5,
    )
    server = uvicorn.Server(configuration)
    server.run(sockets=None if arguments.socket is None else [socket.socket(fileno=arguments.socket)])
    return 0 if server.started else 1


if __name__ == "__main__":
    sys.exit(main())
