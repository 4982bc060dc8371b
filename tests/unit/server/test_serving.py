"""When a server that was just started is ready."""

import socket
from datetime import timedelta
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from tests.support.databases import migrated
from tests.support.scripted import server

from drivecal.configuration.settings import load_settings
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
def test_a_dispatcher_is_known_by_its_term(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, jump: timedelta) -> None:
    database = migrated(f"sqlite:///{tmp_path / 'drivecal.db'}")
    elect(database)
    report(database, "idle")
    with server(*4 * [(200, {}, b"")]) as (api, _):
        startup = Startup(database, api.url)
        assert startup.missing() == ["dispatcher"]
        monkeypatch.setattr(processes, "now", lambda: now() + jump)
        report(database, "idle")  # of the last one, which has not ended yet
        assert startup.missing() == ["dispatcher"]
        elect(database)
        report(database, "starting")
        assert startup.missing() == ["workers"]
        report(database, "idle")
        assert startup.missing() == []


def test_the_dispatcher_alone_is_told_where_to_post(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    webhook = "https://chat.example/hook?secret=hunter2"
    told: dict[str, str | None] = {}
    supervisor = Mock(return_value=Mock(run=lambda: 0))
    monkeypatch.setattr(serving, "Supervisor", supervisor)
    monkeypatch.setenv("DRIVECAL_WEBHOOK", webhook)
    migrated(f"sqlite:///{tmp_path / 'drivecal.db'}")
    with socket.socket() as listener:
        serving.run_server(load_settings(home=str(tmp_path)), listener, "http://127.0.0.1:1", lambda: None)
    for child in supervisor.call_args.args[0]:
        with pytest.MonkeyPatch.context() as patched:
            for name, value in child.environment.items():
                patched.setenv(name, value)
            told[child.name] = load_settings().webhook
    assert told == {"API": None, "dispatcher": webhook}
