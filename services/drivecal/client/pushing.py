"""Requests that push a problem."""

from os import PathLike
from pathlib import Path

from drivecal.client.problems import read_bundle
from drivecal.configuration.pushing import HEADER, read_secret, sign
from drivecal.configuration.settings import load_settings
from drivecal.domain.errors import InvalidInputError, Problem

Pushed = bytes | str | PathLike[str]
"""A problem: its archive, or the path of its folder or of an archive."""


def archive_of(problem: Pushed) -> bytes:
    """Returns the archive of a problem. Raises InvalidInputError with all faults of a folder."""
    if isinstance(problem, bytes):
        return problem
    path = Path(problem)
    if not path.is_file():
        return read_bundle(path)[1]
    try:
        return path.read_bytes()
    except OSError as error:
        raise InvalidInputError(Problem(str(path), f"it cannot be read: {error.strerror}", "give a folder")) from error


def push_headers(archive: bytes, *, signed: bool) -> dict[str, str]:
    """Returns the headers of a push. `signed`: by the secret of the server with this home folder, if this user can read it."""
    headers = {"Content-Type": "application/zip"}
    secret = read_secret(load_settings().home) if signed else None
    return headers if secret is None else headers | {HEADER: sign(secret, archive)}
