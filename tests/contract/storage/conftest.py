"""One behaviour suite for both backends: every test that asks for `database` or `empty_url` runs on SQLite and on PostgreSQL."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import psycopg
import pytest
from psycopg import sql
from sqlalchemy import Connection
from tests.support.databases import migrated
from tests.support.postgres import create_database

from drivecal.storage.engine.database import Database
from drivecal.storage.engine.tables import metadata

Backend = Literal["sqlite", "postgresql"]


@pytest.fixture(params=["sqlite", "postgresql"])
def backend(request: pytest.FixtureRequest) -> Backend:
    """The kind of database that the test runs on."""
    chosen: Backend = request.param
    return chosen


@pytest.fixture(scope="session")
def migrated_sqlite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An SQLite database at the newest revision, to be copied."""
    path = tmp_path_factory.mktemp("migrated") / "drivecal.db"
    migrated(f"sqlite:///{path}").dispose()
    return path


@pytest.fixture(scope="session")
def migrated_postgres(postgres_server: str) -> str:
    """A PostgreSQL database at the newest revision."""
    url = create_database(postgres_server, "migrated")
    migrated(url).dispose()
    return url


@pytest.fixture
def clean_postgres(migrated_postgres: str) -> str:
    """The same without rows: copying it, as is done with the file of SQLite, takes a hundred times as long."""
    with psycopg.connect(migrated_postgres, autocommit=True) as connection:
        tables = sql.SQL(", ").join(map(sql.Identifier, metadata.tables))
        connection.execute(sql.SQL("TRUNCATE {} RESTART IDENTITY").format(tables))
    return migrated_postgres


@pytest.fixture
def empty_url(backend: Backend, request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """The URL of an empty database."""
    return f"sqlite:///{tmp_path / 'drivecal.db'}" if backend == "sqlite" else str(request.getfixturevalue("postgres_url"))


@pytest.fixture
def url(backend: Backend, request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """The URL of a migrated database without rows."""
    if backend == "sqlite":
        shutil.copy(request.getfixturevalue("migrated_sqlite"), tmp_path / "drivecal.db")
        return f"sqlite:///{tmp_path / 'drivecal.db'}"
    return str(request.getfixturevalue("clean_postgres"))


@pytest.fixture
def database(url: str) -> Database:
    """A migrated database without rows."""
    return Database.open(url)


@pytest.fixture
def connection(database: Database) -> Iterator[Connection]:
    """A transaction on it, for tests that need no other."""
    with database.transaction() as opened:
        yield opened
