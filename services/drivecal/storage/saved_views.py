"""Saved views of the page: a name and an address, of one campaign or of all."""

import uuid
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import Connection, bindparam, delete, func, select, update

from drivecal.domain.errors import ConflictError
from drivecal.storage.engine.bulk import insert
from drivecal.storage.engine.records import identified, record
from drivecal.storage.engine.tables import saved_views
from drivecal.storage.engine.types import now

MOST_VIEWS = 1_000
"""Most views of a campaign, and most of all campaigns together."""


@dataclass(frozen=True, slots=True)
class StoredView:
    """A view; `campaign` is empty if it is for all campaigns."""

    id: str
    campaign: str
    name: str
    address: str
    created_at: datetime


def listed(connection: Connection, campaign: str | None) -> list[StoredView]:
    """Returns the views for all campaigns, and with a `campaign` also its own, by name."""
    wanted = ["", *([] if campaign is None else [campaign])]
    query = select(saved_views).where(saved_views.c.campaign.in_(wanted))
    return [record(StoredView, row) for row in connection.execute(query.order_by(saved_views.c.name, saved_views.c.sequence))]


def save(connection: Connection, campaign: str, name: str, address: str) -> StoredView:
    """Saves a view, in place of an earlier one of this name. Raises ConflictError if there are MOST_VIEWS others."""
    others = saved_views.c.campaign == campaign, saved_views.c.name != name
    count = connection.scalar(select(func.count()).where(*others)) or 0
    if count >= MOST_VIEWS:
        raise ConflictError(f"there are {count:,} saved views; delete some first")
    row = {"id": uuid.uuid4().hex, "campaign": campaign, "name": name, "address": address, "created_at": now()}
    statement = insert(connection, saved_views).values(row)
    again = statement.on_conflict_do_update(index_elements=["campaign", "name"], set_={"address": address})
    return record(StoredView, connection.execute(again.returning(saved_views)).one())


def rename(connection: Connection, view_id: str, name: str) -> StoredView:
    """Gives a view another name. Raises NotFoundError, and ConflictError if another view has it."""
    query = select(saved_views).where(saved_views.c.id == bindparam("identifier"))
    view = record(StoredView, identified(connection, query, "saved view", view_id))
    same = saved_views.c.campaign == view.campaign, saved_views.c.name == name, saved_views.c.id != view_id
    if connection.scalar(select(saved_views.c.id).where(*same)) is not None:
        raise ConflictError(f"there is a saved view {name!r} already; give another name")
    changed = update(saved_views).where(saved_views.c.id == view_id).values(name=name).returning(saved_views)
    return record(StoredView, connection.execute(changed).one())


def remove(connection: Connection, view_id: str) -> None:
    """Removes a view. Removing it again changes nothing."""
    connection.execute(delete(saved_views).where(saved_views.c.id == view_id))
