"""`drivecal db`: what one who runs a server does with its database."""

import json
import os
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import text
from tests.support.computed import ComputedBackend
from tests.support.runs import dispatcher, get, run, submit
from typer.testing import CliRunner, Result

from drivecal.cli.__main__ import app
from drivecal.storage import campaigns
from drivecal.storage.engine import server_lock
from drivecal.storage.engine.database import Database

SEARCH: dict[str, Any] = {"kind": "genetic", "population": 8, "iterations": 2, "seed": 1}


def db(*arguments: str | Path) -> Result:
    """`drivecal db ...`."""
    return CliRunner().invoke(app, ["db", *map(str, arguments)])


@pytest.fixture
def url(database: Database) -> str:
    """The URL of a database with a finished and a running campaign."""
    run(database, submit(database, catalogue=["S1"], optimizer=SEARCH))
    running = submit(database, catalogue=["S1"], optimizer=SEARCH | {"seed": 2})
    working = dispatcher(database, ComputedBackend(1))
    while not get(database, running).cells.pending:
        working.step()
    return database.url.render_as_string(hide_password=False)


@pytest.mark.slow
def test_a_database_goes_through_a_file_to_another_backend_and_back(url: str, postgres_url: str, tmp_path: Path) -> None:
    there, back = tmp_path / "there.db", tmp_path / "back.db"
    with server_lock.hold(url):  # a server may run
        written = db("backup", there, "--database-url", url)
    assert written.exit_code == 0
    assert f"{there} holds" in written.stdout
    assert "2 campaigns" in written.stdout
    restored = db("restore", there, "--database-url", postgres_url)
    assert restored.exit_code == 0, restored.stderr  # which tells the progress of a slow copy
    assert restored.stdout.splitlines()[-1].endswith("is current and whole")
    again = db("backup", back, "--database-url", postgres_url, "--json")
    report = json.loads(again.stdout)
    assert report["rows"]["campaigns"] == 2
    assert report["bytes"] == back.stat().st_size
    home = f"sqlite:///{tmp_path / 'home.db'}"
    report = json.loads(db("restore", back, "--database-url", home, "--json").stdout)
    assert report["whole"]
    assert report["rows"]["campaigns"] == 2
    with Database.open(home).read() as connection, Database.open(url).read() as first:
        assert campaigns.page(connection) == campaigns.page(first)


def test_a_restored_database_is_one_that_nobody_serves_and_that_was_empty(url: str, tmp_path: Path) -> None:
    file, target = tmp_path / "backup.db", f"sqlite:///{tmp_path / 'target.db'}"
    assert db("backup", file, "--database-url", url).exit_code == 0
    with server_lock.hold(target):
        refused = db("restore", file, "--database-url", target)
    assert refused.exit_code == 1
    assert str(os.getpid()) in refused.stderr
    refused = db("restore", file, "--database-url", url)
    assert refused.exit_code == 1
    assert "rows" in refused.stderr
    assert len(refused.stderr.splitlines()) == 1


def test_what_is_broken_is_told_and_is_the_exit_status(database: Database, url: str) -> None:
    assert db("check", "--database-url", url).exit_code == 0
    whole = json.loads(db("check", "--database-url", url, "--json").stdout)
    assert whole["whole"]
    assert {"storage", "counters", "references"} <= {check["name"] for check in whole["checks"]}
    with database.transaction() as connection:
        connection.execute(text("DELETE FROM ratings WHERE run_id = 1"))
    broken = db("check", "--database-url", url)
    assert broken.exit_code == 1
    assert "drivecal: references: " in broken.stderr
    assert "restore a backup" in broken.stderr
    report = json.loads(db("check", "--database-url", url, "--json").stdout)
    assert not report["whole"]
    [found] = [check for check in report["checks"] if check["problems"]]
    assert found["name"] == "references"
