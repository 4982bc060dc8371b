"""`drivecal serve` without tokens, and with a file of tokens that cannot be used."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.support.command import refused


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
