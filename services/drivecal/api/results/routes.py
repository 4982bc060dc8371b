"""Results of a campaign: their document, and a chosen set as a file for calibration tools."""

from collections.abc import Sequence
from typing import Annotated

from fastapi import APIRouter, Query, Response
from pydantic import Field, StringConstraints

from drivecal.api.dependencies import DatabaseDependency, computed
from drivecal.api.http.bodies import StrictRoute
from drivecal.api.http.queries import ImportanceQuery, PlaceQuery, RankedOf
from drivecal.api.responses import calibration
from drivecal.api.results.document import about, results_of, setup_of, study_answer
from drivecal.api.tables.front import bound_text, front_table
from drivecal.api.tables.influence import importance
from drivecal.api.tables.ranking import ranking_of, solution_pages
from drivecal.calibration_data.chosen import characteristics_of, curves_of, figures_of, quality_of
from drivecal.calibration_data.files import CalibrationFormat, labels_of, write
from drivecal.campaigns.results.front import StoredRanking, front_of
from drivecal.contracts.assignments import assignments, settings
from drivecal.contracts.campaign import StudyPage
from drivecal.contracts.results import CampaignResults, ImportanceAnswer
from drivecal.contracts.setup import CampaignSetup
from drivecal.contracts.tables import FrontRow, Solution
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.storage import campaigns

router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["results"], route_class=StrictRoute)

MEDIA_TYPES: dict[CalibrationFormat, str] = {"dcm": "text/plain", "cdfx": "application/xml", "csv": "text/csv"}

LARGEST_RANK = 10**6
Rank = Annotated[int, Field(ge=1, le=LARGEST_RANK)]


class CalibrationFileOf(RankedOf):
    """A set: of rank `set` in the solutions, or of rank `front` on the front; without either the first of the front if the campaign has
    several objectives, else of the solutions. It is ranked by `weights` and, in the solutions, by another `score` or for a `variant`.
    `label`: a name in the file for a parameter, such as `P1=ACC_tGap_C`; others keep their names."""

    rank: Annotated[Rank | None, Field(alias="set")] = None
    front: Rank | None = None
    format: CalibrationFormat
    label: Annotated[list[Annotated[str, StringConstraints(max_length=300)]], Field(max_length=2000, default_factory=list)]


CalibrationFileQuery = Annotated[CalibrationFileOf, Query()]


@router.get("/results")
@computed
def read_results(campaign_id: str, query: PlaceQuery, database: DatabaseDependency) -> CampaignResults:
    """The results of a campaign: what was asked for, what is best, what was checked and what is doubtful, and what it cost; the verdicts
    are about its best set, or about the set at a place of its search."""
    return results_of(ranking_of(database, campaign_id, ", which has no search"), place=query.place)


@router.get("/setup")
@computed
def setup(campaign_id: str, database: DatabaseDependency) -> CampaignSetup:
    """The parameters, versions and fingerprints that the campaign began with; while it is queued, the current ones."""
    return setup_of(StoredRanking.of(database, calibration(database.query(campaigns.get, campaign_id))))


@router.get("/importance")
@computed
def show_importance(campaign_id: str, query: ImportanceQuery, database: DatabaseDependency) -> ImportanceAnswer:
    """Dependence of the objective, or of the score of one scenario, on each parameter, among the sets of the search, under the campaign's
    weights and score or others."""
    stored = ranking_of(database, campaign_id, ", which has no search")
    return importance(stored.under(stored.resolved.of_variant(query.variant)), query)


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
    if query.rank is not None and query.front is not None:
        raise InvalidInputError(Problem("front", "a set is of the solutions or of the front", "give set or front"))
    whole = ranking_of(database, campaign_id, ", which ranks nothing")
    stored = whole.campaign
    wanted = whole.under(whole.resolved.of_variant(query.variant))
    front = front_of(wanted)
    on_front = query.front is not None or (query.rank is None and len(front.goals.objectives) > 1)
    if on_front and query.score is not None:
        raise InvalidInputError(Problem("score", "a front has no single score", "give set, the rank in the solutions"))
    given = None if query.weights is None else assignments(query.weights.split(","), "weights")
    field, rank = ("front", query.front or 1) if on_front else ("set", query.rank or 1)
    rows: Sequence[Solution | FrontRow] = (
        front_table(front, query.weights)[rank - 1 : rank]
        if on_front
        else solution_pages(wanted, query.weights, query.score).solutions(rank - 1, rank)
    )
    if not rows:
        remedy = f"drivecal {'front' if on_front else 'solutions'} {stored.id} lists those that it has"
        raise InvalidInputError(Problem(field, f"campaign {stored.id} has no set of rank {rank}", remedy))
    chosen = rows[0]
    known = results_of(whole, front, (chosen.iteration, chosen.individual))
    held = [bound_text(bound) for bound in front.goals.bounds]  # a variant has the constraints of its scenarios
    known = known.model_copy(update={"setup": known.setup.model_copy(update={"constraints": held})})
    if given is None and query.variant is not None and not stored.spec.get("objectives"):
        given = next((each.scenarios for each in known.variants if each.name == query.variant), None)
    figures = [*figures_of(known, chosen, given, query.score), *([("variant", query.variant)] if query.variant else [])]
    shapes = known.setup.shapes
    parameters = [each for each in known.setup.parameters if not any(each.name in shape.names for shape in shapes.values())]
    named = labels_of(settings(query.label, "label"), [*shapes, *(parameter.name for parameter in parameters)])
    content = characteristics_of(chosen.parameters, parameters, named) + curves_of(chosen.parameters, shapes, named)
    name = f"{field}-{rank}-{campaign_id}.{query.format}"
    headers = {"Content-Disposition": f'attachment; filename="{name}"', "Cache-Control": "no-cache"}
    written = write(query.format, content, quality_of(known, chosen, figures))
    return Response(written, headers=headers, media_type=MEDIA_TYPES[query.format])
