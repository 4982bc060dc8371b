"""`drivecal serve` as a user starts it: its log, its tokens, its end, and what it refuses."""

import json
import re
import signal
import socket
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import psutil
import psycopg
import pytest
from psycopg import sql
from sqlalchemy import make_url
from tests.support.command import refused
from tests.support.hostile import NEIGHBOUR, WORKING, WORKS, inside, push
from tests.support.serve import Server, gone, serving, until
from tests.support.values import MIDDLE

from drivecal.client import Client

TOKEN, READER, MINE = "writer-0123456789abcdef", "reader-0123456789abcdef", "somebody-elses-0123456789"


@pytest.fixture(scope="module")  # the last test ends it
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server with tokens that logs all it can."""
    folder = tmp_path_factory.mktemp("serve")
    (folder / "tokens").write_text(f"writer write {TOKEN}\nreader read {READER}\n")
    (folder / "libsumo.py").write_text("raise RuntimeError('a module of the working directory')")
    with serving(
        folder, DRIVECAL_TOKENS_FILE="tokens", DRIVECAL_TOKEN=MINE, DRIVECAL_LOG_FORMAT="json", DRIVECAL_LOG_LEVEL="debug"
    ) as started:
        yield started


def lines_of(server: Server) -> list[dict[str, Any]]:
    """The complete lines of the log."""
    return [json.loads(line) for line in server.log.read_text().splitlines(keepends=True) if line.endswith("\n")]


def is_counted(http: httpx.Client, measured: str) -> bool:
    """Returns whether the metrics have durations of this kind."""
    return re.search(rf"^drivecal_{measured}_seconds_count [1-9]", http.get("/metrics").text, re.MULTILINE) is not None


def test_every_line_of_the_log_is_a_document_and_says_what_it_is_about(server: Server) -> None:
    headers = {"X-Request-ID": "from-the-test", "Authorization": f"Bearer {TOKEN}"}
    with httpx.Client(base_url=server.url, headers=headers, timeout=300) as http:
        evaluation = http.post("/api/v1/evaluations", json={"parameters": MIDDLE, "scenario": "S1"})
        assert (evaluation.status_code, evaluation.headers["x-request-id"]) == (202, "from-the-test")
        number = evaluation.json()["id"]
        until(lambda: http.get(f"/api/v1/evaluations/{number}").json()["state"] == "succeeded", "the end of the evaluation")
        for measured in ("evaluation", "batch", "lease_transaction", "record_transaction", "lookup"):
            until(partial(is_counted, http, measured), f"the heartbeat with its {measured}")
        assert 'drivecal_cells_total{outcome="simulated",stage="evaluation"} 1.0' in http.get("/metrics").text
    lines = lines_of(server)
    assert all({"time", "level", "process", "message"} <= set(line) for line in lines)
    assert {line["process"] for line in lines} == {"server", "api", "dispatcher"}
    (posted,) = (line for line in lines if line.get("request") == "from-the-test" and line.get("method") == "POST")
    assert (posted["path"], posted["status"], posted["level"]) == ("/api/v1/evaluations", 202, "info")
    told = [line["message"] for line in lines if line.get("campaign") == number and line["process"] == "dispatcher"]
    assert (told[0], told[-1]) == ("the campaign starts", "the campaign succeeded")


def test_a_server_with_tokens_gets_ready_and_keeps_them_to_itself(server: Server) -> None:
    bearer = {"Authorization": f"Bearer {TOKEN}"}
    with httpx.Client(base_url=server.url, timeout=60) as http:
        assert http.get("/api/v1/campaigns").status_code == 401
        until(lambda: http.get("/readyz").json() == {"ready": True, "problems": []}, "that it is ready")
        assert http.get("/api/v1/campaigns", headers={"Authorization": f"Bearer {READER}x"}).status_code == 401
        posted = http.post("/api/v1/campaigns", json={"optimizer": {"kind": TOKEN}}, headers=bearer)
        assert posted.status_code == 422
    for process in server.family():
        with suppress(psutil.NoSuchProcess):  # ended meanwhile
            known = [*process.environ().values(), *process.cmdline()]
            assert not [text for text in known for token in (TOKEN, READER, MINE) if token in text], process
    last = ("writer", "/api/v1/campaigns", 422)
    until(
        lambda: last in [(line.get("token"), line.get("path"), line.get("status")) for line in lines_of(server)],
        "the line of the last request, which follows its answer",
        10.0,
    )
    log = server.log.read_text()
    assert "a token is asked for: 2 in" in log
    assert "1 of them may only read" in log
    assert not [token for token in (TOKEN, READER, MINE) if token in log]


def test_no_token_is_in_the_database(server: Server) -> None:
    bearer = {"Authorization": f"Bearer {TOKEN}", "Idempotency-Key": "key-of-the-test"}
    document = {"parameters": MIDDLE, "scenario": "S1"}
    posted = httpx.post(f"{server.url}/api/v1/evaluations", json=document, headers=bearer, timeout=600)
    assert posted.status_code == 202
    files = {path.name: path.read_bytes() for path in (server.folder / "home").glob("drivecal.db*")}
    assert any(posted.json()["id"].encode() in content for content in files.values())
    tokens = [token.encode() for token in (TOKEN, READER, MINE)]
    assert [name for name, content in files.items() for token in tokens if token in content] == []


def _environment(process: psutil.Process) -> str:
    with suppress(psutil.NoSuchProcess):
        return str(process.environ())
    return ""


@pytest.mark.slow
def test_the_databases_password_stays_in_the_server(tmp_path: Path, postgres_url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is not in simulators, logs, tables, lists of processes, and answers about health, metrics and workers."""
    url = make_url(postgres_url).set(password=MINE).render_as_string(hide_password=False)
    (tmp_path / "temporary").mkdir()
    monkeypatch.setenv("DRIVECAL_HOME", str(tmp_path / "home"))  # with the secret that allows to push
    places = {"DRIVECAL_DATABASE_URL": url, "TMPDIR": str(tmp_path / "temporary")}
    with (
        serving(tmp_path, 1, 0, DRIVECAL_BACKEND="processes", DRIVECAL_LOG_LEVEL="debug", **places) as server,
        Client(server.url) as client,
    ):
        push(client, tmp_path, WORKING, WORKS)
        assert client.wait(client.submit(NEIGHBOUR).id).state == "succeeded"
        simulators = inside(tmp_path / "temporary")
        assert simulators
        assert not [process for process in simulators if MINE in _environment(process)]
        assert not [process for process in psutil.process_iter(["cmdline"]) if MINE in str(process.info["cmdline"])]
        told = [httpx.get(server.url + path, timeout=60).text for path in ("/readyz", "/metrics", "/api/v1/workers")]
    assert MINE not in str(told)
    assert MINE not in server.log.read_text()
    with psycopg.connect(postgres_url) as connection:
        tables = connection.execute(
            "SELECT relname::text FROM pg_class WHERE relkind = 'r' AND relnamespace = 'public'::regnamespace"
        )
        for (table,) in tables.fetchall():
            result = sql.SQL("SELECT count(*) FROM {} t WHERE position({} IN t::text) > 0").format(
                sql.Identifier(table), sql.Literal(MINE)
            )
            assert connection.execute(result).fetchone() == (0,), table


def test_a_port_in_use_is_refused(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        code, words = refused(tmp_path, "--port", str(port))
    assert code == 1
    assert str(port) in words
    assert "--port" in words
    assert not (tmp_path / "home").exists()


def test_serve_keeps_others_off_its_database_and_stops_cleanly(server: Server) -> None:
    assert server.alive()
    assert httpx.get(f"{server.url}/readyz", timeout=60).status_code == 200
    family = server.family()
    names = set()
    for process in family:
        with suppress(psutil.NoSuchProcess):  # ended meanwhile
            names.add(process.name())
    assert {"raylet", "gcs_server"} <= names
    code, words = refused(server.folder, "--port", "0")
    assert code == 1
    assert "DRIVECAL_DATABASE_URL" in words
    server.process.send_signal(signal.SIGTERM)
    assert server.process.wait(timeout=1800) == 0
    until(lambda: gone(family), "the end of every process", 30.0)
