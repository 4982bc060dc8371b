"""A database that fails, at a commit as well: the API answers 503, and a retry with the same key makes one campaign."""

import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import psutil
import psycopg
import pytest
from fastapi.testclient import TestClient
from sqlalchemy import func, select, text
from tests.support.api_process import api_process
from tests.support.server import RunningApi, new_database, problem_of, serving

from drivecal.api.app import create_app
from drivecal.client.client import Client
from drivecal.configuration.settings import load_settings
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.tables import campaigns

SMALL: dict[str, Any] = {"sensitivity": None, "optimizer": {"population": 10, "iterations": 2}}
AT_COMMIT = """
CREATE FUNCTION fail() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN {fault}; RETURN NULL; END $$;
CREATE CONSTRAINT TRIGGER fail AFTER INSERT ON campaigns DEFERRABLE INITIALLY DEFERRED FOR EACH ROW EXECUTE FUNCTION fail();
"""


@pytest.fixture
def api(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[RunningApi]:
    with serving(new_database(request, "postgresql", tmp_path)) as running:
        yield running


def unavailable(response: httpx.Response) -> dict[str, Any]:
    assert int(response.headers["retry-after"]) > 0
    return problem_of(response, 503)


def post(http: httpx.Client, key: str) -> httpx.Response:
    return http.post("/api/v1/campaigns", json=SMALL, headers={"Idempotency-Key": key})


def count(database: Database) -> int:
    with database.read() as connection:
        return connection.scalar(select(func.count()).select_from(campaigns)) or 0


def run_sql(api: RunningApi, statements: str) -> None:
    url = api.database.url.render_as_string(hide_password=False)
    with psycopg.connect(url.replace("postgresql+psycopg", "postgresql"), autocommit=True) as connection:
        connection.execute(statements)


@pytest.mark.slow("'40001'", "'25006'", "'XX000'")
@pytest.mark.parametrize(
    "fault",
    [
        "PERFORM pg_terminate_backend(pg_backend_pid())",  # as a server that is killed or shut down
        "RAISE EXCEPTION 'x' USING ERRCODE = '53100'",  # the disk is full
        "RAISE EXCEPTION 'x' USING ERRCODE = '40001'",  # serialization
        "RAISE EXCEPTION 'x' USING ERRCODE = '25006'",  # read-only: a standby
        "RAISE EXCEPTION 'x' USING ERRCODE = 'XX000'",  # internal
        "RAISE EXCEPTION 'x' USING ERRCODE = '23514'",  # a check that is not ours
    ],
    ids=lambda fault: fault[-7:],
)
def test_a_failure_at_the_commit_is_unavailable_and_a_retry_makes_one_campaign(api: RunningApi, fault: str) -> None:
    run_sql(api, AT_COMMIT.format(fault=fault))
    key = uuid.uuid4().hex
    unavailable(post(api.http, key))
    assert count(api.database) == 0
    run_sql(api, "DROP TRIGGER fail ON campaigns")
    first, second = post(api.http, key), post(api.http, key)
    assert (first.status_code, first.json()["id"]) == (202, second.json()["id"])
    assert count(api.database) == 1


def test_a_commit_whose_answer_is_lost_is_found_by_the_retry(api: RunningApi) -> None:
    """As after a kill between the commit and its answer: the row is stored, but the client was told that this is unknown."""
    key = uuid.uuid4().hex
    stored = post(api.http, key).json()["id"]
    run_sql(
        api,
        "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = current_database() AND pid <> pg_backend_pid()",
    )
    with Client(api.url) as client:
        assert client.submit(SMALL, key=key).id == stored
    assert count(api.database) == 1


def test_the_api_of_an_empty_database_stays_and_says_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "empty.db").touch()
    app = create_app(load_settings(home=tmp_path, database_url=f"sqlite:///{tmp_path}/empty.db"))
    with TestClient(app, base_url="http://127.0.0.1") as client:
        answer = client.get("/readyz")
    assert answer.status_code == 503
    assert any("`drivecal db upgrade`" in problem for problem in answer.json()["problems"])


@pytest.mark.slow
def test_a_full_disk_under_sqlite_is_unavailable_until_there_is_room(tmp_path: Path) -> None:
    file = tmp_path / "drivecal.db"
    with api_process(f"sqlite:///{file}", tmp_path) as api:
        assert post(api.http, "first").status_code == 202
        process = psutil.Process(api.process.pid)
        before = process.rlimit(psutil.RLIMIT_FSIZE)
        process.rlimit(psutil.RLIMIT_FSIZE, (1, before[1]))
        unavailable(post(api.http, "second"))
        assert api.http.get("/healthz").status_code == 200
        process.rlimit(psutil.RLIMIT_FSIZE, before)
        stored = post(api.http, "second").json()["id"]
        assert post(api.http, "second").json()["id"] == stored
    database = Database.open(f"sqlite:///{file}")
    assert count(database) == 2
    with database.read() as connection:
        assert connection.scalar(text("PRAGMA integrity_check")) == "ok"


def test_a_database_that_is_gone_is_said_to_be_unavailable(tmp_path: Path) -> None:
    folder = tmp_path / "gone"
    folder.mkdir()
    with serving(f"sqlite:///{folder / 'drivecal.db'}") as api:
        api.database.dispose()
        for file in folder.iterdir():
            file.unlink()
        folder.rmdir()
        assert unavailable(api.http.get("/api/v1/campaigns"))
        assert api.http.get("/readyz").status_code == 503
        assert api.http.get("/healthz").status_code == 200
        folder.mkdir()
