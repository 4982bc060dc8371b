"""Setups: everything besides the parameter set that decides a run."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, func, select

from drivecal.domain.setups import Setup
from drivecal.storage.engine.bulk import among, insert
from drivecal.storage.engine.tables import runs, setups


@dataclass(frozen=True, slots=True)
class StoredSetup:
    """A setup as it is stored."""

    fingerprint: str
    document: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class SetupCount:
    """Number of simulated results of a setup in the reference table."""

    id: int
    fingerprint: str
    scenario: str
    document: Mapping[str, Any]
    runs: int


def ensure(connection: Connection, given: Sequence[Setup]) -> list[int]:
    """The ids of setups, in order; those that are new are stored."""
    documents = {setup.fingerprint: setup for setup in given}
    rows = [
        {"fingerprint": fingerprint, "scenario": setup.scenario, "document": setup.document}
        for fingerprint, setup in sorted(documents.items())
    ]
    ids = _ids(connection, list(documents))
    missing = [row for row in rows if row["fingerprint"] not in ids]
    if missing:
        connection.execute(insert(connection, setups).on_conflict_do_nothing(index_elements=["fingerprint"]), missing)
        ids = _ids(connection, list(documents))
    return [ids[setup.fingerprint] for setup in given]


def counts(connection: Connection) -> list[SetupCount]:
    """The reference table's size per setup, ordered by scenario, then by the setups' age."""
    query = (
        select(setups, func.count(runs.c.id).label("runs"))
        .select_from(setups.outerjoin(runs))
        .group_by(setups.c.id)
        .order_by(setups.c.scenario, setups.c.id)
    )
    return [SetupCount(row.id, row.fingerprint, row.scenario, row.document, row.runs) for row in connection.execute(query)]


def by_id(connection: Connection, setup_id: int) -> StoredSetup:
    """Returns an existing setup."""
    row = connection.execute(select(setups).where(setups.c.id == setup_id)).one()
    return StoredSetup(row.fingerprint, row.document)


def documents(connection: Connection, fingerprints: Sequence[str]) -> dict[str, Mapping[str, Any]]:
    """Returns the documents of stored setups, by fingerprint."""
    documents: dict[str, Mapping[str, Any]] = {}
    for condition in among(connection, setups.c.fingerprint, fingerprints):
        documents.update(
            (row.fingerprint, row.document)
            for row in connection.execute(select(setups.c.fingerprint, setups.c.document).where(condition))
        )
    return documents


def _ids(connection: Connection, fingerprints: Sequence[str]) -> dict[str, int]:
    ids: dict[str, int] = {}
    for condition in among(connection, setups.c.fingerprint, fingerprints):
        ids.update(
            (row.fingerprint, row.id) for row in connection.execute(select(setups.c.fingerprint, setups.c.id).where(condition))
        )
    return ids
