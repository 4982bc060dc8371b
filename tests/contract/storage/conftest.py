"""One behaviour suite for both backends: every test that asks for `database` or `empty_url` runs on SQLite and on PostgreSQL."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal

import pytest

from drivecal.storage.database import Database

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
    _migrate(f"sqlite:///{path}")
    return path


@pytest.fixture(scope="session")
def migrated_postgres(make_postgres_database: Callable[[str | None], str]) -> str:
    """A PostgreSQL database at the newest revision, to be copied."""
    url = make_postgres_database(None)
    _migrate(url)
    return url


def _migrate(url: str) -> None:
    database = Database.open(url)
    database.upgrade()
    database.dispose()


@pytest.fixture
def empty_url(backend: Backend, request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """The URL of a database in which nothing is yet."""
    return f"sqlite:///{tmp_path / 'drivecal.db'}" if backend == "sqlite" else str(request.getfixturevalue("postgres_url"))


@pytest.fixture
def url(backend: Backend, request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """The URL of a migrated database without rows."""
    if backend == "sqlite":
        shutil.copy(request.getfixturevalue("migrated_sqlite"), tmp_path / "drivecal.db")
        return f"sqlite:///{tmp_path / 'drivecal.db'}"
    make = request.getfixturevalue("make_postgres_database")
    return str(make(request.getfixturevalue("migrated_postgres")))


@pytest.fixture
def database(url: str) -> Iterator[Database]:
    """A migrated database without rows."""
    opened = Database.open(url)
    yield opened
    opened.dispose()
