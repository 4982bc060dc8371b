"""The API while its database does not answer, on a real PostgreSQL that is stopped, killed and started, and on a locked SQLite."""

import logging
import sqlite3
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import httpx
import pytest
from sqlalchemy import update
from tests.support.faults.postgres import KillablePostgres, killable_postgres
from tests.support.serve import until
from tests.support.server import RunningApi, problem_of, serving

from drivecal.configuration.settings import Settings
from drivecal.server import serving as serving_module
from drivecal.storage import processes
from drivecal.storage.engine.tables import processes as process_table
from drivecal.storage.engine.types import now

PROMISED_SECONDS = 5.0
SPARE_SECONDS = 60.0
"""For a busy machine."""
SMALL = {"sensitivity": None, "optimizer": {"population": 10, "iterations": 3}}
READING = ["/api/v1/campaigns", "/api/v1/campaigns/" + "0" * 32, "/api/v1/workers", "/api/v1/references"]


@pytest.fixture(scope="module")
def postgres() -> Iterator[KillablePostgres]:
    with killable_postgres() as server:
        yield server


@pytest.fixture
def api(postgres: KillablePostgres) -> Iterator[RunningApi]:
    with serving(postgres.new_database()) as running:
        working(running)
        yield running


def working(api: RunningApi) -> None:
    """A dispatcher with a worker has spoken just now."""
    with api.database.transaction() as connection:
        processes.heartbeat(connection, processes.DISPATCHER, 1, now(), {"workers": [{"id": "worker-1", "state": "idle"}]})


def ask(api: RunningApi, path: str) -> httpx.Response:
    """Raises where the answer does not come in time."""
    return api.http.get(path, timeout=PROMISED_SECONDS + SPARE_SECONDS)


def refuses(response: httpx.Response) -> bool:
    return "database" in problem_of(response, 503)["detail"] and int(response.headers["retry-after"]) > 0


def recovers(api: RunningApi) -> None:
    until(lambda: ask(api, "/api/v1/campaigns").status_code == 200, "the recovery of the API", 30)
    working(api)
    assert ask(api, "/readyz").json() == {"ready": True, "problems": []}
    assert api.http.post("/api/v1/campaigns", json=SMALL, timeout=300).status_code == 202
    assert "drivecal_database_up 1.0" in ask(api, "/metrics").text


def says_so_everywhere(api: RunningApi) -> None:
    """Whatever is asked, at the same time and one after the other: no answer is late, and none pretends that all is well."""
    answers: list[httpx.Response | Exception] = []

    def one(path: str) -> None:
        try:
            answers.append(ask(api, path))
        except httpx.HTTPError as error:
            answers.append(error)

    threads = [threading.Thread(target=one, args=(path,)) for path in READING * 10]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    late = [answer for answer in answers if isinstance(answer, Exception)]
    assert not late, f"{len(late)} of {len(answers)} answers were late"
    assert all(refuses(answer) for answer in answers if isinstance(answer, httpx.Response))
    posted = api.http.post("/api/v1/campaigns", json=SMALL, timeout=PROMISED_SECONDS + SPARE_SECONDS)
    assert refuses(posted)
    ready = ask(api, "/readyz")
    assert (ready.status_code, ready.json()["ready"]) == (503, False)
    assert ready.json()["problems"][0]
    figures = ask(api, "/metrics")
    assert (figures.status_code, "drivecal_database_up 0.0" in figures.text, "drivecal_ready 0.0" in figures.text) == (
        200,
        True,
        True,
    )
    assert "drivecal_cells_total" not in figures.text
    assert ask(api, "/healthz").json() == {"status": "alive"}


@pytest.mark.slow
def test_a_silent_database_is_noticed(api: RunningApi, postgres: KillablePostgres, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, "drivecal"):
        with postgres.frozen():
            says_so_everywhere(api)
        recovers(api)
    told = [record.levelname for record in caplog.records if record.name == "drivecal.storage.engine.failures"]
    assert told == ["WARNING", "INFO"]


@pytest.mark.slow
def test_a_server_with_a_silent_database_hears_signals(postgres: KillablePostgres, monkeypatch: pytest.MonkeyPatch) -> None:
    """A question that waits for the database keeps the supervisor from its signals."""
    asked: list[Sequence[str]] = []

    def run(missing: Callable[[], Sequence[str]]) -> int:
        with postgres.frozen():
            thread = threading.Thread(target=lambda: asked.append(missing()))
            thread.start()
            thread.join(10 * PROMISED_SECONDS)
            return len(asked)

    monkeypatch.setattr(serving_module, "Supervisor", lambda _, missing, __: SimpleNamespace(run=lambda: run(missing)))
    settings = Settings(database_url=postgres.new_database())
    serving_module.prepare_database(settings).dispose()
    with serving_module.listen("127.0.0.1", 0) as listener:
        assert serving_module.run_server(settings, listener, serving_module.url_of(listener, "127.0.0.1"), lambda: None) == 1
    [lacking] = asked
    assert any("database" in reason for reason in lacking)


@pytest.mark.slow
def test_a_lock_that_somebody_keeps_is_not_waited_for_longer_than_promised(postgres: KillablePostgres) -> None:
    with serving(postgres.new_database()) as api, api.database.transaction() as connection:
        connection.exec_driver_sql("LOCK TABLE setups IN ACCESS EXCLUSIVE MODE")
        answer = ask(api, "/api/v1/references")
        assert refuses(answer)


@pytest.mark.slow
def test_sqlite_locked_by_a_long_writer_is_read_and_said_to_be_locked(tmp_path: Path) -> None:
    file = tmp_path / "drivecal.db"
    with serving(f"sqlite:///{file}") as api:
        working(api)
        with closing(sqlite3.connect(file, isolation_level=None)) as other:
            other.execute("BEGIN IMMEDIATE")
            assert ask(api, "/api/v1/campaigns").status_code == 200
            refused = api.http.post("/api/v1/campaigns", json=SMALL, timeout=PROMISED_SECONDS + SPARE_SECONDS)
            assert refuses(refused)
            other.execute("ROLLBACK")
            with api.database.transaction() as connection:
                connection.execute(update(process_table).values(heartbeat_at=now().replace(year=2020)))
            other.execute("BEGIN IMMEDIATE")
            ready = ask(api, "/readyz")
            assert ready.status_code == 503
            assert len(ready.json()["problems"]) == 2, "the lock and the silent dispatcher"
            assert "drivecal_ready 0.0" in ask(api, "/metrics").text
            other.execute("ROLLBACK")
        recovers(api)
