"""Fixtures that several integration suites share."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.support.command import Run, command
from tests.support.databases import migrated
from tests.support.server import RunningApi, new_database, serving

from drivecal.storage.engine.database import Database


@pytest.fixture
def database(tmp_path: Path) -> Database:
    """A new SQLite database."""
    return migrated(f"sqlite:///{tmp_path / 'drivecal.db'}")


@pytest.fixture(scope="module")
def api(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningApi]:
    """The API on a new database of the module: SQLite, unless its tests are for both kinds."""
    with serving(new_database(request, getattr(request, "param", "sqlite"), tmp_path_factory.mktemp("api"))) as running:
        yield running


@pytest.fixture
def run(api: RunningApi, monkeypatch: pytest.MonkeyPatch) -> Run:
    """The command, with the suite's server as the one it talks to."""
    monkeypatch.setenv("DRIVECAL_URL", api.url)
    return command
