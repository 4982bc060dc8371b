"""The API over real HTTP, on a database of its own."""

import itertools
import os
import socket
import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
from tests.support.databases import migrated
from tests.support.postgres import create_database

from drivecal.api.app import create_app
from drivecal.api.http.protocol import Server, configuration
from drivecal.configuration.pushing import OFF, Pushing
from drivecal.configuration.settings import load_settings
from drivecal.storage.engine.database import Database


@dataclass(frozen=True)
class RunningApi:
    """A server at `url`, the client that speaks to it, and its database."""

    url: str
    http: httpx.Client
    database: Database


_PORTS = itertools.count(20_000 + 120 * (os.getpid() % 100))


def free_port() -> int:
    """Returns a port without a listener, below Linux's range for outgoing connections: else a client of a stopped server could get the
    server's port and connect to itself."""
    while True:
        port = next(_PORTS)
        with socket.socket() as probe, suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port


def new_database(request: pytest.FixtureRequest, kind: str, folder: Path) -> str:
    """The URL of a database that does not exist yet (SQLite, in `folder`) or is empty (PostgreSQL)."""
    if kind == "sqlite":
        return f"sqlite:///{folder / 'drivecal.db'}"
    server: str = request.getfixturevalue("postgres_server")
    return create_database(server, f"api_{uuid.uuid4().hex}")


@contextmanager
def serving(database_url: str, port: int = 0, **settings: Any) -> Iterator[RunningApi]:
    """The API on a loopback port, a free one where none is given, until the block is left; `settings` next to the database, as flags.

    Problems can be pushed with a tokens file, or by the secret in a `home` of the test's own.
    """
    database = migrated(database_url)
    listener = socket.socket(fileno=socket.create_server(("127.0.0.1", port)).detach())
    loaded = load_settings(database_url=database_url, **settings)
    pushing = Pushing.of(loaded, "127.0.0.1") if {"home", "tokens_file"} & settings.keys() else OFF
    server = Server(configuration(create_app(loaded, pushing)))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
    thread.start()
    while not server.started:
        if not thread.is_alive():
            raise RuntimeError("the server ended before it was ready")
        time.sleep(0.01)
    url = f"http://127.0.0.1:{listener.getsockname()[1]}"
    try:
        with httpx.Client(base_url=url, timeout=300, verify=False) as http:  # http: certificates take 20 ms to load
            yield RunningApi(url, http, database)
    finally:
        server.should_exit = True
        thread.join()
        database.dispose()


def refused(response: httpx.Response) -> dict[str, Any]:
    """The problem document of any refusal, which is short."""
    assert 400 <= response.status_code < 500, (response.status_code, response.text[:500])
    assert len(response.content) < 100_000
    return problem_of(response, response.status_code)


def problem_of(response: httpx.Response, status: int) -> dict[str, Any]:
    """The problem document that a response with this status has to be."""
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    document: dict[str, Any] = response.json()
    assert document["status"] == status
    assert document["title"]
    assert document["detail"]
    return document
