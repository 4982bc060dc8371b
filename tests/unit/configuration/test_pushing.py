"""The secret that identifies the user of a server without tokens."""

import stat
from pathlib import Path

import pytest
from tests.support.values import faults_of

from drivecal.configuration.pushing import FILE, Pushing, create_secret, read_secret, sign, signed_digest
from drivecal.configuration.settings import load_settings


def test_a_secret_is_made_once_and_only_its_user_can_read_it(tmp_path: Path) -> None:
    home = tmp_path / "new" / "home"
    assert read_secret(home) is None
    secret = create_secret(home)
    assert stat.S_IMODE((home / FILE).stat().st_mode) == 0o600
    assert len(secret) >= 32
    assert create_secret(home) == read_secret(home) == secret
    assert create_secret(tmp_path) != secret


@pytest.mark.parametrize("mode", [0o644, 0o640, 0o602, 0o777])
def test_a_secret_that_others_could_read_or_write_is_replaced(tmp_path: Path, mode: int) -> None:
    known = create_secret(tmp_path)
    (tmp_path / FILE).chmod(mode)
    assert read_secret(tmp_path) is None
    assert create_secret(tmp_path) != known
    assert stat.S_IMODE((tmp_path / FILE).stat().st_mode) == 0o600


def test_a_link_or_a_short_file_is_no_secret(tmp_path: Path) -> None:
    known = tmp_path / "known"
    known.write_bytes(b"k" * 43)
    known.chmod(0o600)
    (tmp_path / FILE).symlink_to(known)
    assert read_secret(tmp_path) is None
    assert create_secret(tmp_path) != b"k" * 43
    assert known.read_bytes() == b"k" * 43
    (tmp_path / FILE).write_bytes(b"short")
    assert len(create_secret(tmp_path)) >= 32


def test_where_no_secret_can_be_written_the_place_is_named(tmp_path: Path) -> None:
    (tmp_path / FILE).mkdir()
    assert [problem.field for problem in faults_of(create_secret, tmp_path)] == [str(tmp_path / FILE)]


def test_a_signature_is_of_one_content_and_one_secret() -> None:
    header = sign(b"s" * 43, b"content")
    digest = signed_digest(b"s" * 43, header)
    assert header.startswith(f"{digest}:")
    assert signed_digest(b"t" * 43, header) is None
    other = sign(b"s" * 43, b"other")
    for wrong in ("", header + "0", header.upper(), other[:64] + header[64:], "é"):
        assert signed_digest(b"s" * 43, wrong) is None


@pytest.mark.parametrize(
    ("address", "allow", "tokens", "allowed", "secret"),
    [
        ("127.0.0.1", None, False, True, True),
        ("127.0.0.1", None, True, True, False),
        ("127.0.0.1", False, False, False, False),
        ("0.0.0.0", None, True, False, False),
        ("0.0.0.0", True, True, True, False),
        ("::1", None, False, True, True),
    ],
)
def test_pushing_is_on_by_default_on_loopback_only(
    tmp_path: Path, address: str, allow: bool | None, tokens: bool, allowed: bool, secret: bool
) -> None:
    settings = load_settings(home=tmp_path, allow_push=allow, tokens_file=tmp_path / "tokens" if tokens else None)
    pushing = Pushing.of(settings, address)
    assert (pushing.allowed, pushing.secret is not None, (tmp_path / FILE).exists()) == (allowed, secret, secret)
