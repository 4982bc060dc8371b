"""Permission to push problems, which carry code that workers run.

On a server with tokens it takes a token that may push (`author`). A server without tokens asks for a signature by the secret in its home
folder, which only its own user can read: the command reads it, into the page it is pasted. So no foreign page and no other user of the
machine can send code. The signature covers the pushed bytes: a program that the command takes for the server can push nothing else.
"""

import hashlib
import hmac
import os
import re
import secrets
import stat
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from drivecal.configuration.settings import Settings
from drivecal.configuration.tokens import is_loopback
from drivecal.domain.errors import InvalidInputError, Problem

HEADER = "Drivecal-Push"
"""Request header with the digest of the body and its signature."""
FILE = "push.secret"
SHORTEST = 32
LARGEST = 512
_SIGNED = re.compile(r"([0-9a-f]{64}):([0-9a-f]{64})")


@dataclass(frozen=True, slots=True)
class Pushing:
    """Permission to push problems. A server without tokens keeps a `secret` in the folder `home`."""

    allowed: bool
    secret: bytes | None = field(default=None, repr=False)
    home: Path | None = None

    @classmethod
    def of(cls, settings: Settings, address: str) -> Self:
        """Returns the permission of a server that listens on `address`; creates its secret if there is none.

        Raises InvalidInputError if the secret cannot be created.
        """
        allowed = is_loopback(address) if settings.allow_push is None else settings.allow_push
        secret = create_secret(settings.home) if allowed and settings.tokens_file is None else None
        return cls(allowed, secret, settings.home.absolute())


OFF = Pushing(allowed=False)


def create_secret(home: Path) -> bytes:
    """Returns the secret in a home folder, a new one if there is none that only this user can read.

    Raises InvalidInputError if it cannot be written.
    """
    known = read_secret(home)
    if known is not None:
        return known
    path = home / FILE
    secret = secrets.token_urlsafe(SHORTEST).encode()
    try:
        home.mkdir(parents=True, exist_ok=True, mode=0o700)
        path.unlink(missing_ok=True)  # the file of another user, or readable by others
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "wb") as file:
            file.write(secret)
    except OSError as error:
        message = f"the secret for pushing problems cannot be written: {error.strerror}"
        raise InvalidInputError(Problem(str(path), message, "remove it, or set DRIVECAL_HOME to a folder of yours")) from error
    return secret


def read_secret(home: Path) -> bytes | None:
    """Returns the secret of the server with this home folder; None if there is none that belongs to this user alone."""
    try:
        descriptor = os.open(home / FILE, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))
        with os.fdopen(descriptor, "rb") as file:
            status = os.fstat(file.fileno())
            mine = not hasattr(os, "geteuid") or (status.st_uid == os.geteuid() and not status.st_mode & 0o077)
            content = file.read(LARGEST) if mine and stat.S_ISREG(status.st_mode) else b""
    except OSError:
        return None
    return content if len(content) >= SHORTEST else None


def sign(secret: bytes, content: bytes) -> str:
    """Returns the header for a pushed content."""
    digest = hashlib.sha256(content).hexdigest()
    return f"{digest}:{_signature(secret, digest)}"


def signed_digest(secret: bytes, header: str) -> str | None:
    """Returns the SHA-256 digest of the content that a header signs; None if the signature is wrong."""
    match = _SIGNED.fullmatch(header)
    if match is None or not hmac.compare_digest(match[2], _signature(secret, match[1])):
        return None
    return match[1]


def _signature(secret: bytes, digest: str) -> str:
    return hmac.new(secret, f"drivecal push {digest}".encode(), hashlib.sha256).hexdigest()
