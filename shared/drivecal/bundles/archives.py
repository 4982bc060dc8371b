"""Archives of problem bundles: packs a folder, unpacks safely, and digests the content. `pack` and `unpack` read and write files.

An archive is a zip of regular files with forward slashes in their names; of the modes, only "executable" counts. Empty folders and the
folders of `IGNORED` are left out, by whatever tool a zip was written.
"""

import hashlib
import os
import shutil
import stat
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.setups import canonical_json

MANIFEST = "problem.yaml"
LARGEST = 64 << 20
"""Bytes of all files together, and of an archive."""
MOST_FILES = 10_000
IGNORED = {".git", "__pycache__", ".venv", ".drivecal", "__MACOSX"}
LARGEST_RATIO = 1100
"""Deflate reaches 1032; an archive beyond it holds the same data several times."""
DEEPEST = 32
_EARLIEST = (1980, 1, 1, 0, 0, 0)
_END, _ENTRY, _LOCATOR_64 = b"PK\x05\x06", b"PK\x01\x02", b"PK\x06\x07"
UNREADABLE = (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, ValueError, OSError, struct.error, KeyError)
"""Exceptions of zipfile for archives that are damaged."""


@dataclass(frozen=True, slots=True)
class BundleFile:
    """A file of a bundle."""

    content: bytes
    executable: bool


def pack(folder: Path, largest: int = LARGEST, most_files: int = MOST_FILES) -> bytes:
    """Returns the archive of a folder; equal content gives equal bytes.

    Raises InvalidInputError for links, devices, unusable names, unreadable files, and folders that are too large.
    """
    return _written(_read(folder, largest, most_files))


def _read(folder: Path, largest: int, most_files: int) -> dict[str, BundleFile]:
    files: dict[str, BundleFile] = {}
    problems: list[Problem] = []
    size = 0
    for path, name in _walked(folder, "", problems):
        fault = _name_fault(name)
        if fault is not None:
            problems.append(Problem(shown(name), fault, "rename it"))
            continue
        try:
            with path.open("rb") as stream:
                mode, content = os.fstat(stream.fileno()).st_mode, stream.read(largest - size + 1)
        except OSError as error:
            problems.append(Problem(shown(name), f"it cannot be read: {error.strerror}", "correct its permissions"))
            continue
        size += len(content)
        files[name] = BundleFile(content, bool(mode & stat.S_IXUSR))
        if size > largest or len(files) > most_files:
            raise _too_large(str(folder), largest, most_files)
    if problems:
        raise InvalidInputError(*problems[:100])
    return files


def with_files(archive: bytes, additions: Mapping[str, bytes]) -> bytes:
    """Returns an archive with further files. Raises InvalidInputError if it becomes too large."""
    files = files_of(archive) | {name: BundleFile(content, executable=False) for name, content in additions.items()}
    if sum(len(file.content) for file in files.values()) > LARGEST or len(files) > MOST_FILES:
        raise _too_large("", LARGEST, MOST_FILES)
    return _written(files)


def unpack(archive: bytes, folder: Path, digest: str | None = None) -> None:
    """Writes an archive's files into a new, read-only folder, which appears complete or not at all.

    `digest`: the expected digest of the content. Raises InvalidInputError if it differs or the archive is unsafe, and FileExistsError if
    the folder is there and not empty.
    """
    files = files_of(archive)
    if digest is not None and _digest(files) != digest:
        message = f"the content has the digest {_digest(files)}, not {shown(digest)}"
        raise InvalidInputError(Problem("", message, "push the problem again"))
    if folder.exists() and any(folder.iterdir()):
        raise FileExistsError(f"{folder} is not empty")
    made = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        for name, file in files.items():
            path = made / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(file.content)
            path.chmod(0o555 if file.executable else 0o444)
        for path in made.rglob("*"):
            if path.is_dir():
                path.chmod(0o555)
        made.rename(folder)
    except BaseException:
        remove(made)
        raise
    folder.chmod(0o555)


def remove(folder: Path) -> None:
    """Removes a folder that `unpack` wrote."""
    folder.chmod(0o700)
    for path in folder.rglob("*"):
        if path.is_dir() and not path.is_symlink():
            path.chmod(0o700)
    shutil.rmtree(folder, ignore_errors=True)


