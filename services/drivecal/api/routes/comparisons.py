"""Comparisons of optimizers and reductions: submission of their campaigns, and the analysis."""

import uuid

from fastapi import APIRouter, Response

from drivecal.api import expectation, submission
from drivecal.api.dependencies import DatabaseDependency, IntakeDependency, computed
from drivecal.api.http.bodies import StrictRoute
from drivecal.api.http.queries import SubmissionQuery
from drivecal.api.responses import ROOT
from drivecal.campaigns.comparison import compared
from drivecal.contracts.comparison import Comparison, ComparisonSpecification, ExpectedComparison

router = APIRouter(prefix="/comparisons", tags=["comparisons"], route_class=StrictRoute)


@router.post(
    "", status_code=202, responses={200: {"model": ExpectedComparison}, 202: {"model": Comparison}}, response_model=None
)
def submit(
    specification: ComparisonSpecification, query: SubmissionQuery, response: Response, intake: IntakeDependency
) -> Comparison | ExpectedComparison:
    """Queues the campaigns of a comparison, all or none; they have its tag. With `validate_only=true` checks it, counts its runs and stores
    nothing."""
    if query.validate_only:
        response.status_code = 200
        return expectation.expected_comparison(intake.database, intake.limits, specification)
    tag = submission.compare(intake.database, intake.limits, specification, intake.key or uuid.uuid4().hex, intake.owner)
    response.headers["Location"] = f"{ROOT}/comparisons/{tag}"
    return intake.database.query(compared, tag)


@router.get("/{tag:path}")
@computed
def compare(tag: str, database: DatabaseDependency) -> Comparison:
    """Compares the campaigns with a tag, as far as they are: by optimizer, population size and reduction. Campaigns of one
    problem can be compared: give them a common tag."""
    return database.query(compared, tag)
