"""What the stages after the calibration found, as one document each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, and_, or_, select, update

from drivecal.contracts.campaign import Progress, StageCellCounts
from drivecal.domain.campaigns import Stage
from drivecal.storage.engine.bulk import insert
from drivecal.storage.engine.tables import campaigns, studies


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


@dataclass(frozen=True, slots=True)
class StoredStudy:
    """Who made a study, with what: `spec` and `resolution` are the maker's."""

    campaign_sequence: int
    campaign: str
    name: str
    stage: Stage
    state: str
    spec: Mapping[str, Any]
    resolution: Mapping[str, Any] | None
    ended_at: datetime | None


def about(connection: Connection, campaign_id: str, campaign_sequence: int, influence_map_id: str | None) -> list[StoredStudy]:
    """The studies of a campaign's best sets and of the map that it uses, whoever made them, the newest first."""
    own = campaigns.c.sequence == campaign_sequence
    of_its_sets = and_(studies.c.stage == Stage.ROBUSTNESS, campaigns.c.spec["robustness", "of"].as_string() == campaign_id)
    of_its_map = and_(studies.c.stage == Stage.VALIDATION, campaigns.c.influence_map_id == influence_map_id)
    query = (
        select(campaigns, studies.c.stage.label("made"))
        .select_from(studies.join(campaigns, studies.c.campaign_sequence == campaigns.c.sequence))
        .where(or_(own, of_its_sets, of_its_map) if influence_map_id is not None else or_(own, of_its_sets))
        .order_by(campaigns.c.sequence.desc(), studies.c.stage)
    )
    return [
        StoredStudy(row.sequence, row.id, row.name, row.made, row.state, row.spec, row.resolution, row.ended_at)
        for row in connection.execute(query)
    ]


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
