"""The dispatcher's heartbeat, with the database that it is written to."""

import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from sqlalchemy import text
from tests.support.runs import get, submit
from tests.support.serve import until

from drivecal.dispatch.heartbeat import (
    COMPUTING_SHARE,
    HUNG_AFTER_SECONDS,
    LONGEST_TRAINING_SECONDS,
    STARTING,
    STARTING_SECONDS,
    STUCK_AFTER_SECONDS,
    Heartbeat,
    Leadership,
)
from drivecal.domain.errors import DatabaseError, SupersededError, UnavailableError
from drivecal.execution.backend import WorkerInfo
from drivecal.execution.measures import MEASURES
from drivecal.storage import campaigns, processes
from drivecal.storage.engine.database import Database
from drivecal.storage.processes import StoredProcess

WORKER = WorkerInfo(id="worker-1", node="here", pid=7, state="idle", cells=3)


def reported(database: Database) -> StoredProcess:
    with database.read() as connection:
        result = processes.read(connection, "dispatcher")
    assert result is not None
    return result


def heartbeat_of(database: Database, **options: Any) -> Heartbeat:
    leadership = Leadership.begin(database)
    return Heartbeat(database.fenced(leadership.fence), leadership, **options)


def test_it_says_how_the_workers_are_and_running_campaigns_what_is_wrong(database: Database) -> None:
    waiting, running = submit(database), submit(database)
    with database.transaction() as connection:
        campaigns.start(connection, running.sequence)
    heartbeat = heartbeat_of(database)
    heartbeat.report([WORKER], "waiting for Ray: it is being started")
    heartbeat.beat()
    result = reported(database)
    assert result.detail["workers"][0]["id"] == "worker-1"
    assert result.detail["degraded"] == "waiting for Ray: it is being started"
    assert result.detail["measures"] == MEASURES.snapshot()
    assert get(database, running).degraded == "waiting for Ray: it is being started"
    assert get(database, waiting).degraded is None
    heartbeat.report([WORKER], None)
    heartbeat.beat()
    assert get(database, running).degraded is None
    assert reported(database).detail["degraded"] is None


def test_a_start_is_no_trouble_of_running_campaigns_unless_it_takes_long(database: Database) -> None:
    running, now = submit(database), [0.0]
    with database.transaction() as connection:
        campaigns.start(connection, running.sequence)
    heartbeat = heartbeat_of(database, clock=lambda: now[0])
    for seconds, degraded in (0.0, None), (STARTING_SECONDS + 1, STARTING[1]):
        now[0] = seconds
        heartbeat.report((), STARTING[1])
        heartbeat.beat()
        assert reported(database).detail["degraded"] == STARTING[1]
        assert get(database, running).degraded == degraded


def test_it_beats_while_the_main_thread_is_busy_and_says_since_when(database: Database) -> None:
    now = [0.0]
    heartbeat = heartbeat_of(database, clock=lambda: now[0])
    heartbeat.report([WORKER], "one of 2 workers does not start")
    with heartbeat:
        first = reported(database).heartbeat_at
        now[0] += STUCK_AFTER_SECONDS + 1
        until(lambda: "stuck_since" in reported(database).detail, "the report of a stuck dispatcher", 30)
    result = reported(database)
    assert result.heartbeat_at > first
    assert result.detail["degraded"].startswith(
        "one of 2 workers does not start; the dispatcher has been busy with one step since "
    )
    heartbeat.report([WORKER], None)
    heartbeat.beat()
    assert "stuck_since" not in reported(database).detail
    assert reported(database).detail["degraded"] is None


@pytest.mark.slow
def test_a_main_thread_that_waits_for_a_computing_thread_does_not_hang(database: Database) -> None:
    now = [0.0]
    heartbeat = heartbeat_of(database, clock=lambda: now[0])

    def compute() -> None:
        began = time.thread_time()
        while time.thread_time() < began + 20.0 * COMPUTING_SHARE:
            pass

    assert not heartbeat._is_hung()
    with ThreadPoolExecutor(1) as pool:
        pool.submit(compute).result()
    hung = []
    for now[0] in (
        10.0,
        HUNG_AFTER_SECONDS + 5.0,
        HUNG_AFTER_SECONDS + 15.0,
        LONGEST_TRAINING_SECONDS,
        LONGEST_TRAINING_SECONDS + 1.0,
    ):
        if now[0] > LONGEST_TRAINING_SECONDS:
            with ThreadPoolExecutor(1) as pool:
                pool.submit(compute).result()
        hung.append(heartbeat._is_hung())
    assert hung == [False, False, True, True, True], "a thread that always computes hides nothing for ever"


def test_it_outlives_an_outage_of_the_database(
    database: Database, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    caplog.set_level("INFO")
    leadership = Leadership.begin(database)
    fenced = database.fenced(leadership.fence)
    transaction = fenced.transaction
    monkeypatch.setattr(fenced, "transaction", Mock(side_effect=UnavailableError("the database does not answer")))
    with Heartbeat(fenced, leadership) as heartbeat:
        until(lambda: "waiting for the database" in caplog.text, "the message about the outage", 30)
        heartbeat.report([WORKER], None)
        monkeypatch.setattr(fenced, "transaction", transaction)
        until(lambda: bool(reported(database).detail.get("workers")), "a heartbeat after the outage", 30)
    assert caplog.text.count("waiting for the database") == 1
    assert "the database answers again" in caplog.text


def test_a_new_dispatcher_takes_no_licence_as_free_however_long_the_last_one_was_not_heard_of(database: Database) -> None:
    assert Leadership.begin(database).free_in(12.0) == 0.0
    with database.transaction() as connection:
        connection.execute(text("UPDATE processes SET heartbeat_at = '2020-01-01 00:00:00'"))
    assert Leadership.begin(database).free_in(12.0) == 23.0


def _ends(heartbeat: Heartbeat, error: type[Exception], words: str) -> None:
    def reported() -> bool:
        heartbeat.report([WORKER], None)
        return False

    with pytest.raises(error, match=words):
        until(reported, words, 30)


def test_the_main_thread_learns_that_another_dispatcher_was_elected_or_has_the_lock(database: Database) -> None:
    with heartbeat_of(database) as heartbeat:
        Leadership.begin(database)
        _ends(heartbeat, SupersededError, "another dispatcher was elected")
    assert reported(database).detail == {}, "the new one's row is left alone"
    lost = DatabaseError("another drivecal server (process 1) uses the database")
    with heartbeat_of(database, renew_lock=Mock(side_effect=lost)) as heartbeat:
        _ends(heartbeat, DatabaseError, "another drivecal server")


STUCK = """
import sys, time
from drivecal.dispatch import heartbeat
from drivecal.dispatch.heartbeat import Leadership
from drivecal.storage.engine.database import Database
heartbeat.GRACE_SECONDS = 0.5
database = Database.open(sys.argv[1])
leadership = Leadership.begin(database)
with heartbeat.Heartbeat(database.fenced(leadership.fence), leadership):
    Leadership.begin(database)
    time.sleep(3600)
"""


@pytest.mark.slow
@pytest.mark.usefixtures("database")
def test_without_a_heartbeat_a_stuck_process_ends(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", STUCK, f"sqlite:///{tmp_path / 'drivecal.db'}"],
        capture_output=True,
        text=True,
        timeout=1800,
        check=False,
    )
    assert done.returncode == 1, done.stderr
    assert "another dispatcher was elected" in done.stderr