def files_of(archive: bytes, largest: int = LARGEST, most_files: int = MOST_FILES) -> dict[str, BundleFile]:
    """Returns the files of an archive by name, in order, without a folder around all of them. Raises InvalidInputError if it is unsafe."""
    _check_directory(archive, largest, most_files)
    try:
        with zipfile.ZipFile(BytesIO(archive)) as opened:
            entries = _checked_entries(opened.infolist())
            _check_size(archive, entries, largest, most_files)
            files = {name: _content(opened, entries[name]) for name in sorted(entries)}
    except UNREADABLE as error:
        reason = " ".join(str(error).split())
        raise _refused("", f"the archive cannot be read: {shown(reason, 200)}", "write the zip again") from error
    top, mark, _ = next(iter(files), "").partition("/")
    if f"{top}/{MANIFEST}" in files and all(name.startswith(top + mark) for name in files):  # of the folder, not of its content
        files = {name.removeprefix(top + mark): file for name, file in files.items()}
        if (name := next(filter(_name_fault, files), None)) is not None:
            raise _refused(shown(name), _name_fault(name) or "", "leave it out of the archive")
    return files


def content_digest(archive: bytes) -> str:
    """Returns the digest of an archive's content: names, executable bits and bytes of all files. Raises InvalidInputError."""
    return _digest(files_of(archive))


def folder_digest(folder: Path) -> str:
    """Returns the digest of a folder's content. Raises InvalidInputError as `pack` does."""
    return _digest(_read(folder, LARGEST, MOST_FILES))


def files_digest(archive: bytes) -> str:
    """Returns the digest of all files but `problem.yaml`. Raises InvalidInputError."""
    return _digest({name: file for name, file in files_of(archive).items() if name != MANIFEST})


def manifest_text(files: Mapping[str, BundleFile]) -> bytes:
    """Returns the content of `problem.yaml`. Raises InvalidInputError if it is missing."""
    if MANIFEST in files:
        return files[MANIFEST].content
    inner = [name for name in files if name.endswith("/" + MANIFEST)]
    remedy = f"{inner[0]} must be at the top, without a folder" if inner else "add it: drivecal problem init shows one"
    raise _refused(MANIFEST, "the file is missing", remedy)


def _digest(files: Mapping[str, BundleFile]) -> str:
    """Returns SHA-256 in hexadecimal: 64 characters, which no other name of drivecal has."""
    content = [[name, file.executable, hashlib.sha256(file.content).hexdigest()] for name, file in sorted(files.items())]
    return hashlib.sha256(canonical_json(content).encode()).hexdigest()


def _walked(folder: Path, prefix: str, problems: list[Problem]) -> Iterator[tuple[Path, str]]:
    """Yields the regular files below a folder in order of names, and adds all other entries to `problems`."""
    try:
        entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
    except OSError as error:
        problems.append(Problem(shown(prefix or str(folder)), f"it cannot be read: {error.strerror}", "give a folder"))
        return
    if prefix.count("/") > DEEPEST:
        problems.append(Problem(shown(prefix), f"the folders are nested deeper than {DEEPEST}", "write a flatter tree"))
        return
    for entry in entries:
        if entry.name in IGNORED:
            continue
        name = prefix + entry.name
        if entry.is_dir(follow_symlinks=False):
            yield from _walked(Path(entry.path), name + "/", problems)
        elif entry.is_file(follow_symlinks=False):
            yield Path(entry.path), name
        else:
            kind = "a link" if entry.is_symlink() else "no regular file"
            problems.append(Problem(shown(name), f"it is {kind}", "copy the file itself there"))


def _written(files: Mapping[str, BundleFile]) -> bytes:
    buffer = BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        for name in sorted(files):
            info = zipfile.ZipInfo(name, _EARLIEST)
            info.create_system = 3  # Unix, on every system
            info.external_attr = (stat.S_IFREG | (0o755 if files[name].executable else 0o644)) << 16
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, files[name].content)
    return buffer.getvalue()


