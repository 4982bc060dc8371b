"""Tables of a campaign, as pages of JSON or whole in CSV and Parquet."""

from collections.abc import Iterable

from fastapi import APIRouter, Response
from pydantic import BaseModel

from drivecal.api.dependencies import Accept, DatabaseDependency, computed
from drivecal.api.http.bodies import StrictRoute
from drivecal.api.http.queries import CellQuery, EvaluationsQuery, FrontQuery, SolutionsQuery, SummaryQuery, TableQuery
from drivecal.api.responses import calibration, evaluation_row
from drivecal.api.tables import influence
from drivecal.api.tables.front import front_table, judged_sets, summary, weighted
from drivecal.api.tables.paging import listed, page_or_file, slices, table_answer
from drivecal.api.tables.ranking import ranking_of, solution_pages
from drivecal.api.tables.selection import Row
from drivecal.campaigns.resolve.resolved_spec import ResolvedSpec, resolved_spec, specification_of
from drivecal.campaigns.resolve.workbench import find_workbench, stored_bundles
from drivecal.campaigns.results.front import CampaignFront, front_of
from drivecal.contracts.evaluation import CellNumber
from drivecal.contracts.results import FrontSummary
from drivecal.contracts.tables import (
    Column,
    EvaluationRow,
    FrontRow,
    Generation,
    InfluenceRow,
    JudgedSet,
    Kind,
    RobustnessRow,
    Solution,
    ValidationRow,
    columns_of,
    measure_column,
)
from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import Diagnostics
from drivecal.domain.parameters import ParameterSpace
from drivecal.storage import campaigns, evaluations, generations, results, studies
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import influence_maps

router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["results"], route_class=StrictRoute)


@router.get("/generations", responses=page_or_file(Generation))
def list_generations(campaign_id: str, query: TableQuery, database: DatabaseDependency, accept: Accept = "*/*") -> Response:
    """The iterations of the calibration stage, in order."""
    campaign = _campaign(database, campaign_id)

    def pages(limit: int, cursor: str | None) -> tuple[list[Generation], str | None]:
        with database.read() as connection:
            campaigns.get(connection, campaign.id)  # a file of a campaign that is deleted meanwhile breaks off
            return generations.page(connection, campaign.sequence, limit=limit, cursor=cursor)

    return table_answer(f"generations-{campaign.id}", query, accept, lambda: columns_of(Generation), pages)


@router.get("/evaluations", responses=page_or_file(EvaluationRow))
def list_evaluations(
    campaign_id: str, query: EvaluationsQuery, database: DatabaseDependency, accept: Accept = "*/*"
) -> Response:
    """Requested cells, ordered by stage, iteration, individual and scenario; with `measures` also the measures of their runs,
    or of the runs that answered them."""
    campaign = _campaign(database, campaign_id)
    measures = list[str]()
    if query.measures and campaign.kind != "evaluation":
        measures += find_workbench(specification_of(campaign), stored_bundles(database), Diagnostics()).known.measures

    def pages(limit: int, cursor: str | None) -> tuple[list[Row], str | None]:
        with database.read() as connection:
            campaigns.get(connection, campaign.id)  # as above
            page, following = results.page(connection, campaign.sequence, limit=limit, cursor=cursor)
            cells = {evaluation.id: evaluation.run_id for evaluation in page} if measures else {}
            stored = evaluations.measured(connection, cells)
        known = ((each, stored.get(each.id) or {}) for each in page)  # a cell without a run has no measures
        return [
            evaluation_row(each) | {measure_column(name): run.get(name) for name in measures} for each, run in known
        ], following

    def columns() -> list[Column]:
        return _evaluation_columns(database, campaign) + [Column(measure_column(name), "number") for name in measures]

    return table_answer(f"evaluations-{campaign.id}", query, accept, columns, pages)


@router.get("/cell")
def find_cell(campaign_id: str, query: CellQuery, database: DatabaseDependency) -> CellNumber:
    """The evaluation behind the score of the set at a place of the calibration stage, and its evaluations by seed."""
    with database.read() as connection:
        campaign = campaigns.get(connection, campaign_id)
        cells = results.cells_at(connection, campaign.sequence, query.iteration, query.individual, query.scenario)
    return CellNumber(evaluation=next(iter(cells.values())), runs=[run for run in cells.items() if run[0] > 0])


@router.get("/solutions", responses=page_or_file(Solution))
@computed
def list_solutions(campaign_id: str, query: SolutionsQuery, database: DatabaseDependency, accept: Accept = "*/*") -> Response:
    """The evaluated parameter sets, best first, under the campaign's weights and score or others. Nothing is simulated for it."""
    stored = ranking_of(database, campaign_id, ", which ranks nothing")
    ranked = solution_pages(stored.under(stored.resolved.of_variant(query.variant)), query.weights, query.score)
    columns = ranked_columns(Solution, ranked.scenarios, ranked.resolved)
    return table_answer(
        f"solutions-{stored.campaign.id}", query, accept, lambda: columns, slices(ranked.solutions, len(ranked))
    )


@router.get("/influence", responses=page_or_file(InfluenceRow))
def list_influence(campaign_id: str, query: TableQuery, database: DatabaseDependency, accept: Accept = "*/*") -> Response:
    """The influence map that the campaign uses: one row per scenario and searched parameter, none if it has no map (yet)."""
    campaign = _campaign(database, campaign_id)
    rows: list[InfluenceRow] = []
    if campaign.influence_map_id is not None:
        stored = database.query(influence_maps.get, campaign.influence_map_id)
        rows = influence.campaign_rows(stored, _pinned(campaign))
    return listed(f"influence-{campaign.id}", query, accept, columns_of(InfluenceRow), rows)


