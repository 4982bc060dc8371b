"""Setups: everything besides the parameter set that decides a run."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, func, select

from drivecal.domain.setups import Setup
from drivecal.storage.engine.bulk import insert, rows_among
from drivecal.storage.engine.records import record
from drivecal.storage.engine.tables import runs, setups


@dataclass(frozen=True, slots=True)
class SetupCount:
    """Number of simulated results of a setup in the reference table."""

    id: int
    fingerprint: str
    scenario: str
    document: Mapping[str, Any]
    runs: int


def ensure(connection: Connection, given: Sequence[Setup]) -> list[int]:
    """The ids of setups, in order; new ones are stored."""
    setups_by = {setup.fingerprint: setup for setup in given}
    known = ids(connection, list(setups_by))
    rows = [
        {"fingerprint": fingerprint, "scenario": setup.scenario, "document": setup.document}
        for fingerprint, setup in sorted(setups_by.items())
        if fingerprint not in known
    ]
    if rows:
        connection.execute(insert(connection, setups).on_conflict_do_nothing(index_elements=["fingerprint"]), rows)
        known = ids(connection, list(setups_by))
    return [known[setup.fingerprint] for setup in given]


def counts(connection: Connection) -> list[SetupCount]:
    """The reference table's size per setup, ordered by scenario, then by the setups' age."""
    query = (
        select(setups, func.count(runs.c.id).label("runs"))
        .select_from(setups.outerjoin(runs))
        .group_by(setups.c.id)
        .order_by(setups.c.scenario, setups.c.id)
    )
    return [record(SetupCount, row) for row in connection.execute(query)]


def by_id(connection: Connection, setup_id: int) -> Setup:
    """Returns an existing setup."""
    return Setup(*connection.execute(select(setups.c.scenario, setups.c.document).where(setups.c.id == setup_id)).one())


def documents(connection: Connection, fingerprints: Sequence[str]) -> dict[str, Mapping[str, Any]]:
    """Returns the documents of stored setups, by fingerprint."""
    query = select(setups.c.fingerprint, setups.c.document)
    return dict(rows_among(connection, query, setups.c.fingerprint, fingerprints))


def ids(connection: Connection, fingerprints: Sequence[str]) -> dict[str, int]:
    """Returns the ids of stored setups, by fingerprint."""
    query = select(setups.c.fingerprint, setups.c.id)
    return dict(rows_among(connection, query, setups.c.fingerprint, fingerprints))
