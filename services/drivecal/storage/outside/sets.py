"""Parameter sets that outside optimizers propose to campaigns."""

from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import Connection, bindparam, func, select, update

from drivecal.domain.errors import ConflictError, NotFoundError
from drivecal.storage import campaigns
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.bulk import execute_rows, rows_among
from drivecal.storage.engine.tables import campaigns as campaigns_table
from drivecal.storage.engine.tables import outside_sets
from drivecal.storage.engine.types import now

AWAITED = (
    "all proposed sets are answered; another program proposes further ones (POST /campaigns/ID/sets) or ends the campaign"
    " (POST /campaigns/ID/finish), which takes no place of running campaigns meanwhile"
)
"""Reason why a campaign waits whose sets others propose."""


@dataclass(frozen=True, slots=True)
class OutsideSet:
    """A proposed set: grid indices by searched parameter, its scenarios, None for all of the campaign, and the number of its seeds.

    `key` is the name that the outside optimizer gave it, `number` counts the sets of a campaign from 1.
    """

    key: str
    indices: list[int]
    scenarios: list[str] | None = None
    replicates: int = 1
    number: int = 0


def external_campaign(connection: Connection, campaign_id: str) -> StoredCampaign:
    """Returns a campaign whose sets others propose, and keeps others from changing it until the transaction ends.

    Raises NotFoundError, and ConflictError if it has an optimizer of its own.
    """
    campaign = campaigns.get(connection, campaign_id, lock=True)
    if (campaign.spec.get("optimizer") or {}).get("kind") != "external":
        raise ConflictError(f"campaign {campaign_id} proposes its sets itself; submit one with optimizer: {{kind: external}}")
    return campaign


def _refuse_closed(campaign: StoredCampaign) -> None:
    """Raises ConflictError if a campaign takes no more sets."""
    reason: str | None = campaign.search.ended_by if campaign.search is not None else None
    if campaign.state.ended or campaign.requested_action == "cancel":
        reason = campaign.state if campaign.state.ended else "cancelling"
    elif reason is None and campaign.finish_at is not None:
        reason = "finished"
    if reason is not None:
        raise ConflictError(f"campaign {campaign.id} takes no more sets ({reason}); submit another campaign")


def finish(connection: Connection, campaign: StoredCampaign) -> StoredCampaign:
    """Lets a campaign of `external_campaign` end as soon as its sets are answered; asking again changes nothing.

    Raises ConflictError if the campaign has ended otherwise.
    """
    if campaign.finish_at is None:
        _refuse_closed(campaign)
        mine = update(campaigns_table).where(campaigns_table.c.sequence == campaign.sequence)
        connection.execute(mine.values(finish_at=now(), revision=campaigns_table.c.revision + 1))
    return campaigns.by_sequence(connection, campaign.sequence)


def add(connection: Connection, campaign: StoredCampaign, proposed: Sequence[OutsideSet]) -> dict[str, int]:
    """Stores sets for a campaign of `external_campaign`, each key once, and returns their numbers by key. Cancelled ones, which no round
    has asked for, wait again.

    Raises ConflictError if a key belongs to another set, or if there is a set to store and the campaign takes no more.
    """
    campaign_sequence, table = campaign.sequence, outside_sets.c
    is_dropped = (table.cancelled & table.iteration.is_(None)).label("is_dropped")
    query = select(table.key, table.number, table.indices, table.scenarios, table.replicates, is_dropped)
    query = query.where(table.campaign_sequence == campaign_sequence)
    known = {row.key: row for row in rows_among(connection, query, table.key, [each.key for each in proposed])}
    dropped = [row.number for row in known.values() if row.is_dropped]
    if dropped or len(known) < len({each.key for each in proposed}):
        _refuse_closed(campaign)
    for each in proposed:
        stored = known.get(each.key)
        asked = each.indices, each.scenarios, each.replicates
        if stored is not None and (stored.indices, stored.scenarios, stored.replicates) != asked:
            raise ConflictError(f"the key {each.key} belongs to set {stored.number}, another one; give a new set a new key")
    last = connection.scalar(select(func.max(table.number)).where(table.campaign_sequence == campaign_sequence)) or 0
    new = [each for each in proposed if each.key not in known]
    numbers = {each.key: number for number, each in enumerate(new, last + 1)}
    rows = [
        {"campaign_sequence": campaign_sequence, "number": numbers[each.key], "key": each.key}
        | {"indices": each.indices, "scenarios": each.scenarios, "replicates": each.replicates, "cancelled": False}
        for each in new
    ]
    execute_rows(connection, outside_sets.insert(), rows)
    again = update(outside_sets).where(table.campaign_sequence == campaign_sequence, table.number == bindparam("set"))
    execute_rows(connection, again.values(cancelled=False), [{"set": number} for number in dropped])
    return {each.key: numbers[each.key] if each.key in numbers else known[each.key].number for each in proposed}


def waiting(connection: Connection, campaign_sequence: int, most: int) -> tuple[bool, list[OutsideSet]]:
    """Returns whether a campaign was asked to finish, and its first sets that no round has asked for.

    The order of reading counts: after a finish no set is added.
    """
    finish_at = select(campaigns_table.c.finish_at).where(campaigns_table.c.sequence == campaign_sequence)
    closes = connection.scalar(finish_at) is not None
    table = outside_sets.c
    query = select(table.key, table.indices, table.scenarios, table.replicates, table.number).where(
        table.campaign_sequence == campaign_sequence, table.iteration.is_(None), ~table.cancelled
    )
    return closes, [OutsideSet(*row) for row in connection.execute(query.order_by(table.number).limit(most))]


def hold(connection: Connection, campaign_sequence: int, numbers: Sequence[int]) -> int:
    """Returns how many of the sets, from the first one, are not cancelled. None can be cancelled until the transaction ends: writers
    of sets lock their campaign first."""
    table = outside_sets.c
    connection.execute(select(campaigns_table.c.id).where(campaigns_table.c.sequence == campaign_sequence).with_for_update())
    query = select(table.number, table.cancelled).where(table.campaign_sequence == campaign_sequence)
    cancelled = {row.number for row in rows_among(connection, query, table.number, numbers) if row.cancelled}
    return next((place for place, number in enumerate(numbers) if number in cancelled), len(numbers))


def place(connection: Connection, campaign_sequence: int, iteration: int, numbers: Sequence[int]) -> None:
    """Notes that a round asks for sets, whose individuals are numbered in this order."""
    table = outside_sets.c
    mine = update(outside_sets).where(table.campaign_sequence == campaign_sequence, table.number == bindparam("set"))
    rows = [{"set": number, "at": individual} for individual, number in enumerate(numbers)]
    execute_rows(connection, mine.values(iteration=iteration, individual=bindparam("at")), rows)


def cancel(connection: Connection, campaign_id: str, key: str) -> tuple[int, bool]:
    """Cancels a set unless a round has asked for it. Returns its number, and whether it is cancelled.

    Raises NotFoundError if the campaign has no such key.
    """
    campaign = campaigns.get(connection, campaign_id, lock=True)
    here = outside_sets.c.campaign_sequence == campaign.sequence, outside_sets.c.key == key
    connection.execute(update(outside_sets).where(*here, outside_sets.c.iteration.is_(None)).values(cancelled=True))
    row = connection.execute(select(outside_sets.c.number, outside_sets.c.cancelled).where(*here)).one_or_none()
    if row is None:
        raise NotFoundError("set", key)
    return row.number, row.cancelled
