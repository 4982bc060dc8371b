"""Inputs of runs outside of the bundle: digests of variables, files and folders, and the files that a simulator opens.

`python -I -B -m drivecal.adapters.inputs SETTINGS` prints a digest a line, and sees what a simulator sees. Opened files are known from
Python's audit hook, and from what processes hold open or have mapped: a file that compiled code opens and closes again is not seen.
"""

import hashlib
import json
import os
import sys
from collections.abc import Iterable
from pathlib import Path

DIGITS = 16
"""Bytes of a digest."""


def digest_of_variable(name: str) -> str:
    """Returns a digest of a variable's value, keyed by its name. A guess can be checked."""
    value = os.environ.get(name)
    if value is None:
        return "not set"
    return hashlib.blake2b(os.fsencode(value), key=name.encode()[:64], digest_size=DIGITS).hexdigest()


def digest_of_path(path: Path) -> str:
    """Returns a digest of a file, or of the names and contents of all files below a folder, also behind links. Raises OSError."""
    content = hashlib.blake2b(digest_size=DIGITS)
    if not path.is_dir():
        with path.open("rb") as file:
            while part := file.read(1 << 20):
                content.update(part)
        return content.hexdigest()
    known: dict[str, str] = {}

    def refuse(error: OSError) -> None:
        raise error

    for folder, below, files in os.walk(path, onerror=refuse, followlinks=True):
        below.sort()
        name = os.path.relpath(folder, path)
        first = known.setdefault(os.path.realpath(folder), name)
        if first != name:  # several links lead there, perhaps in a circle
            content.update(f"{name!r} is {first!r}\n".encode())
            below.clear()
            continue
        for each in sorted(Path(folder, file) for file in files):
            if each.is_file():
                content.update(f"{os.fsencode(each.relative_to(path))!r} {digest_of_path(each)}\n".encode())
    return content.hexdigest()


MOST = 10_000
"""Most paths that are kept."""
NAME = "opened"
"""File with the paths, in the scratch folder."""


def record(file: Path) -> None:
    """Writes the path of every file that this interpreter opens for reading, each once, to a file."""
    known: set[str] = set()
    out = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        if event != "open" or len(known) >= MOST or not isinstance(arguments[0], str | bytes):
            return
        flags = arguments[2]
        path = os.path.abspath(os.fsdecode(arguments[0]))  # noqa: PTH100  # a Path of each opened file takes ten times as long
        if path not in known and isinstance(flags, int) and flags & os.O_ACCMODE != os.O_WRONLY:
            known.add(path)
            os.write(out, os.fsencode(path) + b"\0")

    sys.addaudithook(hook)


def seen(file: Path, processes: Iterable[int]) -> set[str]:
    """Returns the paths that a child has recorded, and of files that processes hold open or have mapped."""
    paths = set(os.fsdecode(file.read_bytes()).split("\0")[:-1]) if file.is_file() and not file.is_symlink() else set()
    for process in processes:
        folder = Path(f"/proc/{process}")
        try:
            maps = (folder / "maps").read_text(errors="surrogateescape").splitlines()
            paths |= {line.split(maxsplit=5)[5] for line in maps if line.count(" /")}
            paths |= {str(link.readlink()) for link in (folder / "fd").iterdir()}
        except OSError:  # it has ended, or is another user's
            continue
    return {path for path in paths if path.startswith("/")}


def main() -> None:
    """Prints the digests that the settings in the first argument ask for: `environment` and `paths`."""
    settings = json.loads(sys.argv[1])
    for name in settings["environment"]:
        sys.stdout.write(f"${name}: {digest_of_variable(name)}\n")
    for path in settings["paths"]:
        try:
            sys.stdout.write(f"{path}: {digest_of_path(Path(path))}\n")
        except OSError as error:
            sys.exit(f"the input {path} cannot be read: {error.filename}: {error.strerror}")


if __name__ == "__main__":
    main()
