"""Removal of cells, runs and campaigns, each call in the transaction of its caller and small enough that other writers do not wait.

Rows go in an order that leaves no row pointing to a removed one, so that the database is whole after every transaction.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from sqlalchemy import Connection, delete, exists, or_, select, text, update

from drivecal.storage import admission
from drivecal.storage.engine.bulk import among
from drivecal.storage.engine.tables import (
    campaign_stages,
    campaigns,
    evaluations,
    events,
    generations,
    leases,
    lots,
    outside_sets,
    ratings,
    reference_indexes,
    reference_keys,
    runs,
    studies,
    traces,
)

KEYS = 5_000
"""Reference keys that go at a time."""


def alone(connection: Connection) -> None:
    """Lets no campaign start or be queued until the transaction ends, and no trace be requested. On SQLite a transaction that writes is
    alone anyway."""
    admission.alone(connection)  # before the table, as requests take both
    if connection.dialect.name == "postgresql":
        connection.execute(text("LOCK TABLE campaigns IN SHARE ROW EXCLUSIVE MODE"))


def begin(connection: Connection, sequence: int, pruned: Mapping[str, Any], note: str) -> None:
    """Marks a campaign as pruned, and empties what only a search that goes on needs; nothing if another pruning has removed its row.

    `pruned`: the moment `at` which it was, and the parameter `sets` that stay."""
    columns = select(campaigns.c.notes, campaigns.c.pruned).where(campaigns.c.sequence == sequence)
    row = connection.execute(columns).one_or_none()
    if row is None:
        return
    values: dict[str, Any] = {"pruned": dict(pruned), "revision": campaigns.c.revision + 1}
    notes = row.notes if row.pruned is not None else [*row.notes, note]
    connection.execute(update(campaigns).where(campaigns.c.sequence == sequence).values(**values, notes=notes))
    emptied: dict[str, Any] = {"population": [], "changed": [], "objectives": None, "optimizer_state": None}
    connection.execute(update(generations).where(generations.c.campaign_sequence == sequence).values(**emptied))


def remove_cells(connection: Connection, cells: Sequence[int], run_ids: Sequence[int]) -> None:
    """Removes cells that no other row refers to, and runs that these cells made. The setups' reference indexes are retired before."""
    for table in (leases, traces):
        for chunk in among(connection, table.c.evaluation_id, cells):
            connection.execute(delete(table).where(chunk))
    for chunk in among(connection, evaluations.c.id, cells):
        connection.execute(delete(evaluations).where(chunk))
    for chunk in among(connection, ratings.c.run_id, run_ids):
        connection.execute(delete(ratings).where(chunk))
    for chunk in among(connection, runs.c.id, run_ids):
        connection.execute(delete(runs).where(chunk))


def retire_indexes(connection: Connection, setup_ids: Collection[int]) -> list[int]:
    """Takes the reference indexes of setups out of use; the next campaign that needs one computes it from the remaining runs. Returns all
    retired indexes, whose keys `remove_keys` removes."""
    table = reference_indexes.c
    for chunk in among(connection, table.setup_id, sorted(setup_ids)):
        used = update(reference_indexes).where(chunk, table.influence_map_sequence > 0)
        connection.execute(used.values(influence_map_sequence=-table.id))
    return list(connection.scalars(select(table.id).where(table.influence_map_sequence < 0).order_by(table.id)))


def retire_maps(connection: Connection, maps: Collection[int]) -> None:
    """Takes the reference indexes under influence maps out of use, whose keys `remove_some_keys` removes."""
    table = reference_indexes.c
    under = table.influence_map_sequence.in_(list(maps))
    connection.execute(update(reference_indexes).where(under).values(influence_map_sequence=-table.id))


def remove_some_keys(connection: Connection) -> bool:
    """Removes some keys of the retired indexes; False if none is left."""
    table = reference_indexes.c
    index = connection.scalar(select(table.id).where(table.influence_map_sequence < 0).order_by(table.id).limit(1))
    if index is None:
        return False
    remove_keys(connection, index)
    return True


def remove_keys(connection: Connection, index: int) -> bool:
    """Removes some keys of a retired index, and the index with the last of them; False once it is gone."""
    key, mine = reference_keys.c.key, reference_keys.c.index_id == index
    following = connection.scalar(select(key).where(mine).order_by(key).offset(KEYS).limit(1))
    if following is not None:
        connection.execute(delete(reference_keys).where(mine, key <= following))
        return True
    connection.execute(delete(reference_keys).where(mine))
    connection.execute(delete(reference_indexes).where(reference_indexes.c.id == index))
    return False


def remove_records(connection: Connection, sequence: int) -> None:
    """Removes what is stored of a campaign, except its row and its cells."""
    for table in (campaign_stages, generations, lots, outside_sets, studies, events):
        connection.execute(delete(table).where(table.c.campaign_sequence == sequence))


def remove_campaign(connection: Connection, sequence: int) -> bool:
    """Removes a campaign that has no cells and that no other row names; False if it stays."""
    mine = campaigns.c.sequence == sequence
    identifier = select(campaigns.c.id).where(mine).scalar_subquery()
    needed = or_(
        exists().where(evaluations.c.campaign_sequence == sequence),
        exists().where(traces.c.campaign_sequence == sequence),
        exists().where(campaigns.c.rerun_of == identifier),
    )
    if connection.scalar(select(needed)):
        return False
    remove_records(connection, sequence)
    return connection.execute(delete(campaigns).where(mine)).rowcount == 1
