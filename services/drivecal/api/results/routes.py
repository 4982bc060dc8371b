"""Results of a campaign: their document, and a chosen set as a file for calibration tools."""

from typing import Annotated

from fastapi import APIRouter, Query, Response

from drivecal.api.dependencies import DatabaseDependency, computed
from drivecal.api.http.bodies import StrictRoute
from drivecal.api.http.queries import ImportanceQuery, PlaceQuery
from drivecal.api.responses import calibration
from drivecal.api.results.calibration_file import CalibrationFileOf, written
from drivecal.api.results.document import about, results_of, setup_of, study_answer
from drivecal.api.tables.influence import importance
from drivecal.calibration_data.files import CalibrationFormat
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.contracts.campaign import StudyPage
from drivecal.contracts.results import CampaignResults, ImportanceAnswer
from drivecal.contracts.setup import CampaignSetup
from drivecal.storage import campaigns

router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["results"], route_class=StrictRoute)

MEDIA_TYPES: dict[CalibrationFormat, str] = {"dcm": "text/plain", "cdfx": "application/xml", "csv": "text/csv"}
CalibrationFileQuery = Annotated[CalibrationFileOf, Query()]


@router.get("/results")
@computed
def read_results(campaign_id: str, query: PlaceQuery, database: DatabaseDependency) -> CampaignResults:
    """The results of a campaign: what was asked for, what is best, what was checked and what is doubtful, and what it cost; the verdicts
    are about its best set, or about the set at a place of its search."""
    with database.read() as connection:
        campaign = calibration(campaigns.get(connection, campaign_id), ", which has no search")
    return results_of(database, campaign, place=query.place)


@router.get("/setup")
def setup(campaign_id: str, database: DatabaseDependency) -> CampaignSetup:
    """The parameters, versions and fingerprints that the campaign began with; while it is queued, the current ones."""
    with database.read() as connection:
        return setup_of(database, connection, calibration(campaigns.get(connection, campaign_id)))


@router.get("/importance")
@computed
def show_importance(campaign_id: str, query: ImportanceQuery, database: DatabaseDependency) -> ImportanceAnswer:
    """Dependence of the objective, or of the score of one scenario, on each parameter, among the sets of the search, under the campaign's
    weights and score or others."""
    with database.read() as connection:
        campaign = calibration(campaigns.get(connection, campaign_id), ", which has no search")
    return importance(database, campaign, resolved_spec(campaign).of_variant(query.variant), query)


@router.get("/studies")
def list_studies(campaign_id: str, database: DatabaseDependency) -> StudyPage:
    """The robustness and validation studies of its best sets and its map, also by other campaigns, newest first."""
    with database.read() as connection:
        campaign = calibration(campaigns.get(connection, campaign_id))
        made = about(connection, campaign)
    return StudyPage(items=[study_answer(study, campaign) for study in made])


@router.get(
    "/calibration-file",
    response_class=Response,
    responses={
        200: {"content": {type_: {"schema": {"type": "string"}} for type_ in MEDIA_TYPES.values()}, "description": "The file"}
    },
)
@computed
def calibration_file(campaign_id: str, query: CalibrationFileQuery, database: DatabaseDependency) -> Response:
    """A chosen set as a DCM, CDFX or CSV file (the latter without quality data): its values, how sure they are, and what is known of
    them."""
    content = written(database, campaign_id, query)
    field, rank = query.place
    name = f"{field}-{rank}-{campaign_id}.{query.format}"
    headers = {"Content-Disposition": f'attachment; filename="{name}"', "Cache-Control": "no-cache"}
    return Response(content, headers=headers, media_type=MEDIA_TYPES[query.format])
