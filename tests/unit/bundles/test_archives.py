"""Archives of bundles: round trips, digests of the content, and hostile zips."""

import os
import socket
import stat
import struct
import tempfile
import zipfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.effort import examples
from tests.support.zips import zipped

from drivecal.bundles.archives import (
    IGNORED,
    BundleFile,
    content_digest,
    files_digest,
    files_of,
    manifest_text,
    pack,
    remove,
    unpack,
)
from drivecal.domain.errors import InvalidInputError

Tree = dict[str, BundleFile]
parts = st.text(
    st.characters(codec="utf-8", exclude_categories=["C", "Z"], exclude_characters="/\\:"), min_size=1, max_size=8
).filter(lambda part: part not in {".", "..", *IGNORED} and part.isprintable())
names = st.lists(parts, min_size=1, max_size=3).map("/".join)
files = st.builds(BundleFile, st.binary(max_size=100), st.booleans())


def is_tree(tree: Tree) -> bool:
    """Returns whether no file is a folder of another file."""
    folders = {"/".join(name.split("/")[:end]) for name in tree for end in range(1, name.count("/") + 1)}
    return not folders & tree.keys()


trees = st.dictionaries(names, files, max_size=6).filter(is_tree)


def written(folder: Path, tree: Tree) -> Path:
    for name, file in tree.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(file.content)
        path.chmod(0o750 if file.executable else 0o640)
    return folder


def typed(name: str, mode: int) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(name)
    info.create_system, info.external_attr = 3, mode << 16
    return info


@settings(deadline=None, max_examples=examples(60))
@given(tree=trees)
def test_what_is_packed_is_unpacked(tree: Tree) -> None:
    with tempfile.TemporaryDirectory() as folder:
        archive = pack(written(Path(folder) / "source", {"problem.yaml": BundleFile(b"", executable=False)} | tree))
        unpack(archive, Path(folder) / "target", content_digest(archive))
        assert pack(Path(folder) / "target") == archive
        unpacked = files_of(archive)
        assert {name: file for name, file in unpacked.items() if name in tree} == tree
        for path in (Path(folder) / "target").rglob("*"):
            assert not path.stat().st_mode & 0o222
        remove(Path(folder) / "target")
        assert not (Path(folder) / "target").exists()


@settings(deadline=None, max_examples=examples(100))
@given(tree=trees, other=trees)
def test_equal_content_and_no_other_has_the_same_digest(tree: Tree, other: Tree) -> None:
    def archive(content: Tree, compression: int, names: list[str]) -> bytes:
        mode = {name: 0o777 if content[name].executable else 0o600 for name in names}
        return zipped(*((typed(name, mode[name]), content[name].content) for name in names), compression=compression)

    ours = archive(tree, zipfile.ZIP_STORED, list(tree))
    assert content_digest(ours) == content_digest(archive(tree, zipfile.ZIP_DEFLATED, list(reversed(tree))))
    assert (content_digest(ours) == content_digest(archive(other, zipfile.ZIP_STORED, list(other)))) == (tree == other)


def test_one_bit_of_content_name_or_mode_changes_the_digest() -> None:
    def digests(name: str, content: bytes, mode: int) -> tuple[str, str]:
        archive = zipped((typed("problem.yaml", 0o644), b"a: 1"), (typed(name, mode), content))
        return content_digest(archive), files_digest(archive)

    same = digests("a", b"x", 0o644)
    assert digests("a", b"x", 0o600) == same
    for other in (digests("b", b"x", 0o644), digests("a", b"y", 0o644), digests("a", b"x", 0o755)):
        assert other[0] != same[0]
        assert other[1] != same[1]


def test_the_digest_of_the_files_does_not_see_the_manifest() -> None:
    first, second = (zipped(("problem.yaml", text), ("a", b"x")) for text in (b"a: 1", b"a: 2"))
    assert files_digest(first) == files_digest(second)
    assert content_digest(first) != content_digest(second)
    assert files_digest(first) == content_digest(zipped(("a", b"x")))


def test_folders_of_tools_are_left_out(tmp_path: Path) -> None:
    content = BundleFile(b"x", executable=False)
    ignored = {f"{folder}/a": content for folder in (".git", "sub/__pycache__", ".venv", ".drivecal")}
    written(tmp_path, {"problem.yaml": content, "sub/b": content} | ignored)
    (tmp_path / "empty").mkdir()
    archive = pack(tmp_path)
    assert list(files_of(archive)) == ["problem.yaml", "sub/b"]
    everything = zipped(*((path.relative_to(tmp_path).as_posix(), b"x") for path in tmp_path.rglob("*") if path.is_file()))
    assert content_digest(everything) == content_digest(archive)


def test_links_and_devices_and_bad_names_in_a_folder_are_refused_together(tmp_path: Path) -> None:
    written(tmp_path, {"problem.yaml": BundleFile(b"", executable=False), "a\\b": BundleFile(b"", executable=False)})
    (tmp_path / "file").symlink_to("/etc/passwd")
    (tmp_path / "folder").symlink_to("/etc")
    (tmp_path / "broken").symlink_to("nowhere")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / os.fsdecode(b"\xff")).write_bytes(b"")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "socket"))
        with pytest.raises(InvalidInputError) as refusal:
            pack(tmp_path)
    assert len(refusal.value.problems) == 7


