"""Fixtures that several integration suites share."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.support.command import Run, command
from tests.support.databases import migrated
from tests.support.server import RunningApi

from drivecal.storage.engine.database import Database


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    """A new SQLite database."""
    opened = migrated(f"sqlite:///{tmp_path / 'drivecal.db'}")
    yield opened
    opened.dispose()


@pytest.fixture
def run(api: RunningApi, monkeypatch: pytest.MonkeyPatch) -> Run:
    """The command, with the suite's server as the one it talks to."""
    monkeypatch.setenv("DRIVECAL_URL", api.url)
    return command
