"""What the stages after the calibration found, as one document each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sqlalchemy import Connection, select

from drivecal.domain.campaigns import Stage
from drivecal.storage.membership import insert
from drivecal.storage.tables import studies


def save(connection: Connection, campaign_sequence: int, stage: Stage, document: Mapping[str, Any]) -> None:
    """Stores what a campaign's stage found so far, in the place of what was stored before."""
    statement = insert(connection, studies).values(campaign_sequence=campaign_sequence, stage=stage, document=dict(document))
    connection.execute(
        statement.on_conflict_do_update(index_elements=["campaign_sequence", "stage"], set_={"document": dict(document)})
    )


def get(connection: Connection, campaign_sequence: int, stage: Stage) -> dict[str, Any] | None:
    """What a stage found so far; None where it has not begun."""
    query = select(studies.c.document).where(studies.c.campaign_sequence == campaign_sequence, studies.c.stage == stage)
    return connection.execute(query).scalar_one_or_none()
