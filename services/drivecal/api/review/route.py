"""The review sheet of a campaign: a chosen set as one page to check, print and sign."""

from typing import Annotated

from fastapi import APIRouter, Query, Response
from pydantic import Field, StringConstraints

from drivecal.api.dependencies import DatabaseDependency
from drivecal.api.http.bodies import StrictRoute
from drivecal.api.http.queries import Parameters
from drivecal.api.review.collected import LARGEST_RANK, Choice, review_of
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
Rank = Annotated[int, Field(ge=1, le=LARGEST_RANK)]


class ReviewOf(Parameters):
    """A set: of rank `set` in the solutions, or of rank `front` on the front; without either the first of the front if the campaign has
    several objectives, else of the solutions. `against`: another set beside it: a rank in the same table, a campaign's id, or `ID:RANK`."""

    rank: Annotated[Rank | None, Field(alias="set")] = None
    front: Rank | None = None
    against: Annotated[str, StringConstraints(max_length=80)] | None = None


ReviewQuery = Annotated[ReviewOf, Query()]


@router.get(
    "/review",
    response_class=Response,
    responses={200: {"content": {"text/html": {"schema": {"type": "string"}}}, "description": "The sheet"}},
)
def review(campaign_id: str, query: ReviewQuery, database: DatabaseDependency) -> Response:
    """A chosen set as one page without scripts and other files: question, values, result against the baseline, origin of each score,
    confidence, and the digest of its content. Equal results give equal bytes."""
    from drivecal.report.review.page import sheet  # Jinja, for this answer only

    with database.read() as connection:
        campaigns.get(connection, campaign_id)
    if query.rank is not None and query.front is not None:
        raise InvalidInputError(Problem("front", "a set is of the solutions or of the front", "give set or front"))
    table: RankedIn | None = "front" if query.front is not None else "solutions" if query.rank is not None else None
    choice = Choice(campaign_id, table, query.front or query.rank or 1, "set" if query.front is None else "front")
    page = sheet(review_of(database, choice, query.against))
    return Response(page, headers=HEADERS, media_type="text/html")
