"""The front of a campaign: the compromises between its objectives."""

from fastapi import APIRouter, Response

from drivecal.api.computed import computed
from drivecal.api.dependencies import Accept, DatabaseDependency
from drivecal.api.http.bodies import StrictRoute
from drivecal.api.http.queries import EvaluatedQuery, FrontQuery, SummaryQuery, TradeOffQuery
from drivecal.api.responses import calibration
from drivecal.api.routes.tables import kinds_of
from drivecal.api.tables.front import front_table, judged_sets, summary, trade_off, weighted
from drivecal.api.tables.paging import page_or_file, slices, table_answer
from drivecal.campaigns.resolve.resolved_spec import ResolvedSpec, resolved_spec
from drivecal.campaigns.results.front import CampaignFront, baseline_of, front_of
from drivecal.contracts.results import FrontSummary, TradeOff
from drivecal.contracts.tables import FrontRow, JudgedSet, Kind, columns_of
from drivecal.storage import campaigns
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database

router = APIRouter(prefix="/campaigns/{campaign_id}/front", tags=["results"], route_class=StrictRoute)


@router.get("", responses=page_or_file(FrontRow))
@computed
def list_front(campaign_id: str, query: FrontQuery, database: DatabaseDependency, accept: Accept = "*/*") -> Response:
    """The sets that no other evaluated set dominates, each vector of objectives once; best first objective first, or best first under
    `weights`. Without objectives of its own, a campaign's only one is the weighted score."""
    campaign, resolved, front = _front(database, campaign_id, everything=query.everything)
    rows = front_table(database, campaign, front, query.weights)
    keys: dict[str, list[str] | dict[str, Kind]] = {
        "objectives": [goal.name for goal in front.goals.objectives],
        "constraints": front.goals.bound_names,
        "scores": list(resolved.weights),
        "values": front.goals.value_names,
        "answers": list(resolved.weights),
        "parameters": kinds_of(resolved.space),
    }
    pages = slices(lambda start, stop: rows[start:stop], len(rows))
    columns = columns_of(FrontRow, keys, whole_scores=resolved.scale.is_whole)
    return table_answer(f"front-{campaign_id}", query, accept, lambda: columns, pages)


@router.get("/summary")
@computed
def show_summary(campaign_id: str, query: SummaryQuery, database: DatabaseDependency) -> FrontSummary:
    """Objectives with their ranges on the front, ranks of its knee and extremes (under `weights`, if given), and the hypervolume after each
    iteration."""
    campaign, _, front = _front(database, campaign_id, everything=query.everything)
    return summary(weighted(front, query.weights)[0], baseline_of(database, campaign, front))


@router.get("/evaluated", responses=page_or_file(JudgedSet))
@computed
def list_evaluated(campaign_id: str, query: EvaluatedQuery, database: DatabaseDependency, accept: Accept = "*/*") -> Response:
    """All sets that have a value of every objective, dominated ones as well, in the order of the ranking."""
    _, _, front = _front(database, campaign_id, everything=query.everything)
    rows = judged_sets(front)
    columns = columns_of(JudgedSet, {"objectives": [goal.name for goal in front.goals.objectives]})
    pages = slices(lambda start, stop: rows[start:stop], len(rows))
    return table_answer(f"evaluated-{campaign_id}", query, accept, lambda: columns, pages)


@router.get("/trade-off")
@computed
def show_trade_off(campaign_id: str, query: TradeOffQuery, database: DatabaseDependency) -> TradeOff:
    """Differences of two sets of the front, by their ranks under the same `weights`."""
    _, resolved, front = _front(database, campaign_id, everything=query.everything)
    return trade_off(database, weighted(front, query.weights)[0], resolved, query.first, query.second)


def _front(database: Database, campaign_id: str, *, everything: bool) -> tuple[StoredCampaign, ResolvedSpec, CampaignFront]:
    with database.read() as connection:
        campaign = campaigns.get(connection, campaign_id)
    resolved = resolved_spec(calibration(campaign, ", which has no front"))
    return campaign, resolved, front_of(database, campaign, resolved, everything=everything)
