"""The front of a campaign: the compromises between its objectives."""

from fastapi import APIRouter, Response

from drivecal.api.dependencies import Accept, DatabaseDependency
from drivecal.api.http.bodies import StrictRoute
from drivecal.api.http.queries import FrontQuery, SummaryQuery, TradeOffQuery
from drivecal.api.responses import calibration
from drivecal.api.routes.tables import kinds_of
from drivecal.api.tables.front import FrontTable, front_table, summary, trade_off
from drivecal.api.tables.paging import page_or_file, slices, table_answer
from drivecal.campaigns.resolve.resolved_spec import ResolvedSpec, resolved_spec
from drivecal.campaigns.results.front import front_of
from drivecal.contracts.results import FrontSummary, TradeOff
from drivecal.contracts.tables import FrontRow, Kind, columns_of
from drivecal.storage import campaigns
from drivecal.storage.engine.database import Database

router = APIRouter(prefix="/campaigns/{campaign_id}/front", tags=["results"], route_class=StrictRoute)


@router.get("", responses=page_or_file(FrontRow))
def list_front(campaign_id: str, query: FrontQuery, database: DatabaseDependency, accept: Accept = "*/*") -> Response:
    """The sets that no other evaluated set dominates, each vector of objectives once; best first objective first, or best first under
    `weights`. Without objectives of its own, a campaign's only one is the weighted score."""
    table, resolved = _table(database, campaign_id, query.weights, everything=query.everything)
    keys: dict[str, list[str] | dict[str, Kind]] = {
        "objectives": [goal.name for goal in table.front.goals.objectives],
        "scores": list(resolved.weights),
        "parameters": kinds_of(resolved.space),
    }
    pages = slices(lambda start, stop: table.rows[start:stop], len(table.rows))
    columns = columns_of(FrontRow, keys, whole_scores=resolved.scale.is_whole)
    return table_answer(f"front-{campaign_id}", query, accept, lambda: columns, pages)


@router.get("/summary")
def show_summary(campaign_id: str, query: SummaryQuery, database: DatabaseDependency) -> FrontSummary:
    """Objectives with their ranges on the front, its knee and extremes, and the hypervolume after each iteration."""
    table, _ = _table(database, campaign_id, None, everything=query.everything)
    return summary(table.front)


@router.get("/trade-off")
def show_trade_off(campaign_id: str, query: TradeOffQuery, database: DatabaseDependency) -> TradeOff:
    """How two sets of the front differ, by their ranks under the same `weights`."""
    table, resolved = _table(database, campaign_id, query.weights, everything=query.everything)
    return trade_off(table, resolved, query.first, query.second)


def _table(database: Database, campaign_id: str, weights: str | None, *, everything: bool) -> tuple[FrontTable, ResolvedSpec]:
    with database.read() as connection:
        campaign = campaigns.get(connection, campaign_id)
    resolved = resolved_spec(calibration(campaign, ", which has no front"))
    front = front_of(database, campaign, resolved, everything=everything)
    return front_table(database, campaign, front, weights), resolved
