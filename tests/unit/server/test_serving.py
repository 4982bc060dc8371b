"""When a server that was just started is ready."""

from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
from tests.support.databases import migrated

from drivecal.server import serving
from drivecal.server.serving import Startup
from drivecal.storage import processes
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now


def report(database: Database, state: str) -> None:
    detail: dict[str, Any] = {"workers": [{"id": "worker-1", "state": state}]}
    with database.transaction() as connection:
        processes.heartbeat(connection, processes.DISPATCHER, 1, now(), detail)


def elect(database: Database) -> None:
    with database.transaction() as connection:
        processes.elect(connection, processes.DISPATCHER, 1, now())


@pytest.mark.parametrize("jump", [timedelta(hours=-2), timedelta(hours=2)])
def test_a_dispatcher_is_known_by_its_term_whatever_the_clock_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, jump: timedelta
) -> None:
    database = migrated(f"sqlite:///{tmp_path / 'drivecal.db'}")
    monkeypatch.setattr(serving, "_answers", lambda _: True)
    elect(database)
    report(database, "idle")
    startup = Startup(database, "http://127.0.0.1:1")
    assert startup.missing() == ["dispatcher"]
    monkeypatch.setattr(processes, "now", lambda: now() + jump)
    report(database, "idle")  # of the last one, which has not ended yet
    assert startup.missing() == ["dispatcher"]
    elect(database)
    report(database, "starting")
    assert startup.missing() == ["workers"]
    report(database, "idle")
    assert startup.missing() == []
    database.dispose()
