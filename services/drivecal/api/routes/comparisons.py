"""Comparisons of optimizers and of reductions: submission and results."""

from fastapi import APIRouter, Response

from drivecal.api import comparison_submission
from drivecal.api.dependencies import Accept, DatabaseDependency, IdempotencyKey, LimitsDependency
from drivecal.api.http.bodies import StrictRoute
from drivecal.api.http.queries import SubmissionQuery, TableQuery
from drivecal.api.routes.campaigns import accepted
from drivecal.api.tables.paging import listed, page_or_file
from drivecal.campaigns.comparisons.results import ComparisonResults, compared
from drivecal.contracts.campaign import Campaign
from drivecal.contracts.comparison import (
    ComparedGroup,
    ComparedPair,
    ComparedRun,
    ComparisonSpecification,
    ExpectedComparison,
    ReductionEffect,
)
from drivecal.domain.errors import ConflictError
from drivecal.storage import campaigns
from drivecal.storage.engine.database import Database

router = APIRouter(tags=["comparisons"], route_class=StrictRoute)


@router.post(
    "/comparisons",
    status_code=202,
    responses={200: {"model": ExpectedComparison}, 202: {"model": Campaign}},
    response_model=None,
)
def submit(
    specification: ComparisonSpecification,
    query: SubmissionQuery,
    response: Response,
    database: DatabaseDependency,
    limits: LimitsDependency,
    idempotency_key: IdempotencyKey = None,
) -> Campaign | ExpectedComparison:
    """Queues a comparison: a campaign each of whose runs is one as well. With `validate_only=true` checks it, counts its runs and stores
    nothing."""
    if query.validate_only:
        response.status_code = 200
        return comparison_submission.expected(database, limits, specification)
    return accepted(response, database, comparison_submission.submit(database, limits, specification, idempotency_key))


@router.get("/campaigns/{campaign_id}/comparison", responses=page_or_file(ComparedRun))
def list_runs(campaign_id: str, query: TableQuery, database: DatabaseDependency, accept: Accept = "*/*") -> Response:
    """The runs of a comparison; `run` is the id of the campaign that holds all that it found."""
    return listed(f"comparison-{campaign_id}", query, accept, ComparedRun, _compared(database, campaign_id).runs())


@router.get("/campaigns/{campaign_id}/comparison-groups", responses=page_or_file(ComparedGroup))
def list_groups(campaign_id: str, query: TableQuery, database: DatabaseDependency, accept: Accept = "*/*") -> Response:
    """A row per optimizer, population size and reduction, over the seeds."""
    return listed(f"comparison-groups-{campaign_id}", query, accept, ComparedGroup, _compared(database, campaign_id).groups())


@router.get("/campaigns/{campaign_id}/comparison-pairs", responses=page_or_file(ComparedPair))
def list_pairs(campaign_id: str, query: TableQuery, database: DatabaseDependency, accept: Accept = "*/*") -> Response:
    """Each ended run beside the one that differs from it in the reduction alone; none if there is one reduction."""
    return listed(f"comparison-pairs-{campaign_id}", query, accept, ComparedPair, _compared(database, campaign_id).pairs())


@router.get("/campaigns/{campaign_id}/comparison-effects", responses=page_or_file(ReductionEffect))
def list_effects(campaign_id: str, query: TableQuery, database: DatabaseDependency, accept: Accept = "*/*") -> Response:
    """Effects over all pairs: whether a reduction changes the final optimum, and its savings."""
    rows = _compared(database, campaign_id).effects()
    return listed(f"comparison-effects-{campaign_id}", query, accept, ReductionEffect, rows)


def _compared(database: Database, campaign_id: str) -> ComparisonResults:
    with database.read() as connection:
        campaign = campaigns.get(connection, campaign_id)
        if campaign.kind != "comparison":
            raise ConflictError(f"{campaign_id} is not a comparison; POST /api/v1/comparisons makes one")
        return compared(connection, campaign)
