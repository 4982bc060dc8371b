"""Outside optimizers: they propose sets to a campaign and take its answers."""

import asyncio
import time
from functools import lru_cache
from typing import Annotated, cast

from fastapi import APIRouter, Query, Request, Response
from fastapi.concurrency import run_in_threadpool
from pydantic import Field

from drivecal.api.dependencies import DatabaseDependency, EventStreamPlace
from drivecal.api.http.authorisation import refuse_others
from drivecal.api.http.bodies import StrictRoute
from drivecal.api.http.queries import Parameters
from drivecal.api.live.streams import EventHub
from drivecal.api.responses import calibration
from drivecal.api.routes.campaigns import accepted
from drivecal.campaigns.resolve.outside import indices_of
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.resolve.resolved_spec import problem_of
from drivecal.campaigns.resolve.workbench import stored_bundles
from drivecal.contracts.campaign import Campaign
from drivecal.contracts.outside.sets import AcceptedSets, AnswerPage, CancelledSet, Key, ProposedSets
from drivecal.domain.errors import Diagnostics
from drivecal.storage import campaigns
from drivecal.storage.engine.database import Database
from drivecal.storage.outside import answers as outside_answers
from drivecal.storage.outside import sets as outside_sets
from drivecal.storage.outside.sets import OutsideSet

router = APIRouter(prefix="/campaigns", tags=["campaigns"], route_class=StrictRoute)

LOOK_SECONDS, LONGEST_LOOK = 0.05, 0.5
"""Interval of checks for new answers while a request waits: a tenth of the time without one, between these."""


@router.post("/{campaign_id}/sets", status_code=202)
def propose(campaign_id: str, proposed: ProposedSets, request: Request, database: DatabaseDependency) -> AcceptedSets:
    """Takes sets of an outside optimizer. They are stored before the answer; sending them again, with the same keys, changes nothing."""
    campaign_id = database.query(campaigns.get, campaign_id).id
    problem = _problem(database, campaign_id)
    diagnostics = Diagnostics()
    indices = indices_of(problem, proposed.sets, diagnostics)
    listed = [each.scenarios and [name for name in problem.scenarios if name in each.scenarios] for each in proposed.sets]
    sets = [
        OutsideSet(each.key, row, names, each.replicates)
        for each, row, names in zip(proposed.sets, indices.tolist(), listed, strict=True)
    ]
    with database.transaction() as connection:
        campaign = outside_sets.external_campaign(connection, campaign_id)
        refuse_others(request, campaign_id, campaign.owner)
        numbers = outside_sets.add(connection, campaign, sets)
    changed, shapes = {}, problem.bench.bundle.manifest.shapes
    for each, made in zip(proposed.sets, problem.space.parameter_sets(indices), strict=True):
        taken = made.floats | {name: shape.values(made.floats) for name, shape in shapes.items()}
        if any(taken[name] != value for name, value in each.parameters.items()):
            changed[each.key] = made.floats
    return AcceptedSets(numbers=numbers, weights=dict(problem.weights), changed=changed, notes=diagnostics.notes)


@lru_cache(maxsize=64)
def _problem(database: Database, campaign_id: str) -> CalibrationProblem:
    """Returns the problem of a campaign that others feed. It takes longer to resolve than a request may wait, and never changes."""
    with database.transaction() as connection:
        campaign = outside_sets.external_campaign(connection, campaign_id)
    return cast("CalibrationProblem", problem_of(campaign, stored_bundles(database)))  # no single evaluation


class AnswersQuery(Parameters):
    """Which answers to return."""

    after: Annotated[int, Field(ge=0, le=2**31 - 1)] = 0
    """`last` of the answers before."""
    wait: Annotated[float, Field(ge=0, le=60)] = 0
    """Seconds to wait for an answer if there is none yet."""
    limit: Annotated[int, Field(ge=1, le=1000)] = 1000
    """Largest number of answers."""


@router.get("/{campaign_id}/answers")
async def answers(
    campaign_id: str,
    query: Annotated[AnswersQuery, Query()],
    request: Request,
    database: DatabaseDependency,
    place: EventStreamPlace,
) -> AnswerPage:
    """Answers of proposed sets, by cell, in the order of their arrival. Returns at once if there are some, or the search has ended."""
    del place  # held until the answer: a request that waits keeps no other from being answered
    hub: EventHub = request.app.state.event_hub
    begin = time.monotonic()
    while True:
        waited = time.monotonic() - begin
        page = await run_in_threadpool(_answers, database, campaign_id, query.after, query.limit)
        if page.items or page.is_complete or waited >= query.wait or hub.closed or await request.is_disconnected():
            return page
        await asyncio.sleep(min(LONGEST_LOOK, max(LOOK_SECONDS, waited / 10)))


def _answers(database: Database, campaign_id: str, after: int, limit: int) -> AnswerPage:
    with database.read() as connection:
        campaign = calibration(campaigns.get(connection, campaign_id))
        items = outside_answers.after(connection, campaign, after, limit)
    ended_by = None if campaign.search is None else campaign.search.ended_by
    is_over = campaign.state.ended or (ended_by is not None and campaign.cells.pending == 0)
    last = items[-1].number if items else after
    return AnswerPage(
        items=items, last=last, state=campaign.state, ended_by=ended_by, is_complete=is_over and len(items) < limit
    )


@router.delete("/{campaign_id}/sets/{key}")
def cancel_set(campaign_id: str, key: Key, request: Request, database: DatabaseDependency) -> CancelledSet:
    """Cancels a set, unless its cells were asked for already."""
    with database.transaction() as connection:
        refuse_others(request, campaign_id, campaigns.get(connection, campaign_id).owner)
        number, cancelled = outside_sets.cancel(connection, campaign_id, key)
    return CancelledSet(key=key, number=number, cancelled=cancelled)


@router.post("/{campaign_id}/finish", status_code=202)
def finish(campaign_id: str, request: Request, response: Response, database: DatabaseDependency) -> Campaign:
    """Ends a campaign as soon as the sets that it has are answered. Asking again changes nothing."""
    with database.transaction() as connection:
        campaign = outside_sets.external_campaign(connection, campaign_id)
        refuse_others(request, campaign_id, campaign.owner)
        stored = outside_sets.finish(connection, campaign)
    return accepted(response, database, stored)
