import logging
import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.values import present

from drivecal.configuration.settings import load_settings
from drivecal.configuration.tokens import LARGEST_FILE, TokenFile, check_exposure, parse
from drivecal.domain.errors import InvalidInputError

ANNA, PLANT = b"anna-0123456789abcdef", b"plant-0123456789abcdef"
GOOD = b"# who may\n\nanna write " + ANNA + b"\r\n  plant2\tread\t" + PLANT + b"\n# \xc3\xa4 comment\n"


def file(folder: Path, content: bytes) -> Path:
    path = folder / "tokens"
    path.write_bytes(content)
    return path


def test_names_rights_and_tokens_are_read(tmp_path: Path) -> None:
    tokens = TokenFile(file(tmp_path, b"\xef\xbb\xbf" + GOOD))
    assert [(token.name, token.may_write) for token in tokens.tokens] == [("anna", True), ("plant2", False)]
    assert tokens.find(ANNA) == tokens.tokens[0]
    assert tokens.find(PLANT) == tokens.tokens[1]


def test_an_author_may_write_and_push_and_no_other_may_push() -> None:
    tokens, _ = parse(GOOD + b"bea author bea-0123456789abcdef\n", "tokens")
    assert [(token.may_write, token.may_push) for token in tokens] == [(True, False), (False, False), (True, True)]


@given(st.binary(max_size=40))
def test_nothing_else_is_a_token(presented: bytes) -> None:
    tokens, _ = parse(GOOD, "tokens")
    result = TokenFile.__new__(TokenFile)
    result.tokens, result._path, result._version = tuple(tokens), Path("/nowhere"), None
    assert (result.find(presented) is None) == (presented not in {ANNA, PLANT})


SECRET = "s3cret-s3cret-s3cret"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", "it holds no token"),
        ("# only a comment\n", "it holds no token"),
        (f"anna {SECRET}\n", "line 1: there are 2 words; write one token per line: NAME read|write|author|admin TOKEN"),
        (f"anna write {SECRET} extra\n", "line 1: there are 4 words"),
        (f"anna {SECRET} write\n", "line 1: the second word is not read, write, author or admin"),
        (f"anna root {SECRET}\n", "line 1: the second word is not"),
        ("\n\nanna write short-s3cret\n", "line 3: the token has 12 characters; give 16 to 512"),
        (f"anna write {SECRET * 30}\n", "line 1: the token has 600 characters"),
        (f"anna write {SECRET}é\n", "line 1: the token holds characters that are not ASCII"),
        (f"anna write {SECRET}\x01\n", "line 1: the token holds characters that are not ASCII, or not printable"),
        (f"änna write {SECRET}\n", "line 1: invalid name; give up to 64 letters"),
        (f"{SECRET * 4} write anna\n", "line 1: invalid name"),
        (f"a write {SECRET}\nb read {SECRET}\n", "line 2: the token is that of line 1; give each token once"),
        (f"a write {SECRET}1\na read {SECRET}2\n", "line 2: the name is that of line 1; give each name once"),
    ],
)
def test_a_mistake_is_told_by_file_and_line_and_never_by_the_token(tmp_path: Path, content: str, said: str) -> None:
    path = file(tmp_path, content.encode())
    with pytest.raises(InvalidInputError) as caught:
        TokenFile(path)
    assert str(caught.value).startswith(str(path))
    assert said in str(caught.value)
    assert "s3cret" not in repr(caught.value)


def test_every_mistake_is_told_at_once() -> None:
    _, problems = parse(b"a\nb write short\nc write 0123456789abcdef\n", "tokens")
    assert [problem.field for problem in problems] == ["tokens, line 1", "tokens, line 2"]


def test_what_is_no_readable_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match=r"No such file.*DRIVECAL_TOKENS_FILE"):
        TokenFile(tmp_path / "nothing")
    with pytest.raises(InvalidInputError, match="Is a directory"):
        TokenFile(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InvalidInputError, match="pipe"):
        TokenFile(tmp_path / "pipe")
    with pytest.raises(InvalidInputError, match="tokens"):
        TokenFile(file(tmp_path, b"#" * (LARGEST_FILE + 1)))


def test_no_token_shows_in_what_is_kept(tmp_path: Path) -> None:
    tokens = TokenFile(file(tmp_path, GOOD))
    assert ANNA.decode() not in repr(tokens.tokens) + repr(vars(tokens))


@pytest.mark.parametrize("broken", [b"", b"# nothing\n", GOOD + b"third read x\n", None])
def test_a_wrong_version_changes_no_tokens(tmp_path: Path, broken: bytes | None, caplog: pytest.LogCaptureFixture) -> None:
    path = file(tmp_path, GOOD)
    tokens = TokenFile(path)
    if broken is None:
        path.unlink()
    else:
        path.write_bytes(broken)
    with caplog.at_level(logging.INFO, "drivecal.tokens"):
        for _ in range(3):
            assert tokens.find(PLANT) is not None
    assert len(caplog.messages) == 1
    assert str(path) in caplog.messages[0]
    assert tokens.fault == caplog.messages[0]
    assert ANNA.decode() not in caplog.text
    path.write_bytes(GOOD + b"third write 0123456789abcdef")
    assert tokens.find(b"0123456789abcdef") is not None
    assert tokens.fault is None


def test_a_single_new_token_revokes_all_others_without_a_restart(tmp_path: Path) -> None:
    path = file(tmp_path, GOOD)
    tokens = TokenFile(path)
    path.with_name("new").write_bytes(b"anna write another-0123456789abcdef\n")
    path.with_name("new").rename(path)
    assert [tokens.find(secret) for secret in (ANNA, PLANT)] == [None, None]
    assert tokens.named("plant2") is None
    assert present(tokens.find(b"another-0123456789abcdef")).name == "anna"
    assert tokens.fault is None


@pytest.mark.parametrize("line", [b"", b"anna write x\n", b"anna write " + ANNA + b" leaked\n"])
def test_a_faulty_version_revokes_what_no_good_line_holds_and_adds_nothing(tmp_path: Path, line: bytes) -> None:
    path = file(tmp_path, GOOD)
    tokens = TokenFile(path)
    path.write_bytes(b"plant2 read " + PLANT + b"\nthird write 0123456789abcdef\nbroken\n" + line)
    assert tokens.find(ANNA) is None
    assert tokens.find(b"0123456789abcdef") is None
    assert tokens.find(PLANT) is not None
    assert tokens.named("anna") is None
    assert tokens.fault is not None


@pytest.mark.parametrize("address", ["0.0.0.0", "::", "192.0.2.1", "fe80::1%eth0", "::ffff:192.0.2.1"])
def test_other_machines_are_let_in_with_tokens_only(address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DRIVECAL_TOKENS_FILE", raising=False)
    with pytest.raises(InvalidInputError, match=r"--tokens-file.*DRIVECAL_TOKENS_FILE.*127\.0\.0\.1"):
        check_exposure(address, load_settings())
    check_exposure(address, load_settings(tokens_file="tokens"))


@pytest.mark.parametrize("address", ["127.0.0.1", "127.0.1.1", "::1"])
def test_this_machine_is_let_in_without(address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DRIVECAL_TOKENS_FILE", raising=False)
    check_exposure(address, load_settings())
