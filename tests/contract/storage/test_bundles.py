"""Pushed problems: a content once, a name means the last push, and nothing is lost in a backup."""

from pathlib import Path

import pytest
from sqlalchemy import Connection

from drivecal.domain.errors import InvalidInputError, NotFoundError, TooLargeError
from drivecal.storage import admission, bundles, campaigns
from drivecal.storage.bundles import StoredBundle
from drivecal.storage.engine.database import Database
from drivecal.storage.maintenance import backup
from drivecal.storage.maintenance.backup import copy_rows

A, B, C = "a" * 64, "b" * 64, "c" * 64


def push(connection: Connection, digest: str, name: str = "acc", archive: bytes = b"PK\0\xff") -> tuple[StoredBundle, bool]:
    admission.admit_problem(connection, digest, 1000)
    return bundles.add(connection, digest=digest, name=name, manifest={"problem": name, "b": 1, "a": 2}, archive=archive)


def listed(connection: Connection, limit: int = 50, name: str | None = None) -> list[str]:
    digests: list[str] = []
    cursor = None
    while True:
        page, cursor = bundles.listing(connection, name=name, limit=limit, cursor=cursor)
        digests += [bundle.digest for bundle in page]
        if cursor is None:
            return digests


def test_a_bundle_is_read_back_as_it_was_stored(connection: Connection) -> None:
    stored, new = push(connection, A)
    assert new
    assert (stored.name, stored.size, list(stored.manifest), stored.latest) == ("acc", 4, ["problem", "b", "a"], True)
    assert bundles.by_digest(connection, A) == bundles.by_name(connection, "acc") == stored
    assert bundles.named(connection, A) == bundles.named(connection, "acc") == bundles.named(connection, A[:12]) == stored
    assert bundles.archive(connection, A) == b"PK\0\xff"


def test_a_name_means_what_was_pushed_last_under_it(connection: Connection) -> None:
    push(connection, A)
    push(connection, B)
    push(connection, C, "other")
    assert bundles.by_name(connection, "acc").digest == B
    assert not bundles.by_digest(connection, A).latest
    again, new = push(connection, A)
    assert (again.latest, new) == (True, False)
    assert bundles.by_name(connection, "acc").digest == A
    assert not bundles.by_digest(connection, B).latest
    assert listed(connection, name="acc") == [A, B]


def test_a_list_holds_each_name_once_and_that_of_a_name_all_its_pushes(connection: Connection) -> None:
    for digest, name in ((A, "acc"), (B, "acc"), (C, "other")):
        push(connection, digest, name)
    assert listed(connection, limit=1) == listed(connection) == [C, B]
    assert listed(connection, limit=1, name="acc") == listed(connection, name="acc") == [B, A]
    assert listed(connection, name="nothing") == listed(connection, name="\0") == []
    with pytest.raises(InvalidInputError):
        bundles.listing(connection, cursor="nonsense")


@pytest.mark.parametrize("unknown", ["0" * 64, "\0", "nothing", ""])
def test_a_bundle_that_is_not_there_is_not_found(connection: Connection, unknown: str) -> None:
    push(connection, A)
    for find in (bundles.by_digest, bundles.by_name, bundles.named, bundles.archive):
        with pytest.raises(NotFoundError, check=lambda error: error.kind == "problem"):
            find(connection, unknown)


def test_no_more_than_the_limit_are_kept_and_the_known_ones_may_come_again(connection: Connection) -> None:
    push(connection, A)
    admission.admit_problem(connection, A, 1)
    with pytest.raises(TooLargeError):
        admission.admit_problem(connection, B, 1)


def copied_portions(database: Database, folder: Path, name: str) -> list[int]:
    """Copies a database; returns the rows of a table that were there after each portion."""
    portions: list[int] = []
    target = Database.open(f"sqlite:///{folder / 'copy.db'}")
    target.upgrade()
    with database.read() as source, target.transaction() as connection:
        copy_rows(source, connection, lambda table, done, _: portions.append(done) if table == name else None)
    return portions


@pytest.mark.parametrize("table", ["bundles", "campaigns"])
def test_large_rows_come_in_portions(database: Database, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, table: str) -> None:
    monkeypatch.setattr(backup, "CHUNK_BYTES", 1000)
    with database.transaction() as connection:
        for digest in (A, B, C):
            push(connection, digest, archive=bytes(1001))
            campaigns.insert(connection, name="long", spec={"starts": "x" * 1000})
    assert copied_portions(database, tmp_path, table) == [1, 2, 3]
