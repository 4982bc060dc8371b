"""Places in the page: evaluations behind the sets of the ranking."""

from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import StringConstraints

from drivecal.api.dependencies import DatabaseDependency
from drivecal.api.http.bodies import StrictRoute
from drivecal.api.http.queries import Parameters, Place
from drivecal.contracts.evaluation import CellNumber
from drivecal.storage import campaigns, results

router = APIRouter(tags=["page"], route_class=StrictRoute)


class CellOf(Parameters):
    """A set of the ranking by `iteration` and `individual`, and a scenario."""

    iteration: Place
    individual: Place
    scenario: Annotated[str, StringConstraints(min_length=1, max_length=200)]


@router.get("/campaigns/{campaign_id}/cell")
def find_cell(campaign_id: str, query: Annotated[CellOf, Query()], database: DatabaseDependency) -> CellNumber:
    """The evaluation that ranks the set at a place of the calibration stage."""
    with database.read() as connection:
        campaign = campaigns.get(connection, campaign_id)
        evaluation = results.number_at(connection, campaign.sequence, query.iteration, query.individual, query.scenario)
    return CellNumber(evaluation=evaluation)
