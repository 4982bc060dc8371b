"""Deletion of campaigns that nothing refers to.

A deleted campaign loses its tables, events and every cell that made no run. What it simulated stays in the reference table, with the cells
that are the origin of these runs: other campaigns were answered by them, or will be. They need the campaign's row, which stays, marked as
deleted, and which no list and no look-up by id returns.
"""

from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, delete, exists, or_, select, update

from drivecal.domain.errors import ConflictError
from drivecal.storage import campaigns as stored_campaigns
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.tables import (
    campaigns,
    evaluations,
    influence_maps,
    leases,
    reference_indexes,
    reference_keys,
    runs,
    saved_views,
    traces,
)
from drivecal.storage.engine.types import now
from drivecal.storage.retention import removal


@dataclass(frozen=True, slots=True)
class CampaignUse:
    """A campaign that refers to another one; `use`: what it needs of it."""

    campaign: str
    name: str
    use: str


def references(connection: Connection, campaign: StoredCampaign) -> list[CampaignUse]:
    """Returns the campaigns that refer to a campaign or to its runs: reruns, studies of its sets or predictions, and those that use its
    map."""
    table, family = campaigns.c, _family(connection, campaign)
    ids = list(family.values())
    outside = table.sequence.not_in(list(family)), table.deleted_at.is_(None)
    maps = select(influence_maps.c.id).where(influence_maps.c.source.in_(ids))
    examined = [table.spec[stage, "of"].as_string().in_(ids) for stage in ("robustness", "validation")]
    uses = (
        ("rerun of it", table.rerun_of.in_(ids)),
        ("study of it", or_(*examined)),
        ("use of its influence map", table.influence_map_id.in_(maps)),
    )
    referring: dict[str, CampaignUse] = {}
    for use, condition in uses:
        for row in connection.execute(select(table.id, table.name).where(*outside, condition).order_by(table.sequence)):
            referring.setdefault(row.id, CampaignUse(row.id, row.name, use))
    return list(referring.values())


def delete_campaign(connection: Connection, campaign_id: str) -> None:
    """Deletes an ended campaign, a comparison with its runs. Deleting again changes nothing.

    Raises NotFoundError for a campaign that never was, and ConflictError while it runs, if it belongs to a comparison, or if others refer
    to it.
    """
    campaign = stored_campaigns.get(connection, campaign_id, lock=True, deleted=True)
    if campaign.deleted_at is not None:
        return
    if not campaign.state.ended:
        raise ConflictError(f"{campaign_id} is {campaign.state}; only ended campaigns are deleted: cancel it first")
    if campaign.parent_sequence is not None:
        whole = stored_campaigns.by_sequence(connection, campaign.parent_sequence)
        raise ConflictError(f"{campaign_id} is a run of comparison {whole.id}; delete the comparison")
    referring = references(connection, campaign)
    if referring:
        listed = ", ".join(f"{reference.campaign} ({reference.use})" for reference in referring[:5])
        raise ConflictError(f"{len(referring)} campaigns refer to {campaign_id}: {listed}; archive it, or delete them first")
    for sequence, identifier in _family(connection, campaign).items():
        _remove(connection, sequence, identifier)


def _family(connection: Connection, campaign: StoredCampaign) -> dict[int, str]:
    """Returns the ids of a campaign and of its runs, by number."""
    mine = select(campaigns.c.sequence, campaigns.c.id).where(campaigns.c.parent_sequence == campaign.sequence)
    rows = connection.execute(mine.order_by(campaigns.c.sequence))
    return {campaign.sequence: campaign.id} | {row.sequence: row.id for row in rows}


def _remove(connection: Connection, sequence: int, identifier: str) -> None:
    mine = evaluations.c.campaign_sequence == sequence
    cells = select(evaluations.c.id).where(mine)
    connection.execute(delete(traces).where(or_(traces.c.campaign_sequence == sequence, traces.c.evaluation_id.in_(cells))))
    connection.execute(delete(leases).where(leases.c.evaluation_id.in_(cells)))
    made_its_run = exists().where(runs.c.id == evaluations.c.run_id, runs.c.evaluation_id == evaluations.c.id)
    connection.execute(delete(evaluations).where(mine, ~made_its_run))
    connection.execute(update(evaluations).where(mine).values(lot=None))
    removal.remove_records(connection, sequence)
    connection.execute(delete(saved_views).where(saved_views.c.campaign == identifier))
    emptied: dict[str, Any] = {
        "tags": [],
        "comment": "",
        "notes": [],
        "best": None,
        "baseline": None,
        "narrowed": None,
        "secret": None,
    }
    freed: dict[str, Any] = {
        "influence_map_id": None,
        "parent_sequence": None,
        "idempotency_key": None,
        "error_rate": {},
        "released": None,
    }
    marked = {"deleted_at": now(), "revision": campaigns.c.revision + 1}
    connection.execute(update(campaigns).where(campaigns.c.sequence == sequence).values(emptied | freed | marked))
    _remove_maps(connection, identifier)


def _remove_maps(connection: Connection, source: str) -> None:
    """Removes maps that a campaign made, with the reference indexes computed under them."""
    maps = list(connection.scalars(select(influence_maps.c.sequence).where(influence_maps.c.source == source)))
    under = reference_indexes.c.influence_map_sequence.in_(maps)
    indexes = list(connection.scalars(select(reference_indexes.c.id).where(under)))
    connection.execute(delete(reference_keys).where(reference_keys.c.index_id.in_(indexes)))
    connection.execute(delete(reference_indexes).where(under))
    connection.execute(delete(influence_maps).where(influence_maps.c.sequence.in_(maps)))
