"""A chosen set of a campaign: one page to check, print and sign, and a file for calibration tools."""

from typing import Annotated

from fastapi import APIRouter, Query, Response
from pydantic import Field, StringConstraints

from drivecal.api.dependencies import DatabaseDependency, computed
from drivecal.api.http.bodies import StrictRoute
from drivecal.api.http.queries import Parameters, SummaryOf
from drivecal.api.review.calibration_file import RankedOtherwise, written
from drivecal.api.review.collected import LARGEST_RANK, Choice, review_of
from drivecal.calibration_data.files import CalibrationFormat
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.report.review.data import RankedIn
from drivecal.storage import campaigns

router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["results"], route_class=StrictRoute)

POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-cache",
}
MEDIA_TYPES: dict[CalibrationFormat, str] = {"dcm": "text/plain", "cdfx": "application/xml", "csv": "text/csv"}
Rank = Annotated[int, Field(ge=1, le=LARGEST_RANK)]


class SetOf(Parameters):
    """A set: of rank `set` in the solutions, or of rank `front` on the front; without either the first of the front if the campaign has
    several objectives, else of the solutions."""

    rank: Annotated[Rank | None, Field(alias="set")] = None
    front: Rank | None = None

    def choice(self, campaign_id: str) -> Choice:
        """Returns the set. Raises InvalidInputError for two ranks."""
        if self.rank is not None and self.front is not None:
            raise InvalidInputError(Problem("front", "a set is of the solutions or of the front", "give set or front"))
        table: RankedIn | None = "front" if self.front is not None else "solutions" if self.rank is not None else None
        return Choice(campaign_id, table, self.front or self.rank or 1, "set" if self.front is None else "front")


class ReviewOf(SetOf):
    """A set, and `against` it another one: a rank in the same table, a campaign's id, or `ID:RANK`."""

    against: Annotated[str, StringConstraints(max_length=80)] | None = None


class CalibrationFileOf(SetOf, SummaryOf):
    """A set, ranked by `weights` and, in the solutions, by another `score`, as in those tables. `label`: a name in the file for a
    parameter, such as `P1=ACC_tGap_C`; others keep their names."""

    format: CalibrationFormat
    score: Annotated[str, StringConstraints(max_length=300)] | None = None
    label: Annotated[list[Annotated[str, StringConstraints(max_length=300)]], Field(max_length=2000, default_factory=list)]


ReviewQuery = Annotated[ReviewOf, Query()]
CalibrationFileQuery = Annotated[CalibrationFileOf, Query()]


@router.get(
    "/review",
    response_class=Response,
    responses={200: {"content": {"text/html": {"schema": {"type": "string"}}}, "description": "The sheet"}},
)
@computed
def review(campaign_id: str, query: ReviewQuery, database: DatabaseDependency) -> Response:
    """A chosen set as one page without scripts and other files: question, values, result against the baseline, origin of each score,
    confidence, and the digest of its content. Equal results give equal bytes."""
    from drivecal.report.review.page import sheet  # Jinja, for this answer only

    with database.read() as connection:
        campaigns.get(connection, campaign_id)
    page = sheet(review_of(database, query.choice(campaign_id), query.against))
    return Response(page, headers=HEADERS, media_type="text/html")


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
    choice = query.choice(campaign_id)
    content = written(
        database, choice, query.format, RankedOtherwise(query.weights, query.score), query.label, everything=query.everything
    )
    name = f"{choice.field}-{choice.rank}-{campaign_id}.{query.format}"
    headers = {"Content-Disposition": f'attachment; filename="{name}"', "Cache-Control": "no-cache"}
    return Response(content, headers=headers, media_type=MEDIA_TYPES[query.format])
