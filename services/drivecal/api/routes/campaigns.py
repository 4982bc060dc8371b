"""Campaigns: submit, read, steer, run again."""

from functools import lru_cache
from typing import Annotated, Any

from fastapi import APIRouter, Header, Request, Response

from drivecal.api import expectation, submission
from drivecal.api.dependencies import DatabaseDependency, IntakeDependency
from drivecal.api.http.authorisation import refuse_others
from drivecal.api.http.bodies import StrictRoute
from drivecal.api.http.queries import CampaignsQuery, SubmissionQuery
from drivecal.api.live.dispatcher_health import silence
from drivecal.api.responses import ROOT, SECONDS_BETWEEN_POLLS, campaign_answer, etag, list_etag, matches
from drivecal.api.results.curves import shapes_with_good_sets
from drivecal.campaigns.results.front import StoredRanking
from drivecal.contracts.campaign import Campaign, CampaignPage, ExpectedRuns
from drivecal.contracts.specification import CampaignChanges, CampaignSpecification, RerunSpecification
from drivecal.domain.campaigns import Action
from drivecal.storage import campaigns, revision_queries
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now
from drivecal.storage.maintenance import deletion

router = APIRouter(prefix="/campaigns", tags=["campaigns"], route_class=StrictRoute)

NOT_MODIFIED: dict[int | str, dict[str, Any]] = {304: {"description": "Not changed since"}}
IfNoneMatch = Annotated[str | None, Header(max_length=10_000)]


@router.post("", status_code=202, responses={200: {"model": ExpectedRuns}, 202: {"model": Campaign}}, response_model=None)
def submit(
    specification: CampaignSpecification, query: SubmissionQuery, response: Response, intake: IntakeDependency
) -> Campaign | ExpectedRuns:
    """Queues a campaign; with `validate_only=true` checks it, counts its runs and stores nothing."""
    if query.validate_only:
        response.status_code = 200
        return expectation.expected(intake.database, intake.limits, specification)
    stored = submission.submit(intake.database, intake.limits, specification, intake.key, intake.owner)
    return accepted(response, intake.database, stored)


@router.get("", response_model=CampaignPage, responses=NOT_MODIFIED)
def list_campaigns(query: CampaignsQuery, database: DatabaseDependency, if_none_match: IfNoneMatch = None) -> Response:
    """Campaigns, newest first. The page has an `ETag`, as a campaign has."""
    moment = now()
    page_of: dict[str, Any] = {"state": query.state, "limit": query.limit, "cursor": query.cursor}
    page_of["conditions"] = campaigns.having(query.tag)
    with database.read() as connection:
        seen = revision_queries.page(connection, **page_of)
        silent = silence(revision_queries.heartbeat(connection), moment)
        headers = {"ETag": list_etag(seen, silent), "Cache-Control": "no-cache"}
        if matches(if_none_match, headers["ETag"]):
            return Response(status_code=304, headers=headers)
        stored, following = campaigns.page(connection, **page_of)
    page = CampaignPage(items=[campaign_answer(campaign, moment, silent) for campaign in stored], next_cursor=following)
    return Response(page.model_dump_json(), headers=headers, media_type="application/json")


@router.get("/{campaign_id}", response_model=Campaign, responses=NOT_MODIFIED)
def read(campaign_id: str, database: DatabaseDependency, if_none_match: IfNoneMatch = None) -> Response:
    """A campaign. With its `ETag` as `If-None-Match` the answer is 304 while nothing changes."""
    moment = now()
    with database.read() as connection:
        seen, heartbeat_at = revision_queries.campaign_revision(connection, campaign_id)
        silent = silence(heartbeat_at, moment)
        tag = etag(seen, silent)
        headers = {"ETag": tag, "Cache-Control": "no-cache"}
        if not seen.state.ended:
            headers["Retry-After"] = str(SECONDS_BETWEEN_POLLS)
        if matches(if_none_match, tag):
            return Response(status_code=304, headers=headers)
        stored = campaigns.by_sequence(connection, seen.sequence)
    answer = campaign_answer(stored, moment, silent)
    if answer.curves and stored.state.ended:
        for name, good in _good_sets(database, stored.id, stored.revision).items():
            answer.curves[name]["good"] = good
    return Response(answer.model_dump_json(), headers=headers, media_type="application/json")


@lru_cache(maxsize=256)
def _good_sets(database: Database, ended: str, _revision: int) -> dict[str, Any]:
    """Returns the range of good sets of each curve of an ended campaign: a ranking takes long, and the campaign's `ETag` stays."""
    shapes = shapes_with_good_sets(StoredRanking.of(database, database.query(campaigns.get, ended)))
    return {name: shape.good for name, shape in shapes.items()}


@router.patch("/{campaign_id}")
def change(
    campaign_id: str, changes: CampaignChanges, request: Request, response: Response, database: DatabaseDependency
) -> Campaign:
    """Changes name or tags of a campaign. Fields that are left out stay."""
    with database.transaction() as connection:
        refuse_others(request, campaign_id, campaigns.get(connection, campaign_id).owner)
        stored = campaigns.change_labels(connection, campaign_id, changes)
    return accepted(response, database, stored)


@router.delete("/{campaign_id}", status_code=204)
def delete(campaign_id: str, request: Request, database: DatabaseDependency) -> None:
    """Deletes an ended campaign; its cells go in the minutes after. 409 names the campaigns that refer to it, if there are any. What it
    simulated stays in the reference table. Deleting again changes nothing."""
    with database.transaction() as connection:
        refuse_others(request, campaign_id, campaigns.get(connection, campaign_id, deleted=True).owner)
        deletion.delete_campaign(connection, campaign_id)


@router.post("/{campaign_id}/pause", status_code=202)
def pause(campaign_id: str, request: Request, response: Response, database: DatabaseDependency) -> Campaign:
    """Pauses a campaign; running simulations are finished and kept. Asking again changes nothing."""
    return _asked(database, campaign_id, "pause", request, response)


@router.post("/{campaign_id}/resume", status_code=202)
def resume(campaign_id: str, request: Request, response: Response, database: DatabaseDependency) -> Campaign:
    """Resumes a paused campaign. Asking again changes nothing."""
    return _asked(database, campaign_id, "resume", request, response)


@router.post("/{campaign_id}/cancel", status_code=202)
def cancel(campaign_id: str, request: Request, response: Response, database: DatabaseDependency) -> Campaign:
    """Asks for a campaign to end; finished results are kept. Asking again changes nothing."""
    return _asked(database, campaign_id, "cancel", request, response)


@router.post("/{campaign_id}/rerun", status_code=202)
def rerun(campaign_id: str, changes: RerunSpecification, response: Response, intake: IntakeDependency) -> Campaign:
    """Queues a new campaign on the references and the influence map of an ended one."""
    stored = submission.rerun(intake.database, intake.limits, campaign_id, changes, intake.key, intake.owner)
    return accepted(response, intake.database, stored)


def _asked(database: Database, campaign_id: str, action: Action, request: Request, response: Response) -> Campaign:
    with database.transaction() as connection:
        refuse_others(request, campaign_id, campaigns.get(connection, campaign_id, lock=True).owner)
        stored = campaigns.request_action(connection, campaign_id, action)
    return accepted(response, database, stored)


def accepted(response: Response, database: Database, stored: StoredCampaign) -> Campaign:
    """Returns the answer for a campaign that was queued, or received a request."""
    response.headers["Location"] = f"{ROOT}/campaigns/{stored.id}"
    moment = now()
    return campaign_answer(stored, moment, silence(database.query(revision_queries.heartbeat), moment))
