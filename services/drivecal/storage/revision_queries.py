"""Cheap queries of revisions. They parse no document."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from datetime import datetime

from sqlalchemy import ColumnElement, Connection, bindparam, select

from drivecal.domain.campaigns import Action, CampaignState
from drivecal.storage.campaigns import IDS, listed
from drivecal.storage.engine.records import identified, page_by, record
from drivecal.storage.engine.tables import campaigns, processes
from drivecal.storage.processes import DISPATCHER


@dataclass(frozen=True, slots=True)
class CampaignRevision:
    """State of a campaign for change detection: every change raises its `revision`."""

    sequence: int
    id: str
    state: CampaignState
    requested_action: Action | None
    revision: int
    degraded: str | None
    waiting: str | None


_REVISION = [campaigns.c[field.name] for field in fields(CampaignRevision)]
_HEARTBEAT = select(processes.c.heartbeat_at).where(processes.c.name == DISPATCHER)
_CAMPAIGN = select(*_REVISION, _HEARTBEAT.scalar_subquery().label("heartbeat_at")).where(
    campaigns.c.id == bindparam("identifier"), campaigns.c.deleted_at.is_(None)
)
"""Statement that is built once: building it costs as much as executing it."""


def heartbeat(connection: Connection) -> datetime | None:
    """Returns the time of the dispatcher's last heartbeat; None before the first."""
    return connection.scalar(_HEARTBEAT)


def campaign_revision(connection: Connection, campaign_id: str) -> tuple[CampaignRevision, datetime | None]:
    """Returns a campaign's revision by its id, and the dispatcher's heartbeat, by one query. Raises NotFoundError."""
    row = identified(connection, _CAMPAIGN, "campaign", campaign_id, IDS)
    return record(CampaignRevision, row, state=CampaignState(row.state)), row.heartbeat_at


def page(
    connection: Connection,
    *,
    state: CampaignState | None,
    limit: int,
    cursor: str | None,
    conditions: Sequence[ColumnElement[bool]] = (),
) -> list[CampaignRevision]:
    """Returns the campaigns that `campaigns.page` returns for the same arguments, and one more if there are more."""
    rows, _ = page_by(connection, listed(_REVISION, state, conditions), campaigns.c.sequence, limit + 1, cursor)
    return [record(CampaignRevision, row, state=CampaignState(row.state)) for row in rows]


def revision(connection: Connection, sequence: int) -> int | None:
    """The revision of a campaign; None if it is gone."""
    return connection.scalar(select(campaigns.c.revision).where(campaigns.c.sequence == sequence))
