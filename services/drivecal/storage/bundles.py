"""Pushed problem bundles: each content once, by its digest. A name means the content that was pushed last under it."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from difflib import get_close_matches
from typing import Any

from sqlalchemy import ColumnElement, Connection, Select, bindparam, exists, func, select, update

from drivecal.domain.errors import NotFoundError
from drivecal.storage.engine.records import page_by, record
from drivecal.storage.engine.tables import bundles
from drivecal.storage.engine.types import now

KIND = "problem"
MOST_NAMES = 1_000
"""Largest number of names, last pushed first, that are compared with a misspelt one."""
_DIGEST, _ABBREVIATED = re.compile(r"[0-9a-f]{64}"), re.compile(r"[0-9a-f]{8,63}")
_later = bundles.alias("later")
_latest = ~exists().where(_later.c.name == bundles.c.name, _later.c.pushed > bundles.c.pushed)
_HEADING: list[Any] = [column for column in bundles.c if column.name not in {"archive", "manifest"}]


@dataclass(frozen=True, slots=True)
class BundleHeading:
    """A bundle in a list, with the `digest` of its content and the `size` of its archive in bytes."""

    digest: str
    name: str
    size: int
    pushed: int
    """Its place in the order of pushes: pushing the same content again moves it to the end."""
    created_at: datetime
    latest: bool
    """True if its name means it."""


@dataclass(frozen=True, slots=True)
class StoredBundle(BundleHeading):
    """A bundle without its archive."""

    manifest: Mapping[str, Any]
    """The checked `problem.yaml`, as a JSON document."""


def add(
    connection: Connection, *, digest: str, name: str, manifest: Mapping[str, Any], archive: bytes
) -> tuple[StoredBundle, bool]:
    """Stores a bundle unless its content is stored, and makes its name mean it. Returns it, and whether it is new.

    The caller is the only one who adds (`admission.admit_problem`).
    """
    pushed = (connection.scalar(select(func.max(bundles.c.pushed))) or 0) + 1
    moved = update(bundles).where(bundles.c.digest == digest, ~_latest).values(pushed=pushed)
    is_new = not connection.execute(moved).rowcount and not is_stored(connection, digest)
    if is_new:
        row = {"digest": digest, "name": name, "manifest": dict(manifest), "archive": archive, "size": len(archive)}
        connection.execute(bundles.insert().values(**row, pushed=pushed, created_at=now()))
    return by_digest(connection, digest), is_new


def is_stored(connection: Connection, digest: str) -> bool:
    """Returns whether a content is stored."""
    return connection.scalar(select(exists().where(bundles.c.digest == digest))) or False


def by_digest(connection: Connection, digest: str) -> StoredBundle:
    """Returns a bundle by its digest. Raises NotFoundError."""
    return _only(connection, bundles.c.digest == bindparam("given"), digest)


def by_name(connection: Connection, name: str) -> StoredBundle:
    """Returns the bundle that a name means. Raises NotFoundError."""
    try:
        return _only(connection, (bundles.c.name == bindparam("given")) & _latest, name)
    except NotFoundError as error:
        names = connection.scalars(select(bundles.c.name).where(_latest).order_by(bundles.c.pushed.desc()).limit(MOST_NAMES))
        close = get_close_matches(name, names.all(), n=1)
        raise NotFoundError(KIND, name, f"did you mean {close[0]}?" if close else "") from error


def named(connection: Connection, name_or_digest: str) -> StoredBundle:
    """Returns the bundle of a digest or a name, else of the only digest that begins so. Raises NotFoundError."""
    if _DIGEST.fullmatch(name_or_digest):
        return by_digest(connection, name_or_digest)
    try:
        return by_name(connection, name_or_digest)
    except NotFoundError:
        begun = select(bundles.c.digest).where(bundles.c.digest.startswith(name_or_digest)).limit(2)
        digests = connection.scalars(begun).all() if _ABBREVIATED.fullmatch(name_or_digest) else ()
        if len(digests) != 1:
            raise
        return by_digest(connection, digests[0])


def manifests(connection: Connection, name: str) -> dict[str, Mapping[str, Any]]:
    """Returns the manifests of everything that was pushed under a name by digest, last pushed first."""
    query = select(bundles.c.digest, bundles.c.manifest).where(bundles.c.name == name).order_by(bundles.c.pushed.desc())
    return {row.digest: row.manifest for row in connection.execute(query)}


def archive(connection: Connection, digest: str) -> bytes:
    """Returns the archive of a bundle. Raises NotFoundError."""
    by_digest(connection, digest)
    return bytes(connection.scalars(select(bundles.c.archive).where(bundles.c.digest == digest)).one())


def listing(
    connection: Connection, *, name: str | None = None, limit: int = 50, cursor: str | None = None
) -> tuple[list[BundleHeading], str | None]:
    """Returns at most `limit` bundles, last pushed first, and the cursor of the next page (None on the last).

    Lists what each name means, or everything that was pushed under one `name`. Raises InvalidInputError.
    """
    if name is not None and not name.isprintable():
        return [], None
    query: Select[Any] = select(*_HEADING, _latest.label("latest")).where(_latest if name is None else bundles.c.name == name)
    rows, following = page_by(connection, query, bundles.c.pushed, limit, cursor)
    return [record(BundleHeading, row) for row in rows], following


def _only(connection: Connection, condition: ColumnElement[bool], given: str) -> StoredBundle:
    """Returns the bundle of a condition on `given`. Anything may come in a URL: PostgreSQL refuses to compare a NUL."""
    query: Select[Any] = select(*_HEADING, bundles.c.manifest, _latest.label("latest")).where(condition)
    row = connection.execute(query, {"given": given}).one_or_none() if given.isprintable() else None
    if row is None:
        raise NotFoundError(KIND, given)
    return record(StoredBundle, row)
