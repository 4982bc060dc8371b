"""Labels of campaigns: name, tags, comment, and whether a campaign is archived."""

import json
from collections.abc import Sequence
from typing import Any

from sqlalchemy import ColumnElement, Connection, Text, cast, func, update

from drivecal.contracts.organising import Archived, CampaignChanges
from drivecal.domain.errors import ConflictError, InvalidInputError, Problem
from drivecal.storage import campaigns as stored_campaigns
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.tables import campaigns
from drivecal.storage.engine.types import now

MOST_TAGS = 20


def change(connection: Connection, campaign_id: str, changes: CampaignChanges) -> StoredCampaign:
    """Changes labels, and returns the campaign. Of tags that are added and removed, none stays. The same labels again change nothing.

    Raises NotFoundError, InvalidInputError for too many tags, and ConflictError if a campaign is to be archived before it has ended.
    """
    before = stored_campaigns.get(connection, campaign_id, lock=True)
    if changes.archived and not before.state.ended:
        raise ConflictError(f"{campaign_id} is {before.state}; only ended campaigns are archived: cancel it first")
    tags: Sequence[str] | None = changes.tags
    if changes.add_tags or changes.remove_tags:
        tags = _changed_tags(before.tags, changes.add_tags or (), changes.remove_tags or ())
    values: dict[str, Any] = {
        "name": changes.name,
        "comment": changes.comment,
        "tags": None if tags is None else sorted(set(tags)),
    }
    values = {column: value for column, value in values.items() if value is not None}
    if changes.archived is not None and changes.archived != (before.archived_at is not None):
        values["archived_at"] = now() if changes.archived else None
    if all(_stored(before, column) == value for column, value in values.items()):
        return before
    here = campaigns.c.sequence == before.sequence
    connection.execute(update(campaigns).where(here).values(values | {"revision": campaigns.c.revision + 1}))
    return stored_campaigns.by_sequence(connection, before.sequence)


def _changed_tags(before: Sequence[str], added: Sequence[str], removed: Sequence[str]) -> Sequence[str]:
    tags = {*before, *added} - set(removed)
    if len(tags) > max(MOST_TAGS, len(before)):
        message = f"the campaign would have {len(tags)} tags"
        raise InvalidInputError(
            Problem("add_tags", message, f"a campaign has at most {MOST_TAGS}; remove some of {sorted(before)}")
        )
    return sorted(tags)


def _stored(campaign: StoredCampaign, column: str) -> Any:
    value = getattr(campaign, column)
    return list(value) if isinstance(value, tuple) else value


def listing(archived: Archived, tags: Sequence[str]) -> list[ColumnElement[bool]]:
    """Returns the conditions of a list: with or without archived campaigns, and with all of the `tags`."""
    table = campaigns.c
    conditions: list[ColumnElement[bool]] = []
    if archived != "with":
        conditions.append(table.archived_at.is_(None) if archived == "without" else table.archived_at.is_not(None))
    stored = cast(table.tags, Text)  # LIKE would ignore case on SQLite
    return conditions + [func.replace(stored, json.dumps(tag), "") != stored for tag in tags]
