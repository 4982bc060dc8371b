"""Tokens that may use the server: a text file with one token per line, read again whenever it changes.

    # name  may     token
    anna    write   Zs6Oq1fO1Hh0T7m1K0cY3A
    plant2  read    9q2kT0bYw8vX5mJ4rL1nPg
    bea     author  Vb3xW9cQpLd7sKj2hTzR5w
    root    admin   hX2mP8vQ4tLw6nRb1sKzC9

A reader changes nothing, a writer starts campaigns, an author also pushes problems, which carry code. Writers and authors steer and delete
their own campaigns, an admin all campaigns.

No message ever quotes a word of the file: with mixed-up columns it would put a token in the log.
"""

import hashlib
import hmac
import io
import ipaddress
import logging
import os
import re
import stat
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from drivecal.configuration.settings import Settings
from drivecal.domain.errors import InvalidInputError, Problem

SHORTEST = 16
"""Fewest characters of a token."""
LONGEST = 512
LARGEST_FILE = 1_048_576
"""Largest size of a tokens file in bytes."""
FORM = "one token per line: NAME read|write|author|admin TOKEN"
_NAME = re.compile(rb"[A-Za-z0-9][A-Za-z0-9_.@-]{0,63}")
_PRINTABLE = re.compile(rb"[\x21-\x7e]+")

log = logging.getLogger("drivecal.tokens")


@dataclass(frozen=True, slots=True)
class Token:
    """A client's right to use the server. Of the token itself only the SHA-256 is kept."""

    name: str
    may_write: bool
    digest: bytes = field(repr=False)
    may_push: bool = False
    is_admin: bool = False
    """True if it may steer and delete campaigns of others."""

    def may_steer(self, owner: str | None) -> bool:
        """Returns whether it may pause, resume, cancel and delete a campaign of an owner, None for a campaign without one."""
        return self.is_admin or owner is None or owner == self.name


def parse(content: bytes, source: str) -> tuple[list[Token], list[Problem]]:
    """Returns the tokens of all lines of a file without a fault, and the faults of the others, which name `source` and line."""
    tokens: list[Token] = []
    problems: list[Problem] = []
    first_lines: dict[str | bytes, int] = {}
    for number, words in _lines(content):
        where = f"{source}, line {number}"
        wrong = _wrong(words)
        if wrong is not None:
            problems.append(Problem(where, *wrong))
            continue
        name, may = words[0].decode("ascii"), words[1]
        token = Token(name, may != b"read", _digest(words[2]), may in {b"author", b"admin"}, may == b"admin")
        keys: tuple[tuple[str | bytes, str], ...] = ((token.name, "name"), (token.digest, "token"))
        again = [(first_lines[key], kind) for key, kind in keys if key in first_lines]
        problems += [Problem(where, f"the {kind} is that of line {line}", f"give each {kind} once") for line, kind in again]
        for key, _ in keys:
            first_lines.setdefault(key, number)
        if not again:
            tokens.append(token)
    if not tokens and not problems:
        problems.append(Problem(source, "it holds no token", f"write {FORM}"))
    return tokens, problems


def _lines(content: bytes) -> Iterator[tuple[int, list[bytes]]]:
    """Yields the lines that are no comment, as words, with their numbers from 1."""
    for number, line in enumerate(content.removeprefix(b"\xef\xbb\xbf").split(b"\n"), start=1):
        words = line.split()
        if words and not words[0].startswith(b"#"):
            yield number, words


def _wrong(words: list[bytes]) -> tuple[str, str] | None:
    """Returns the problem of a line with its remedy, or None."""
    if len(words) != 3:
        return f"there are {len(words)} words", f"write {FORM}"
    name, may, token = words
    if may not in {b"read", b"write", b"author", b"admin"}:
        return "the second word is not read, write, author or admin", f"write {FORM}"
    if not _NAME.fullmatch(name):
        return "invalid name", "give up to 64 letters, digits, `_`, `.`, `@` or `-` (ASCII)"
    if not _PRINTABLE.fullmatch(token):
        return "the token holds characters that are not ASCII, or not printable", "use letters and digits"
    if not SHORTEST <= len(token) <= LONGEST:
        return f"the token has {len(token)} characters", f"give {SHORTEST} to {LONGEST}, by chance"
    return None


