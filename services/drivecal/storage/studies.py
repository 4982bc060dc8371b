"""Results of the stages after the calibration, one document each."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, select, union

from drivecal.domain.campaigns import StageName
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.bulk import insert
from drivecal.storage.engine.records import record
from drivecal.storage.engine.tables import campaigns, studies


def save(connection: Connection, campaign_sequence: int, stage: StageName, document: Mapping[str, Any]) -> None:
    """Stores the results of a campaign's stage so far, in place of earlier ones."""
    statement = insert(connection, studies).values(campaign_sequence=campaign_sequence, stage=stage, document=dict(document))
    connection.execute(
        statement.on_conflict_do_update(index_elements=["campaign_sequence", "stage"], set_={"document": dict(document)})
    )


def get(connection: Connection, campaign_sequence: int, stage: StageName) -> dict[str, Any] | None:
    """Returns the results of a stage so far; None before it begins."""
    query = select(studies.c.document).where(studies.c.campaign_sequence == campaign_sequence, studies.c.stage == stage)
    return connection.execute(query).scalar_one_or_none()


@dataclass(frozen=True, slots=True)
class StoredStudy:
    """A study with its maker's `spec` and `resolution`."""

    campaign_sequence: int
    campaign: str
    name: str
    stage: StageName
    state: str
    spec: Mapping[str, Any]
    resolution: Mapping[str, Any] | None
    ended_at: datetime | None


def about(connection: Connection, campaign_id: str, campaign_sequence: int, influence_map_id: str | None) -> list[StoredStudy]:
    """The studies of a campaign's best sets, its predictions and the map that it uses, by any campaign, the newest first."""
    table = campaigns.c
    conditions = [
        (table.sequence == campaign_sequence,),
        (table.robustness_of == campaign_id, studies.c.stage == StageName.ROBUSTNESS),
        (table.validation_of == campaign_id, studies.c.stage == StageName.VALIDATION),
    ]
    if influence_map_id is not None:
        conditions.append((table.influence_map_id == influence_map_id, studies.c.stage == StageName.VALIDATION))
    made_by = studies.join(campaigns, studies.c.campaign_sequence == table.sequence)
    # A query for each, as each has its index: for all at once, a database reads every campaign.
    about_it = union(
        *(select(table.sequence, studies.c.stage).select_from(made_by).where(*each) for each in conditions)
    ).subquery("about_it")
    query = (
        select(campaigns, about_it.c.stage.label("made"))
        .select_from(about_it.join(campaigns, about_it.c.sequence == table.sequence))
        .order_by(table.sequence.desc(), about_it.c.stage)
    )
    rows = connection.execute(query)
    return [record(StoredStudy, row, campaign_sequence=row.sequence, campaign=row.id, stage=row.made) for row in rows]


def is_in_own_vehicle(study: StoredStudy, campaign: StoredCampaign) -> bool:
    """Returns whether a study drove the vehicle of the campaign whose results it is about, with equal parameters."""
    return bool(study.spec.get("vehicle") == campaign.spec.get("vehicle"))


@dataclass(frozen=True, slots=True)
class MapError:
    """Wrong answers of an influence map in a scenario, among the answers that a campaign's validation or audits compared."""

    campaign: str
    scenario: str
    wrong: int
    compared: int
    audited: bool


def errors_of_map(connection: Connection, influence_map_id: str, before: datetime) -> list[MapError]:
    """Returns the measured errors of a map's validations and audits, in campaigns that ended `before`, oldest first."""
    ended = campaigns.c.influence_map_id == influence_map_id, campaigns.c.ended_at < before
    audited = select(campaigns.c.id, campaigns.c.error_rate).where(*ended).order_by(campaigns.c.sequence)
    errors = [
        MapError(row.id, scenario, rate.wrong, rate.audited, audited=True)
        for row in connection.execute(audited)
        for scenario, rate in row.error_rate.items()
        if rate.wrong
    ]
    validated = (
        select(campaigns.c.id, studies.c.document)
        .select_from(studies.join(campaigns, studies.c.campaign_sequence == campaigns.c.sequence))
        .where(*ended, studies.c.stage == StageName.VALIDATION)
        .order_by(campaigns.c.sequence)
    )
    for row in connection.execute(validated):
        rows = [item for item in row.document.get("items", ()) if item["compared"] and item.get("released") is None]
        errors += [MapError(row.id, item["scenario"], item["wrong"], item["compared"], audited=False) for item in rows]
    return errors
