"""The release of drivecal that is installed here, as nodes compare it."""

from functools import cache
from hashlib import sha256
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

PACKAGES = ("domain", "api", "runtime")
"""A package of each folder that holds sources. Any folder named `drivecal` where a process starts belongs to the namespace as well."""
DIGITS = 12
"""Hexadecimal digits of the sources' digest."""


@cache
def release() -> str:
    """Returns the version and a digest of the installed sources, e.g. `0.1.0-5f0c1d2e3a4b`, read once per process.

    The version alone is the same for every commit between two releases. Not joined by `+`, which Ray does not allow in a label.
    """
    specs = (find_spec(f"drivecal.{name}") for name in PACKAGES)
    roots = {Path(spec.origin).parents[1] for spec in specs if spec is not None and spec.origin is not None}
    return f"{version('drivecal')}-{sources_digest(sorted(roots))}"


def sources_digest(roots: list[Path]) -> str:
    """Returns a digest of all `*.py` in the folders and their names; one folder or several with the same files have the same digest."""
    files = {path.relative_to(root).as_posix(): path for root in roots for path in root.rglob("*.py") if path.is_file()}
    digest = sha256()
    for name in sorted(files):
        content = files[name].read_bytes()
        digest.update(f"{name} {len(content)}\n".encode() + content)
    return digest.hexdigest()[:DIGITS]
