"""The cache of bundles on a node: whole, private, and what its digests say."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from unittest.mock import Mock

import pytest
from tests.support.changes import replace_in

from drivecal.adapters.environment import Scratch
from drivecal.bundles import archives
from drivecal.domain.errors import InvalidInputError, UnavailableError
from drivecal.runtime import cache as module
from drivecal.runtime.cache import KEPT_SECONDS, LEFT_SECONDS, BundleCache, cache_folder


@pytest.fixture
def archive(tmp_path: Path) -> bytes:
    folder = tmp_path / "problem"
    (folder / "data").mkdir(parents=True)
    (folder / "problem.yaml").write_text("problem: p\n")
    (folder / "data" / "table.csv").write_text("1,2\n")
    return archives.pack(folder)


@pytest.fixture
def digest(archive: bytes) -> str:
    return archives.content_digest(archive)


@pytest.fixture
def cache(tmp_path: Path, archive: bytes, digest: str) -> BundleCache:
    made = BundleCache(tmp_path / "cache")
    made.store(digest, archive)
    return made


def test_a_bundle_is_unpacked_whole_and_once(tmp_path: Path, cache: BundleCache, digest: str) -> None:
    cache.store(digest, b"not even looked at")
    assert cache.has(digest)
    assert [entry.name for entry in (tmp_path / "cache").iterdir()] == [digest]
    assert archives.folder_digest(cache.folder(digest)) == digest


def test_an_archive_with_another_digest_is_not_unpacked(tmp_path: Path, archive: bytes) -> None:
    empty = BundleCache(tmp_path / "other")
    with pytest.raises(InvalidInputError):
        empty.store("0" * 64, archive)
    assert list((tmp_path / "other").iterdir()) == []


def test_no_file_can_be_written_to(cache: BundleCache, digest: str) -> None:
    modes = [path.lstat().st_mode & 0o222 for path in (cache.folder(digest), *cache.folder(digest).rglob("*"))]
    assert modes == [0] * 4


def _write(path: Path) -> None:
    path.chmod(0o644)
    path.write_text("1,3\n")


def _write_in_secret(path: Path) -> None:
    status = path.stat()
    _write(path)
    path.chmod(status.st_mode)
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))


def _add(path: Path) -> None:
    path.parent.chmod(0o755)
    (path.parent / "cache.bin").write_text("remembered")


def _link(path: Path) -> None:
    path.parent.chmod(0o755)
    path.unlink()
    path.symlink_to("/etc/hostname")


def _link_a_folder(path: Path) -> None:
    path.parent.chmod(0o755)
    (path.parent / "more").symlink_to("/etc")


@pytest.mark.parametrize("change", [_write, _write_in_secret, _add, _link, _link_a_folder, lambda path: path.chmod(0o755)])
@pytest.mark.parametrize("known", [True, False])
def test_a_changed_bundle_is_removed(cache: BundleCache, digest: str, archive: bytes, change: object, known: bool) -> None:
    folder = cache.folder(digest) if known else next(iter(cache._folder.iterdir()))
    assert callable(change)
    change(folder / "data" / "table.csv")
    with pytest.raises(UnavailableError, match="changed"):
        cache.folder(digest)
    with pytest.raises(UnavailableError, match="not on this machine"):
        cache.folder(digest)
    cache.store(digest, archive)
    assert archives.folder_digest(cache.folder(digest)) == digest


def test_an_installed_problem_that_changes_is_refused(
    tmp_path: Path, cache: BundleCache, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "installed"
    (folder / "data").mkdir(parents=True)
    (folder / "data" / "table.csv").write_text("1\n")
    digest = archives.folder_digest(folder)
    problem = Mock(folder=folder)
    monkeypatch.setattr(module, "installed", lambda each: problem if each == digest else None)
    assert cache.folder(digest) == folder
    (folder / "data" / "table.csv").write_text("2\n")
    with pytest.raises(UnavailableError, match="restart"):
        cache.folder(digest)
    assert (folder / "data" / "table.csv").is_file()


def test_bytecode_is_no_change(cache: BundleCache, digest: str) -> None:
    folder = cache.folder(digest)
    folder.chmod(0o755)
    (folder / "__pycache__").mkdir()
    (folder / "__pycache__" / "model.pyc").write_bytes(b"x")
    assert cache.folder(digest) == folder


def test_an_unchanged_bundle_is_not_read_again(cache: BundleCache, digest: str, monkeypatch: pytest.MonkeyPatch) -> None:
    cache.folder(digest)
    monkeypatch.setattr(module, "folder_digest", None)
    assert cache.folder(digest).is_dir()


@pytest.mark.parametrize("mode", [0o777, 0o770, 0o702])
def test_a_cache_that_others_may_write_to_is_refused(cache: BundleCache, digest: str, archive: bytes, mode: int) -> None:
    cache._folder.chmod(mode)
    for act in (lambda: cache.folder(digest), lambda: cache.store("1" * 64, archive)):
        with pytest.raises(UnavailableError, match="chmod 700"):
            act()
    cache._folder.chmod(0o700)
    assert cache.folder(digest).is_dir()


def test_a_cache_of_another_user_is_refused(cache: BundleCache, digest: str, monkeypatch: pytest.MonkeyPatch) -> None:
    replace_in(monkeypatch, module, "os", geteuid=lambda: 4711)
    with pytest.raises(UnavailableError, match=module.CACHE):
        cache.folder(digest)


def test_a_link_in_place_of_a_cache_is_refused(tmp_path: Path, cache: BundleCache, digest: str) -> None:
    (tmp_path / "link").symlink_to(cache._folder)
    with pytest.raises(UnavailableError, match="link"):
        BundleCache(tmp_path / "link").folder(digest)


def no_home(path: Path) -> Path:
    if str(path).startswith("~"):
        raise RuntimeError("Could not determine home directory.")
    return path


def test_the_workers_of_a_user_without_a_home_share_a_temporary_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(module.CACHE, raising=False)
    monkeypatch.setattr(Path, "expanduser", no_home)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    first = cache_folder()
    assert (first.parent, first.stat().st_mode & 0o777) == (tmp_path, 0o700)
    assert cache_folder() == first
    first.chmod(0o777)
    assert cache_folder() != first
    confinement = Scratch(tmp_path).confinement()
    assert confinement is not None
    assert all(path.startswith("/") for path in confinement["hidden"])


def test_a_refusal_names_why_the_files_are_not_there(cache: BundleCache, archive: bytes) -> None:
    with pytest.raises(InvalidInputError) as refused:
        cache.store("1" * 64, archive)
    with pytest.raises(UnavailableError) as missing:
        cache.folder("1" * 64)
    assert str(refused.value) in str(missing.value)


def bundle_of(folder: Path, name: str) -> tuple[str, bytes]:
    made = folder / name
    made.mkdir()
    (made / "problem.yaml").write_text(f"problem: {name}\n")
    archive = archives.pack(made)
    return archives.content_digest(archive), archive


def test_a_bundle_that_nothing_has_used_for_long_is_removed(tmp_path: Path, cache: BundleCache, digest: str) -> None:
    (old, first), (new, second) = bundle_of(tmp_path, "old"), bundle_of(tmp_path, "new")
    cache.store(old, first)
    cache.folder(old)
    then = time.time() - KEPT_SECONDS - 60
    os.utime(cache._folder / f".{old}.used", (then, then))
    cache.store(new, second)
    assert [cache.has(name) for name in (old, new, digest)] == [False, True, True]
    cache.store(old, first)
    assert cache.folder(old).is_dir()


def test_leftovers_of_killed_workers_are_removed_and_nothing_else(tmp_path: Path, archive: bytes, digest: str) -> None:
    folder = tmp_path / "cache"
    folder.mkdir(mode=0o700)
    old, young, foreign, file = (folder / name for name in (f".{digest}-ab12", f".{digest}-cd34", ".mine-x", f".{digest}-ef56"))
    for path in (old, young, foreign):
        path.mkdir()
        (path / "part").write_text("x")
    (old / "sealed").mkdir(mode=0o500)
    file.write_text("x")
    before = old.stat().st_mtime - 2 * LEFT_SECONDS
    for path in (old, foreign, file):
        os.utime(path, (before, before))
    BundleCache(folder).store(digest, archive)
    assert not old.exists()
    assert young.exists()
    assert foreign.exists()
    assert file.exists()


def test_a_killed_unpacking_leaves_what_the_next_worker_removes(tmp_path: Path, archive: bytes, digest: str) -> None:
    (tmp_path / "archive").write_bytes(archive)
    code = (
        "import os, sys; from pathlib import Path; from drivecal.bundles import archives\n"
        "archives.Path.rename = lambda *_: os._exit(9)\n"
        "archives.unpack(Path(sys.argv[1]).read_bytes(), Path(sys.argv[2]))"
    )
    folder = tmp_path / "cache"
    folder.mkdir(mode=0o700)
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "archive"), str(folder / digest)], check=False)
    [left] = folder.iterdir()
    assert left.name.startswith(f".{digest}-")
    before = left.stat().st_mtime - 2 * LEFT_SECONDS
    os.utime(left, (before, before))
    BundleCache(folder).store(digest, archive)
    assert [path.name for path in folder.iterdir()] == [digest]
