"""Deletion of campaigns that nothing refers to.

A deleted campaign loses its tables, events and every cell that was repeated, reused, predicted, or has no result. Its runs stay in the
reference table, with the cells that made them. Its other simulated cells stay as well, for instance cells that a simulation of another
campaign answered: copies in other campaigns may name them. The campaign's row stays for them, marked as deleted. No list and no look-up by
id returns it.

The mark is one transaction. Everything else goes later, in small pieces, so that other writers do not wait.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from sqlalchemy import Connection, delete, exists, func, select, update

from drivecal.domain.errors import ConflictError
from drivecal.domain.evaluations import Outcome
from drivecal.storage import admission
from drivecal.storage import campaigns as stored_campaigns
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.tables import (
    campaigns,
    evaluations,
    events,
    generations,
    influence_maps,
    leases,
    lots,
    outside_sets,
    reference_indexes,
    reference_keys,
    runs,
    studies,
    traces,
)
from drivecal.storage.engine.types import now

SLICE = 5_000
"""Cells of a campaign whose rows go in a transaction."""
KEYS = 5_000
"""Reference keys that go at a time."""
MOST_LISTED = 20
"""Campaigns that a refusal names."""
_REMOVE = "remove"
"""Is asked for of a deleted campaign until its cells are gone."""


def references(connection: Connection, campaign: StoredCampaign) -> dict[str, str]:
    """Returns how campaigns refer to a campaign, by their ids: as reruns, studies of its sets or predictions, or users of its map."""
    table = campaigns.c
    outside = table.sequence != campaign.sequence, table.deleted_at.is_(None)
    maps = select(influence_maps.c.id).where(influence_maps.c.source == campaign.id)
    uses = (
        ("rerun of it", table.rerun_of == campaign.id),
        ("study of it", (table.robustness_of == campaign.id) | (table.validation_of == campaign.id)),
        ("use of its influence map", table.influence_map_id.in_(maps)),
    )
    referring: dict[str, str] = {}
    for use, condition in uses:
        for identifier in connection.scalars(select(table.id).where(*outside, condition).order_by(table.sequence)):
            referring.setdefault(identifier, use)
    return referring


def delete_campaign(connection: Connection, campaign_id: str) -> None:
    """Marks an ended campaign as deleted. Deleting again changes nothing. Until the transaction ends no campaign is queued, which might
    refer to this one. Raises NotFoundError for a campaign that never was, and ConflictError while it runs or if others refer to it.
    """
    admission.alone(connection)
    campaign = stored_campaigns.get(connection, campaign_id, lock=True, deleted=True)
    if campaign.deleted_at is not None:
        return
    if not campaign.state.ended:
        raise ConflictError(f"{campaign_id} has not ended; cancel it, and delete it when a dispatcher has ended it")
    referring = references(connection, campaign)
    if referring:
        listed = ", ".join(f"{identifier} ({use})" for identifier, use in list(referring.items())[:MOST_LISTED])
        raise ConflictError(f"other campaigns refer to {campaign_id}: {listed} ({len(referring)} in all); delete them first")
    _mark(connection, campaign.sequence, campaign.id)


def removal(database: Database) -> Iterator[bool]:
    """Removes what deleted campaigns left, and yields True after each piece. If it was interrupted, a new one goes on."""
    with database.read() as connection:
        marked = campaigns.c.requested_action == _REMOVE, campaigns.c.deleted_at.is_not(None)
        left = list(connection.scalars(select(campaigns.c.sequence).where(*marked)))
    for sequence in left:
        with database.read() as connection:
            own = select(evaluations.c.id).where(evaluations.c.campaign_sequence == sequence)
            numbers = np.sort(np.fromiter(connection.scalars(own), np.int64))  # other campaigns' may lie between
        for start in range(0, len(numbers), SLICE):
            piece = numbers[start : start + SLICE]
            with database.transaction() as connection:
                admission.alone(connection)  # or a trace could be requested of a cell whose traces are gone already
                remove_slice(connection, sequence, range(int(piece[0]), int(piece[-1]) + 1))
            yield True
        with database.transaction() as connection:
            for table in (traces, generations, lots, outside_sets, events):
                connection.execute(delete(table).where(table.c.campaign_sequence == sequence))
            connection.execute(update(campaigns).where(campaigns.c.sequence == sequence).values(requested_action=None))
    while True:
        with database.transaction() as connection:
            if not remove_some_keys(connection):
                return
        yield True


def _mark(connection: Connection, sequence: int, identifier: str) -> None:
    emptied: dict[str, Any] = {"tags": (), "notes": (), "best": None, "confirmation": None, "baseline": None}
    freed: dict[str, Any] = {"influence_map_id": None, "idempotency_key": None, "error_rate": {}, "released": {}}
    marked = {"deleted_at": now(), "requested_action": _REMOVE, "revision": campaigns.c.revision + 1}
    connection.execute(update(campaigns).where(campaigns.c.sequence == sequence).values(emptied | freed | marked))
    maps = list(connection.scalars(select(influence_maps.c.sequence).where(influence_maps.c.source == identifier)))
    index = reference_indexes.c  # `remove_some_keys` removes what has no map any more
    connection.execute(
        update(reference_indexes).where(index.influence_map_sequence.in_(maps)).values(influence_map_sequence=-index.id)
    )
    connection.execute(delete(influence_maps).where(influence_maps.c.sequence.in_(maps)))
    connection.execute(delete(studies).where(studies.c.campaign_sequence == sequence))  # others list them


def remove_slice(connection: Connection, sequence: int, numbers: range) -> None:
    """Removes the cells of a campaign with these numbers, except cells that others may refer to."""
    cell = evaluations.c
    # "+ 0", or the database might go through all cells of the campaign for each slice
    mine = cell.id.between(numbers.start, numbers.stop - 1) & (cell.campaign_sequence + 0 == sequence)
    made_its_run = exists().where(runs.c.id == cell.run_id, runs.c.evaluation_id == cell.id)
    may_answer = func.coalesce(cell.outcome == Outcome.SIMULATED, False)
    goes = mine & ~made_its_run & ~may_answer
    for table in (traces, leases):
        here = table.c.evaluation_id.between(numbers.start, numbers.stop - 1)
        connection.execute(delete(table).where(here, exists().where(cell.id == table.c.evaluation_id, mine)))
    connection.execute(delete(evaluations).where(goes))
    connection.execute(update(evaluations).where(mine, cell.lot.is_not(None)).values(lot=None))


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
