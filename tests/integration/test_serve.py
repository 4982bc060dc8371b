from __future__ import annotations

import signal
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from tests.support.serve import Server, environment, gone, serving, until
from typer.testing import CliRunner

from drivecal.cli.main import app


def refused(folder: Path, *arguments: str, **settings: str) -> tuple[int, str]:
    """Exit code and words of a `serve` that is expected not to start."""
    done = CliRunner().invoke(app, ["serve", *arguments], env=environment(folder) | settings)
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    return done.exit_code, done.stderr


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    with serving(tmp_path) as started:
        yield started


def test_serve_starts_and_stops_cleanly_and_keeps_others_off_its_database(server: Server, tmp_path: Path) -> None:
    assert server.alive()
    assert httpx.get(f"{server.url}/readyz", timeout=5.0).status_code == 200
    family = server.family()
    assert {"raylet", "gcs_server"} <= {one.name() for one in family}
    code, words = refused(tmp_path, "--port", "0")
    assert code == 1
    assert "another drivecal server" in words
    assert "DRIVECAL_DATABASE_URL" in words
    begin = time.monotonic()
    server.process.send_signal(signal.SIGTERM)
    assert server.process.wait(timeout=20) == 0
    assert time.monotonic() - begin < 10.0
    until(lambda: gone(family), "the end of every process", 2.0)


def test_what_is_killed_comes_back_and_a_killed_server_leaves_nothing(server: Server) -> None:
    api = server.child("drivecal.api")
    api.kill()
    until(lambda: server.alive() and server.child("drivecal.api").pid != api.pid, "a new API")
    dispatcher = server.child("drivecal.dispatch")
    assert server.dispatcher_pid() == dispatcher.pid
    before = [dispatcher, *dispatcher.children(recursive=True)]
    dispatcher.kill()
    until(lambda: gone(before), "the end of the old dispatcher's Ray", 5.0)
    until(lambda: server.dispatcher_pid() != dispatcher.pid, "a new dispatcher")
    assert "the dispatcher ended unexpectedly" in server.log.read_text()
    dispatcher = server.child("drivecal.dispatch")
    next(one for one in dispatcher.children() if one.name() == "gcs_server").kill()
    until(lambda: server.dispatcher_pid() != dispatcher.pid, "a new dispatcher with a new Ray")
    assert "Ray's gcs_server ended unexpectedly" in server.log.read_text()
    family = server.family()
    server.process.kill()
    until(lambda: gone(family), "the end of every process", 5.0)


def test_a_port_in_use_is_refused(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        code, words = refused(tmp_path, "--port", str(port))
    assert code == 1
    assert f"port {port} of 127.0.0.1 is in use; choose another one by --port" in words
    assert not (tmp_path / "home").exists()


def test_what_cannot_work_is_refused_with_a_remedy(tmp_path: Path) -> None:
    file = tmp_path / "notes.txt"
    file.write_text("This is no database. " * 100)
    code, words = refused(tmp_path, "--port", "0", DRIVECAL_DATABASE_URL=f"sqlite:///{file}")
    assert (code, "no SQLite database" in words) == (1, True)
    code, words = refused(tmp_path, "--host", "no such host", "--port", "0")
    assert (code, "--host: 'no such host' is no address" in words) == (2, True)
    code, words = refused(tmp_path, "--host", "203.0.113.7", "--port", "0")
    assert (code, "--host: '203.0.113.7' is no address of this machine" in words) == (2, True)
    code, words = refused(tmp_path, "--port", "70000")
    assert (code, "--port" in words) == (2, True)
    code, words = refused(tmp_path, "--port", "0", "--home", str(file / "below"))
    assert (code, "home: " in words and "DRIVECAL_HOME" in words) == (2, True)
