"""Places in the page: evaluations behind the sets of the ranking, and saved views."""

from typing import Annotated

from fastapi import APIRouter, Query, Response
from pydantic import StringConstraints

from drivecal.api.dependencies import DatabaseDependency
from drivecal.api.http.bodies import StrictRoute
from drivecal.api.http.queries import Parameters, Place, ViewsQuery
from drivecal.api.responses import ROOT
from drivecal.contracts.evaluation import CellNumber
from drivecal.contracts.organising import SavedView, SavedViewChanges, SavedViewList, SavedViewSpecification
from drivecal.storage import campaigns, results, saved_views
from drivecal.storage.saved_views import StoredView

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


@router.get("/views")
def list_views(query: ViewsQuery, database: DatabaseDependency) -> SavedViewList:
    """The saved views for all campaigns, and with `campaign` also its own, by name."""
    with database.read() as connection:
        listed = saved_views.listed(connection, query.campaign)
    return SavedViewList(items=[_view(stored) for stored in listed])


@router.post("/views", status_code=201)
def save_view(view: SavedViewSpecification, response: Response, database: DatabaseDependency) -> SavedView:
    """Saves a view, in place of an earlier one of the same name and campaign."""
    with database.transaction() as connection:
        if view.campaign is not None:
            campaigns.get(connection, view.campaign)
        stored = saved_views.save(connection, view.campaign or "", view.name, view.address)
    response.headers["Location"] = f"{ROOT}/views/{stored.id}"
    return _view(stored)


@router.patch("/views/{view_id}")
def rename_view(view_id: str, changes: SavedViewChanges, database: DatabaseDependency) -> SavedView:
    """Renames a saved view."""
    with database.transaction() as connection:
        return _view(saved_views.rename(connection, view_id, changes.name))


@router.delete("/views/{view_id}", status_code=204)
def remove_view(view_id: str, database: DatabaseDependency) -> None:
    """Removes a saved view. Removing it again changes nothing."""
    with database.transaction() as connection:
        saved_views.remove(connection, view_id)


def _view(stored: StoredView) -> SavedView:
    return SavedView.of(stored, campaign=stored.campaign or None)
