"""The release of drivecal that is installed here, as nodes compare it."""

from functools import cache
from hashlib import sha256
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

DIGITS = 12
"""Hexadecimal digits of the sources' digest."""


@cache
def release() -> str:
    """Returns the version and a digest of the installed sources, e.g. `0.1.0-5f0c1d2e3a4b`, read once per process.

    The version alone is the same for every commit between two releases. Not joined by `+`, which Ray does not allow in a label.
    """
    roots = [Path(root) for root in import_module("drivecal").__path__]
    return f"{version('drivecal')}-{sources_digest(roots)}"


def sources_digest(roots: list[Path]) -> str:
    """Returns a digest of all `*.py` in the folders and their names; one folder or several with the same files have the same digest."""
    files = {path.relative_to(root).as_posix(): path for root in roots for path in root.rglob("*.py")}
    digest = sha256()
    for name in sorted(files):
        content = files[name].read_bytes()
        digest.update(f"{name} {len(content)}\n".encode() + content)
    return digest.hexdigest()[:DIGITS]
