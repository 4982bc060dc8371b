"""Labels of campaigns: name and tags."""

import json
from collections.abc import Sequence

from sqlalchemy import ColumnElement, Connection, Text, cast, func, update

from drivecal.contracts.organising import CampaignChanges
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.storage import campaigns as stored_campaigns
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.tables import campaigns

MOST_TAGS = 20


def change(connection: Connection, campaign_id: str, changes: CampaignChanges) -> StoredCampaign:
    """Changes labels, and returns the campaign. Of tags that are added and removed, none stays. The same labels again change nothing.

    Raises NotFoundError, and InvalidInputError for too many tags.
    """
    before = stored_campaigns.get(connection, campaign_id, lock=True)
    name = before.name if changes.name is None else changes.name
    tags = {*(before.tags if changes.tags is None else changes.tags), *(changes.add_tags or ())} - {
        *(changes.remove_tags or ())
    }
    if len(tags) > max(MOST_TAGS, len(before.tags)):
        remedy = f"a campaign has at most {MOST_TAGS}; remove some of {sorted(before.tags)}"
        raise InvalidInputError(Problem("add_tags", f"the campaign would have {len(tags)} tags", remedy))
    if (name, tags) == (before.name, {*before.tags}):
        return before
    values = {"name": name, "tags": tuple(sorted(tags)), "revision": campaigns.c.revision + 1}
    connection.execute(update(campaigns).where(campaigns.c.sequence == before.sequence).values(values))
    return stored_campaigns.by_sequence(connection, before.sequence)


def having(tags: Sequence[str]) -> list[ColumnElement[bool]]:
    """Returns the conditions of a list of the campaigns with all of the `tags`."""
    stored = cast(campaigns.c.tags, Text)  # LIKE would ignore case on SQLite
    return [func.replace(stored, json.dumps(tag), "") != stored for tag in tags]