def _check_directory(archive: bytes, largest: int, most_files: int) -> None:
    """Raises InvalidInputError before zipfile reads a table of millions of entries."""
    if len(archive) > largest + most_files * 1024:
        raise _too_large("", largest, most_files)
    end = archive[-22:]
    if end[:4] != _END or end[20:] != b"\0\0" or archive[-42:-38] == _LOCATOR_64:
        raise _refused("", "this is not a zip archive, or it has a comment or format 64", "write it with drivecal problem push")
    (size,) = struct.unpack("<L", end[12:16])
    if archive.count(_ENTRY, max(0, len(archive) - 22 - size)) > 2 * most_files:
        raise _too_large("", largest, most_files)


def _checked_entries(infos: list[zipfile.ZipInfo]) -> dict[str, zipfile.ZipInfo]:
    """Returns the entries of files by name. Raises InvalidInputError for unsafe ones."""
    entries: dict[str, zipfile.ZipInfo] = {}
    folders: set[str] = set()
    for info in infos:
        name = info.orig_filename
        is_folder = name.endswith("/")
        fault = _name_fault(name.removesuffix("/")) or _kind_fault(info, is_folder=is_folder)
        if fault is not None:
            raise _refused(shown(name), fault, "leave it out of the archive")
        parts = name.removesuffix("/").split("/")
        if IGNORED & set(parts):
            continue
        folders |= {"/".join(parts[: end + 1]) for end in range(len(parts) - (not is_folder))}
        if not is_folder:
            if name in entries:
                raise _refused(shown(name), "it appears twice in the archive", "leave one out")
            entries[name] = info
    for name in entries:
        if name in folders:
            raise _refused(shown(name), "it is a file and a folder", "leave one out")
    return entries


def _name_fault(name: str) -> str | None:
    """Returns the fault of a path inside an archive."""
    parts = name.split("/")
    if name.startswith("/") or name[1:2] == ":":
        return "the path is absolute"
    if ".." in parts:
        return "the path leaves the folder"
    if not name or "" in parts or "." in parts:
        return "the path has an empty part"
    if "\\" in name or not name.isprintable():
        return "the name has backslashes or control characters"
    try:
        sizes = [len(part.encode()) for part in parts]
    except UnicodeEncodeError:
        return "the name is not valid UTF-8"
    if max(sizes) > 255 or sum(sizes) > 1000 or len(parts) > DEEPEST + 1:
        return "the path is too long"
    return None


def _kind_fault(info: zipfile.ZipInfo, *, is_folder: bool) -> str | None:
    kind = stat.S_IFMT(info.external_attr >> 16) if info.create_system == 3 else 0
    if kind not in {0, stat.S_IFDIR if is_folder else stat.S_IFREG}:
        return "it is a link" if stat.S_ISLNK(kind) else "it is not a regular file"
    if info.flag_bits & 0x1:
        return "it is encrypted"
    if info.compress_type not in {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}:
        return "it is compressed by an unusual method"
    if is_folder and info.file_size:
        return "it is a folder with content"
    return None


def _check_size(archive: bytes, entries: Mapping[str, zipfile.ZipInfo], largest: int, most_files: int) -> None:
    size = sum(info.file_size for info in entries.values())
    if size > largest or len(entries) > most_files:
        raise _too_large("", largest, most_files)
    if size > LARGEST_RATIO * len(archive):
        raise _refused("", f"{len(archive):,} bytes claim to hold {size:,}", "write the zip again")


def _content(opened: zipfile.ZipFile, info: zipfile.ZipInfo) -> BundleFile:
    """Returns a file, which is never read beyond its declared size."""
    with opened.open(info) as stream:
        content = stream.read(info.file_size + 1)
    if len(content) != info.file_size:
        raise zipfile.BadZipFile(f"{info.filename} has not the size that the archive declares")
    executable = info.create_system == 3 and bool(info.external_attr >> 16 & stat.S_IXUSR)
    return BundleFile(content, executable)


def _too_large(field: str, largest: int, most_files: int) -> InvalidInputError:
    message = f"it holds more than {largest >> 20} MB or {most_files:,} files"
    return _refused(field, message, "leave out what the simulator does not read")


def _refused(field: str, message: str, remedy: str) -> InvalidInputError:
    return InvalidInputError(Problem(field, message, remedy))
