"""Tests of what a web page, another user, a cloned repository and a crowd of connections try against a server as a user starts it."""

import csv
import json
import os
import re
import socket
import sqlite3
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import psutil
import pytest
from tests.support.serve import Server, environment, serving

from drivecal.client import Client

pytestmark = pytest.mark.slow

NAMES = {"formula": '=HYPERLINK("http://elsewhere","x")', "script": "<script>alert(1)</script><img src=x onerror=alert(1)>"}
SPEC = {"sensitivity": None, "optimizer": {"population": 10, "iterations": 1}, "catalogue": ["S1"]}
CROWD = 300


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server of a user whose files everybody may write by default."""
    folder = tmp_path_factory.mktemp("assault")
    (folder / "temporary").mkdir()
    with ExitStack() as stack:
        before = os.umask(0)
        try:
            started = stack.enter_context(serving(folder, DRIVECAL_BACKEND="processes", TMPDIR=str(folder / "temporary")))
        finally:
            os.umask(before)
        yield started


def test_an_image_of_a_foreign_page_starts_nothing(server: Server) -> None:
    """Images and frames carry no Origin, and a trace is simulated at the first GET."""

    def asked(path: str, **headers: str) -> int:
        return httpx.get(f"{server.url}{path}", headers=headers, timeout=60).status_code

    foreign = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"}
    with Client(server.url) as client:
        evaluation = client.evaluate({"parameters": {f"P{number}": 0.5 for number in range(1, 12)}, "scenario": "S1"}).id
        while client.evaluation(evaluation).state not in {"succeeded", "failed"}:
            time.sleep(0.1)
    for site in ("cross-site", "same-site"):
        assert asked(f"/api/v1/evaluations/{evaluation}/trace", **foreign | {"Sec-Fetch-Site": site}) == 403
    frame = foreign | {"Sec-Fetch-User": "?1", "Sec-Fetch-Dest": "iframe"}
    assert asked(f"/api/v1/evaluations/{evaluation}/trace", **frame) == 403
    [file] = server.folder.rglob("drivecal.db")
    with closing(sqlite3.connect(file)) as stored:
        assert stored.execute("SELECT count(*) FROM traces").fetchone() == (0,)
    assert asked(f"/api/v1/evaluations/{evaluation}/trace") == 202
    for own in ({"Sec-Fetch-Site": "same-origin"}, {"Sec-Fetch-Site": "none"}, foreign | {"Sec-Fetch-User": "?1"}, {}):
        assert asked("/api/v1/campaigns", **own) == 200
    assert asked("/help/", **foreign) == asked("/help/")


@pytest.mark.parametrize("name", NAMES)
def test_a_name_is_a_name_in_files_and_on_terminals(server: Server, tmp_path: Path, name: str) -> None:
    with Client(server.url) as client:
        posted = httpx.post(f"{server.url}/api/v1/campaigns", json=SPEC | {"name": NAMES[name]}, timeout=60)
        assert posted.status_code == 202
        campaign = client.wait(posted.json()["id"])
        assert (campaign.state, campaign.name) == ("succeeded", NAMES[name])
        written = subprocess.run(
            [sys.executable, "-m", "drivecal.cli", "report", campaign.id, "-o", str(tmp_path), "--url", server.url],
            env=environment(tmp_path),
            capture_output=True,
            text=True,
            check=False,
            timeout=1800,
        )
    assert written.returncode == 0, written.stderr
    page = (tmp_path / "index.html").read_text()
    [answers] = re.findall(r'<script type="application/json" id="answers">(.*)</script>', page)
    assert json.loads(json.loads(answers)[f"/campaigns/{campaign.id}"])["name"] == NAMES[name]
    assert "<script>alert" not in page
    tables = list(tmp_path.rglob("*.csv"))
    assert tables
    for table in tables:
        with table.open(newline="") as file:
            assert not [cell for row in csv.reader(file) for cell in row if cell.startswith("=")], table.name


def test_other_users_may_write_to_no_file_and_read_no_secret(server: Server) -> None:
    home = server.folder / "home"
    for path in (home, *home.rglob("*"), *(server.folder / "temporary").glob("drivecal-*")):
        with suppress(FileNotFoundError):  # removed meanwhile
            mode = stat.S_IMODE(path.stat().st_mode)
            assert not mode & (stat.S_IWOTH | stat.S_IWGRP), (path, oct(mode))
    assert stat.S_IMODE(home.stat().st_mode) == 0o700
    assert {path.name for path in home.iterdir() if stat.S_IMODE(path.stat().st_mode) & 0o077 and path.is_file()} == set()


def test_nothing_listens_on_another_address_than_loopback(server: Server) -> None:
    for process in (server.process.pid, *(child.pid for child in server.family())):
        with suppress(psutil.NoSuchProcess):  # ended meanwhile
            for connection in psutil.Process(process).net_connections("inet"):
                assert connection.laddr.ip in {"127.0.0.1", "::1"}, connection


def test_hundreds_of_half_open_connections_leave_the_server_to_others(server: Server) -> None:
    """Some send half a head, the others nothing."""
    address = urlsplit(server.url)
    starts = [b"", *(f"{method} /api/v1/campaigns HTTP/1.1\r\nHost: localhost\r\nAccep".encode() for method in ("POST", "GET"))]
    crowd = []
    try:
        for number in range(CROWD):
            connection = socket.create_connection((str(address.hostname), int(address.port or 80)), timeout=10)
            connection.sendall(starts[number % len(starts)])
            crowd.append(connection)
        assert server.alive()
        with Client(server.url) as client:
            assert client.campaigns(limit=1) is not None
    finally:
        for connection in crowd:
            connection.close()


def test_a_cloned_repository_sends_no_token_anywhere(tmp_path: Path) -> None:
    """The address of its file gets no connection at all."""
    with socket.create_server(("127.0.0.1", 0)) as elsewhere:
        elsewhere.settimeout(0.2)
        port = elsewhere.getsockname()[1]
        (tmp_path / "drivecal.toml").write_text(f"url = 'http://127.0.0.1:{port}'\n")
        given = environment(tmp_path) | {"DRIVECAL_TOKEN": "a-token-of-the-user-0123456789"}
        command = [sys.executable, "-m", "drivecal.cli", "list"]
        ended = subprocess.run(command, cwd=tmp_path, env=given, capture_output=True, text=True, check=False, timeout=1800)
        assert ended.returncode == 2
        assert "DRIVECAL_URL" in ended.stderr
        with pytest.raises(TimeoutError):
            elsewhere.accept()
