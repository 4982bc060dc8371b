"""Labels of campaigns: name, tags, comment, and whether a campaign is archived."""

import json
from collections.abc import Sequence
from typing import Any, Literal

from sqlalchemy import ColumnElement, Connection, Text, cast, update

from drivecal.domain.errors import ConflictError
from drivecal.storage import campaigns as stored_campaigns
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.tables import campaigns
from drivecal.storage.engine.types import now

Archived = Literal["without", "with", "only"]


def change(
    connection: Connection,
    campaign_id: str,
    *,
    name: str | None = None,
    tags: Sequence[str] | None = None,
    comment: str | None = None,
    archived: bool | None = None,
) -> StoredCampaign:
    """Changes the labels that are given, and returns the campaign. The same labels again change nothing.

    Raises NotFoundError, and ConflictError if a campaign is to be archived before it has ended.
    """
    before = stored_campaigns.get(connection, campaign_id, lock=True)
    if archived and not before.state.ended:
        raise ConflictError(f"{campaign_id} is {before.state}; only ended campaigns are archived: cancel it first")
    values: dict[str, Any] = {"name": name, "comment": comment, "tags": None if tags is None else sorted(set(tags))}
    values = {column: value for column, value in values.items() if value is not None}
    if archived is not None and archived != (before.archived_at is not None):
        values["archived_at"] = now() if archived else None
    if all(_stored(before, column) == value for column, value in values.items()):
        return before
    here = campaigns.c.sequence == before.sequence
    connection.execute(update(campaigns).where(here).values(values | {"revision": campaigns.c.revision + 1}))
    return stored_campaigns.by_sequence(connection, before.sequence)


def _stored(campaign: StoredCampaign, column: str) -> Any:
    value = getattr(campaign, column)
    return list(value) if isinstance(value, tuple) else value


def listing(archived: Archived, tags: Sequence[str]) -> list[ColumnElement[bool]]:
    """Returns the conditions of a list: with or without archived campaigns, and with all of the `tags`."""
    table = campaigns.c
    conditions: list[ColumnElement[bool]] = []
    if archived != "with":
        conditions.append(table.archived_at.is_(None) if archived == "without" else table.archived_at.is_not(None))
    return conditions + [cast(table.tags, Text).contains(json.dumps(tag), autoescape=True) for tag in tags]