def test_a_folder_that_is_too_large_is_refused(tmp_path: Path) -> None:
    written(tmp_path, {str(index): BundleFile(b"x" * 10, executable=False) for index in range(5)})
    assert pack(tmp_path, largest=50, most_files=5)
    for limits in ({"largest": 49}, {"most_files": 4}):
        with pytest.raises(InvalidInputError):
            pack(tmp_path, **limits)
    with pytest.raises(InvalidInputError):
        pack(tmp_path / "missing")


LINK = typed("link", stat.S_IFLNK | 0o777)
DEVICE = typed("device", stat.S_IFCHR | 0o666)
FOLDER_AS_FILE = typed("folder", stat.S_IFDIR | 0o755)
SIGNED = zipped(("a", b"x" * 1000))


def encrypted() -> bytes:
    content = bytearray(zipped(("a", b"x")))
    content[6] |= 1
    content[content.index(b"PK\x01\x02") + 8] |= 1
    return bytes(content)


def resized(size: int) -> bytes:
    """An archive that declares another size of its file than it has."""
    content = bytearray(SIGNED)
    entry = content.index(b"PK\x01\x02")
    content[22:26] = content[entry + 24 : entry + 28] = struct.pack("<L", size)
    return bytes(content)


def overlapping(copies: int) -> bytes:
    """An archive whose entries share one file of a megabyte of zeros."""
    content = zipped(("a", bytes(1 << 20)))
    start = content.index(b"PK\x01\x02")
    entry, end = content[start:-22], content[-22:]
    counts = struct.pack("<HHL", copies, copies, copies * len(entry))
    return content[:start] + entry * copies + end[:8] + counts + end[16:]


def many(count: int) -> bytes:
    """An archive with a table of very many entries that stay unread."""
    content = SIGNED
    start = content.index(b"PK\x01\x02")
    entry, end = content[start:-22], content[-22:]
    return content[:start] + entry * count + end[:12] + struct.pack("<L", count * len(entry)) + end[16:]


@pytest.mark.parametrize(
    "archive",
    [
        b"",
        b"no zip",
        SIGNED[:-1],
        SIGNED[10:],
        SIGNED + b"tail",
        SIGNED[:-22],
        zipped(("/etc/passwd", b"")),
        zipped(("../a", b"")),
        zipped(("a/../../b", b"")),
        zipped(("a//b", b"")),
        zipped(("./a", b"")),
        zipped(("C:/a", b"")),
        zipped(("a\\b", b"")),
        zipped(("a\nb", b"")),
        zipped(("a" * 256, b"")),
        zipped(("a/" * 40 + "a", b"")),
        zipped((LINK, b"/etc/passwd")),
        zipped((DEVICE, b"")),
        zipped((FOLDER_AS_FILE, b"x")),
        zipped(("a", b"1"), ("a/b", b"2")),
        zipped(("a", b"1"), ("a/", b"")),
        zipped(("a", b"x"), compression=zipfile.ZIP_LZMA),
        zipped(("a", b"x"), compression=zipfile.ZIP_BZIP2),
        encrypted(),
        resized(999),
        resized(1001),
        resized(2**31),
        resized(2**32 - 1),
        overlapping(50),
        many(30_000),
    ],
    ids=range(30),
)
def test_hostile_archives_are_refused(archive: bytes, tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError):
        files_of(archive)
    with pytest.raises(InvalidInputError):
        unpack(archive, tmp_path / "target")
    assert list(tmp_path.iterdir()) == []


def test_an_archive_that_holds_a_name_twice_is_refused() -> None:
    with pytest.warns(UserWarning, match="Duplicate name"):
        archive = zipped(("a", b"1"), ("a", b"2"))
    with pytest.raises(InvalidInputError):
        files_of(archive)


def test_limits_hold_for_archives_too() -> None:
    archive = zipped(("a", b"x" * 1000), ("b", b"y"))
    assert files_of(archive, largest=1001, most_files=2)
    for limits in ({"largest": 1000}, {"most_files": 1}):
        with pytest.raises(InvalidInputError):
            files_of(archive, **limits)


def test_a_megabyte_of_zeros_is_no_bomb() -> None:
    assert files_of(zipped(("a", bytes(1 << 20))))["a"].content == bytes(1 << 20)


def test_a_folder_with_files_is_not_written_over(tmp_path: Path) -> None:
    archive = zipped(("a", b"x"))
    unpack(archive, tmp_path / "target")
    with pytest.raises(FileExistsError):
        unpack(archive, tmp_path / "target")
    assert [path.name for path in tmp_path.iterdir()] == ["target"]


def test_the_manifest_must_be_at_the_top() -> None:
    assert manifest_text(files_of(zipped(("problem.yaml", b"a: 1")))) == b"a: 1"
    assert files_of(zipped(("my/problem.yaml", b"a: 1"), ("my/b/c", b""), ("__MACOSX/my/a", b""))).keys() == {
        "problem.yaml",
        "b/c",
    }, "a zip of the folder"
    for archive in (zipped(("my/problem.yaml", b""), ("mine", b"")), zipped(("my/b/problem.yaml", b"")), zipped(("a", b""))):
        with pytest.raises(InvalidInputError):
            manifest_text(files_of(archive))


def test_executables_are_told_from_other_files() -> None:
    archive = zipped((typed("a", 0o755), b""), (typed("b", 0o644), b""))
    assert {name: file.executable for name, file in files_of(archive).items()} == {"a": True, "b": False}
