"""Evaluations behind the sets of the ranking."""

from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import Field, StringConstraints

from drivecal.api.dependencies import DatabaseDependency
from drivecal.api.http.queries import Parameters
from drivecal.contracts.evaluation import CellAnswer
from drivecal.storage import campaigns, results

router = APIRouter(prefix="/campaigns", tags=["page"])

Place = Annotated[int, Field(ge=0, le=2**31 - 1)]


class CellOf(Parameters):
    """A set of the ranking by `iteration` and `individual`, and a scenario."""

    iteration: Place
    individual: Place
    scenario: Annotated[str, StringConstraints(min_length=1, max_length=200)]


@router.get("/{campaign_id}/cell")
def find_cell(campaign_id: str, query: Annotated[CellOf, Query()], database: DatabaseDependency) -> CellAnswer:
    """The evaluation by which the set at a place of the calibration stage is ranked."""
    with database.read() as connection:
        campaign = campaigns.get(connection, campaign_id)
        evaluation = results.number_at(connection, campaign.sequence, query.iteration, query.individual, query.scenario)
    return CellAnswer(evaluation=evaluation)
