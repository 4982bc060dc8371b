"""What the stages after the calibration found, as one document each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sqlalchemy import Connection, select, update

from drivecal.contracts.campaign import Progress, StageCellCounts
from drivecal.domain.campaigns import Stage
from drivecal.storage.membership import insert
from drivecal.storage.tables import campaigns, studies


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


def save_progress(
    connection: Connection,
    campaign_sequence: int,
    stage: Stage,
    *,
    iteration: int | None,
    cells: StageCellCounts,
    progress: Progress,
    simulating_seconds: float,
) -> None:
    """Writes how far a campaign is in such a stage; what the stages before it found stays as it is."""
    column = {Stage.ROBUSTNESS: "robustness_cells", Stage.VALIDATION: "validation_cells"}[stage]
    statement = update(campaigns).where(campaigns.c.sequence == campaign_sequence)
    values: dict[str, Any] = {column: cells.model_dump(mode="json"), "progress": progress.model_dump(mode="json")}
    connection.execute(
        statement.values(
            revision=campaigns.c.revision + 1, stage=stage, iteration=iteration, simulating_seconds=simulating_seconds, **values
        )
    )
