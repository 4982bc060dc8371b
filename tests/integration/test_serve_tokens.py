"""`drivecal serve` with tokens and without: who can use it is said at the start, and no token shows up anywhere."""

from __future__ import annotations

from pathlib import Path

import httpx
import pytest
from tests.support.logs import log_left_as_it_was
from tests.support.serve import environment, gone, serving, until
from typer.testing import CliRunner

from drivecal.cli.main import app

TOKEN, READER, MINE = "writer-0123456789abcdef", "reader-0123456789abcdef", "somebody-elses-0123456789"


def refused(folder: Path, *arguments: str, **settings: str) -> tuple[int, str]:
    """Exit code and words of a `serve` that is expected not to start."""
    with log_left_as_it_was():
        done = CliRunner().invoke(app, ["serve", *arguments], env=environment(folder) | settings)
    return done.exit_code, done.stderr


@pytest.mark.parametrize("host", ["0.0.0.0", "::"])
def test_without_tokens_nobody_else_is_let_in(tmp_path: Path, host: str) -> None:
    code, words = refused(tmp_path, "--host", host, "--port", "0")
    assert code == 2
    assert host in words
    assert "--tokens-file" in words
    assert "DRIVECAL_TOKENS_FILE" in words
    assert "127.0.0.1" in words
    assert not (tmp_path / "home").exists()


def test_the_api_alone_lets_nobody_else_in_either(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    from drivecal.api import __main__ as alone

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("drivecal.configuration.logs.configure", lambda *_: None)
    monkeypatch.setattr("sys.argv", ["api", "--host", "0.0.0.0", "--port", "0"])
    assert alone.main() == 1
    assert "0.0.0.0" in caplog.text


@pytest.mark.parametrize(
    ("content", "said"), [(None, "cannot be read: No such file"), ("me write short", "line 1: the token has 5 characters")]
)
def test_a_tokens_file_that_cannot_be_used_is_told_at_the_start(tmp_path: Path, content: str | None, said: str) -> None:
    if content is not None:
        (tmp_path / "tokens").write_text(content)
    code, words = refused(tmp_path, "--port", "0", "--tokens-file", str(tmp_path / "tokens"))
    assert (code, said in words) == (2, True)


@pytest.mark.slow
def test_a_server_with_tokens_gets_ready_and_keeps_them_to_itself(tmp_path: Path) -> None:
    (tmp_path / "tokens").write_text(f"writer write {TOKEN}\nreader read {READER}\n")
    with serving(tmp_path, DRIVECAL_TOKENS_FILE="tokens", DRIVECAL_TOKEN=MINE, DRIVECAL_LOG_LEVEL="debug") as server:
        bearer = {"Authorization": f"Bearer {TOKEN}"}
        with httpx.Client(base_url=server.url) as http:
            assert http.get("/api/v1/campaigns").status_code == 401
            assert http.get("/readyz").json() == {"ready": True, "problems": []}
            assert http.get("/api/v1/campaigns", headers={"Authorization": f"Bearer {READER}x"}).status_code == 401
            posted = http.post("/api/v1/campaigns", json={"optimizer": {"kind": TOKEN}}, headers=bearer)
            assert posted.status_code == 422
            family = server.family()
            for process in family:
                known = [*process.environ().values(), *process.cmdline()]
                assert not [one for one in known for token in (TOKEN, READER, MINE) if token in one], process
        until(lambda: "token=writer" in server.log.read_text(), "the line of the last request, which follows its answer", 10.0)
        log = server.log.read_text()
        assert "a token is asked for: 2 in" in log
        assert "1 of them may only read" in log
        assert not [token for token in (TOKEN, READER, MINE) if token in log]
    until(lambda: gone(family), "the end of every process", 5.0)