def _digest(token: bytes) -> bytes:
    return hashlib.sha256(token).digest()


class TokenFile:
    """The tokens of a file as it is now."""

    def __init__(self, path: Path) -> None:
        """Reads the file. Raises InvalidInputError if it cannot be read or has a fault."""
        self._path = path
        self._version = _version(path)
        tokens, problems = parse(_read(path), str(path))
        if problems:
            raise InvalidInputError(*problems)
        self.tokens = tuple(tokens)
        self.fault: str | None = None
        """Message about the present version of the file if it cannot be used as it is."""

    def find(self, presented: bytes) -> Token | None:
        """Returns the token with this secret, None without a match. Takes equally long for any secret: it compares all digests."""
        self._refresh()
        digest, match = _digest(presented), None
        for token in self.tokens:
            if hmac.compare_digest(token.digest, digest):
                match = token
        return match

    def named(self, name: str) -> Token | None:
        """Returns the token of this name, None without one."""
        self._refresh()
        return next((token for token in self.tokens if token.name == name), None)

    def _refresh(self) -> None:
        """Reads the file again if it has changed. A faulty version is logged once and adds no token, but revokes the tokens that no good
        line of it holds. A missing, unreadable or empty file changes nothing: many editors leave one for a moment."""
        version = _version(self._path)
        if version == self._version:
            return
        self._version = version
        try:
            content = _read(self._path)
            tokens, problems = parse(content, str(self._path))
        except InvalidInputError as error:
            content, tokens, problems = b"", [], list(error.problems)
        if not problems:
            self.tokens, self.fault = tuple(tokens), None
            log.warning("the tokens were read again: %d tokens", len(self.tokens))
            return
        if any(_lines(content)):
            known = {token.digest for token in self.tokens}
            self.tokens = tuple(token for token in tokens if token.digest in known)
        faults = "; ".join(map(str, problems))
        self.fault = f"the tokens file is faulty: {len(self.tokens)} known tokens are accepted and no new ones until it is mended: {faults}"
        log.warning("%s", self.fault)


def _version(path: Path) -> tuple[int, ...] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_ctime_ns, status.st_size, status.st_ino


def _read(path: Path) -> bytes:
    at_once = getattr(os, "O_NONBLOCK", 0)  # a pipe blocks its reader until a writer opens it
    try:
        with io.FileIO(path, opener=lambda name, flags: os.open(name, flags | at_once)) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise InvalidInputError(Problem(str(path), "it is not a file", "name a text file with tokens"))
            content = file.read(LARGEST_FILE + 1)
    except OSError as error:
        reason = f"it cannot be read: {error.strerror}"
        raise InvalidInputError(Problem(str(path), reason, f"make it, {FORM}, or set another DRIVECAL_TOKENS_FILE")) from None
    if len(content) > LARGEST_FILE:
        raise InvalidInputError(Problem(str(path), f"it is larger than {LARGEST_FILE:,} bytes", f"write {FORM}"))
    return content


MAKE_TOKENS = "python3 -c 'import secrets; print(\"me write\", secrets.token_urlsafe(24))' > tokens"
"""The shortest way to a tokens file."""


def is_loopback(address: str) -> bool:
    """Returns True for an IP address that only this machine can connect to."""
    return ipaddress.ip_address(address.partition("%")[0]).is_loopback


def is_this_machine(name: str) -> bool:
    """Returns True for localhost and loopback addresses, False for all other names."""
    try:
        return name.lower() == "localhost" or ("%" not in name and is_loopback(name))
    except ValueError:
        return False


def check_exposure(address: str, settings: Settings) -> None:
    """Raises InvalidInputError if other machines could use a server without tokens."""
    if settings.tokens_file is None and not is_loopback(address):
        remedy = f"make a tokens file ({MAKE_TOKENS}) and give --tokens-file or DRIVECAL_TOKENS_FILE, or listen on 127.0.0.1"
        raise InvalidInputError(Problem("--host", f"everyone who reaches {address} could use this server", remedy))
