"""Parts that removals share, each call in the transaction of its caller."""

from __future__ import annotations

from collections.abc import Collection

from sqlalchemy import Connection, delete, select, update

from drivecal.storage.engine.tables import (
    campaign_stages,
    events,
    generations,
    lots,
    outside_sets,
    reference_indexes,
    reference_keys,
    studies,
)

KEYS = 5_000
"""Reference keys that go at a time."""


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
    key, mine = reference_keys.c.key, reference_keys.c.index_id == index
    following = connection.scalar(select(key).where(mine).order_by(key).offset(KEYS).limit(1))
    if following is not None:
        connection.execute(delete(reference_keys).where(mine, key <= following))
        return True
    connection.execute(delete(reference_keys).where(mine))
    connection.execute(delete(reference_indexes).where(reference_indexes.c.id == index))
    return True


def remove_records(connection: Connection, sequence: int) -> None:
    """Removes what is stored of a campaign, except its row and its cells."""
    for table in (campaign_stages, generations, lots, outside_sets, studies, events):
        connection.execute(delete(table).where(table.c.campaign_sequence == sequence))