@router.get("/robustness", responses=page_or_file(RobustnessRow))
def list_robustness(campaign_id: str, query: TableQuery, database: DatabaseDependency, accept: Accept = "*/*") -> Response:
    """The best sets by how far the vehicle may differ before they lose what makes them good: most robust first, the recommended one
    marked with the reason. None before the robustness stage."""
    campaign = _campaign(database, campaign_id)
    begun_with = _pinned(campaign)
    columns = ranked_columns(RobustnessRow, begun_with.weights, begun_with)
    rows = _study(database, campaign, StageName.ROBUSTNESS, RobustnessRow)
    return listed(f"robustness-{campaign.id}", query, accept, columns, rows)


@router.get("/validation", responses=page_or_file(ValidationRow))
def list_validation(campaign_id: str, query: TableQuery, database: DatabaseDependency, accept: Accept = "*/*") -> Response:
    """Share of answers that differ although the influence map excludes it, by scenario. None before the
    validation stage."""
    campaign = _campaign(database, campaign_id)
    rows = _study(database, campaign, StageName.VALIDATION, ValidationRow)
    return listed(f"validation-{campaign.id}", query, accept, columns_of(ValidationRow), rows)


def _study(database: Database, campaign: StoredCampaign, stage: StageName, model: type[BaseModel]) -> list[BaseModel]:
    stored = database.query(studies.get, campaign.sequence, stage)
    return [] if stored is None else [model.model_validate(item) for item in stored["items"]]


def ranked_columns(model: type[BaseModel], scenarios: Iterable[str], begun_with: ResolvedSpec) -> list[Column]:
    """Returns the columns of a file with a column for each score and parameter."""
    keys: dict[str, list[str] | dict[str, Kind]] = {
        "constraints": begun_with.goals.bound_names,
        "scores": list(scenarios),
        "parameters": kinds_of(begun_with.space),
    }
    return columns_of(model, keys, whole_scores=begun_with.scale.is_whole)


def kinds_of(space: ParameterSpace) -> dict[str, Kind]:
    """Returns the types of the parameters' columns."""
    return {parameter.name: "text" if parameter.choices else "number" for parameter in space.parameters}


def _campaign(database: Database, campaign_id: str) -> StoredCampaign:
    return database.query(campaigns.get, campaign_id)


def _pinned(campaign: StoredCampaign) -> ResolvedSpec:
    return resolved_spec(calibration(campaign, ", which ranks nothing"))


def _evaluation_columns(database: Database, campaign: StoredCampaign) -> list[Column]:
    """Returns the columns of a file, with the parameters of the first row, or, without a row, of the rows to come."""
    rows, _ = database.query(results.page, campaign.sequence, limit=1)
    begun_with = resolved_spec(campaign)
    kinds = kinds_of(begun_with.space)
    if rows:
        values = rows[0].parameters.floats
        kinds = {name: "text" if isinstance(value, str) else "number" for name, value in values.items()}
    return EvaluationRow.file_columns(kinds, whole_scores=begun_with.scale.is_whole)


@router.get("/front", responses=page_or_file(FrontRow))
@computed
def list_front(campaign_id: str, query: FrontQuery, database: DatabaseDependency, accept: Accept = "*/*") -> Response:
    """The sets that no other evaluated set dominates, each vector of objectives once; best first objective first, or best first under
    `weights`. Without objectives of its own, a campaign's only one is the weighted score."""
    front = _front(database, campaign_id)
    rows, resolved = front_table(front, query.weights), front.stored.resolved
    keys: dict[str, list[str] | dict[str, Kind]] = {
        "objectives": [goal.name for goal in front.goals.objectives],
        "uncertainty": list(next(iter(front.uncertainty.values()), {})),
        "constraints": front.goals.bound_names,
        "scores": list(resolved.weights),
        "values": front.goals.value_names,
        "answers": list(resolved.weights),
        "parameters": kinds_of(resolved.space),
    }
    columns = columns_of(FrontRow, keys, whole_scores=resolved.scale.is_whole)
    return listed(f"front-{campaign_id}", query, accept, columns, rows)


@router.get("/front/summary")
@computed
def show_summary(campaign_id: str, query: SummaryQuery, database: DatabaseDependency) -> FrontSummary:
    """Objectives with their ranges on the front, ranks of its knee and extremes (under `weights`, if given), and its growth by
    iteration."""
    return summary(weighted(_front(database, campaign_id), query.weights)[0])


@router.get("/front/evaluated", responses=page_or_file(JudgedSet))
@computed
def list_evaluated(campaign_id: str, query: TableQuery, database: DatabaseDependency, accept: Accept = "*/*") -> Response:
    """All sets that have a value of every objective, dominated ones as well, in the order of the ranking."""
    front = _front(database, campaign_id)
    rows = judged_sets(front)
    columns = columns_of(JudgedSet, {"objectives": [goal.name for goal in front.goals.objectives]})
    return listed(f"evaluated-{campaign_id}", query, accept, columns, rows)


def _front(database: Database, campaign_id: str) -> CampaignFront:
    return front_of(ranking_of(database, campaign_id, ", which has no front"))
