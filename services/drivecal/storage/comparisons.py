"""The runs of a comparison: campaigns that belong to another one, and end or rest with it."""

from __future__ import annotations

from collections.abc import Collection

from sqlalchemy import Connection, select, update

from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import ConflictError
from drivecal.domain.events import EventKind
from drivecal.storage import events, leases
from drivecal.storage.tables import campaigns
from drivecal.storage.types import now

_OPEN = tuple(state for state in CampaignState if not state.ended)
_FOLLOWS: dict[CampaignState, tuple[Collection[CampaignState], CampaignState, EventKind]] = {
    CampaignState.PAUSED: ((CampaignState.RUNNING,), CampaignState.PAUSED, EventKind.PAUSED),
    CampaignState.RUNNING: ((CampaignState.PAUSED,), CampaignState.RUNNING, EventKind.RESUMED),
    CampaignState.CANCELLED: (_OPEN, CampaignState.CANCELLED, EventKind.CANCELLED),
    CampaignState.FAILED: (_OPEN, CampaignState.CANCELLED, EventKind.CANCELLED),
}
"""By the state of a comparison: which of its runs change, to what, and by which event that is told."""


def follow(connection: Connection, sequence: int, state: CampaignState) -> None:
    """Has the runs of a comparison follow it to a `state`; any other campaign has none."""
    if state not in _FOLLOWS:
        return
    before, after, told = _FOLLOWS[state]
    values = {"state": after, "revision": campaigns.c.revision + 1} | ({"ended_at": now()} if after.ended else {})
    mine = campaigns.c.parent_sequence == sequence
    statement = update(campaigns).where(mine, campaigns.c.state.in_(list(before))).values(values)
    for run in sorted(connection.execute(statement.returning(campaigns.c.sequence)).scalars()):
        events.add(connection, run, told, {"state": after})
    if after.ended:  # what of a run waited for workers when it failed was leased all the same
        for run in connection.scalars(
            select(campaigns.c.sequence).where(mine, campaigns.c.state != CampaignState.SUCCEEDED)
        ).all():
            leases.forget(connection, run)


def refuse_run(connection: Connection, campaign_id: str, parent_sequence: int | None, action: str) -> None:
    """Raises ConflictError where a campaign, by the number of its comparison, is a run of one."""
    comparison = comparison_of(connection, parent_sequence)
    if comparison is not None:
        raise ConflictError(f"campaign {campaign_id} is a run of the comparison {comparison}: {action} that")


def comparison_of(connection: Connection, parent_sequence: int | None) -> str | None:
    """The id of a comparison by its number; None for campaigns that are no run of one."""
    if parent_sequence is None:
        return None
    return connection.scalar(select(campaigns.c.id).where(campaigns.c.sequence == parent_sequence))
