"""What a campaign found, as pages of JSON or as whole tables in CSV and Parquet."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

from fastapi import APIRouter, Response

from drivecal.api.dependencies import Accept, DatabaseDependency
from drivecal.api.http.bodies import StrictRoute
from drivecal.api.http.queries import SolutionsQuery, TableQuery, form_of
from drivecal.api.responses import evaluation_row, parameter_column, refuse_comparison
from drivecal.api.tables import influence, studies
from drivecal.api.tables.files import TABLE_ANSWERS, Column, Row
from drivecal.api.tables.paging import Page, slices, table_answer
from drivecal.api.tables.ranking import CampaignRanking, ranking
from drivecal.campaigns.resolve.resolved_spec import ResolvedSpec, resolved_spec
from drivecal.campaigns.results.optima import alternatives
from drivecal.contracts.campaign import Solution
from drivecal.domain.campaigns import StageName
from drivecal.domain.errors import ConflictError
from drivecal.storage import campaigns, generations, results
from drivecal.storage import studies as stored_studies
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import influence_maps

router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["results"], route_class=StrictRoute)


@router.get("/generations", responses=TABLE_ANSWERS)
def list_generations(campaign_id: str, query: TableQuery, database: DatabaseDependency, accept: Accept = "*/*") -> Response:
    """The iterations of the calibration stage, in order."""
    campaign = _campaign(database, campaign_id)

    def pages(limit: int, cursor: str | None) -> Page:
        with database.read() as connection:
            found, following = generations.page(connection, campaign.sequence, limit=limit, cursor=cursor)
        return [{"iteration": iteration, **asdict(figures)} for iteration, figures in found], following

    def columns() -> list[Column]:
        numbers = ("best", "rating", "mean", "minimum")
        names = ["iteration", *generations.Figures.__dataclass_fields__]
        return [Column(name, "number" if name in numbers else "integer") for name in names]

    return table_answer(f"generations-{campaign.id}", query, accept, columns, pages)


@router.get("/evaluations", responses=TABLE_ANSWERS)
def list_evaluations(campaign_id: str, query: TableQuery, database: DatabaseDependency, accept: Accept = "*/*") -> Response:
    """One row per requested cell, ordered by stage, iteration, individual and scenario. `reference` is the evaluation that answered it,
    or that its audit did not trust; `proven_by` the one whose run a certificate says that it repeats: it answered certified cells, was
    checked by a simulation where `proof_agrees` is not null, and says of reused cells what a simulation would have given."""
    campaign = _campaign(database, campaign_id)

    def pages(limit: int, cursor: str | None) -> Page:
        with database.read() as connection:
            found, following = results.page(connection, campaign.sequence, limit=limit, cursor=cursor)
        return [evaluation_row(one) for one in found], following

    def columns() -> list[Column]:
        return [
            Column("id", "integer"),
            Column("stage", "text"),
            Column("iteration", "integer"),
            Column("individual", "integer"),
            Column("scenario", "text"),
            *(Column(parameter_column(name), "number") for name in _parameter_names(database, campaign)),
            Column("outcome", "text"),
            Column("score", "integer"),
            Column("rating", "number"),
            Column("reference", "integer"),
            Column("audited", "truth"),
            Column("agrees", "truth"),
            Column("failure", "text"),
            Column("milliseconds", "number"),
            Column("worker", "text"),
            Column("proven_by", "integer"),
            Column("proof_agrees", "truth"),
        ]

    return table_answer(f"evaluations-{campaign.id}", query, accept, columns, pages)


@router.get("/solutions", responses=TABLE_ANSWERS)
def list_solutions(campaign_id: str, query: SolutionsQuery, database: DatabaseDependency, accept: Accept = "*/*") -> Response:
    """The evaluated parameter sets, best first, under the campaign's weights or others. Nothing is simulated for it."""
    campaign = _campaign(database, campaign_id)
    begun_with = _pinned(campaign)
    ranked = ranking(database, campaign, begun_with.weights, query.weights)

    flat = form_of(query, accept) != "json"

    def rows(start: int, stop: int) -> list[Row]:
        return [_solution_row(one, flat=flat) for one in ranked.solutions(start, stop)]

    def columns() -> list[Column]:
        return _solution_columns(ranked, begun_with)

    return table_answer(f"solutions-{campaign.id}", query, accept, columns, slices(rows, len(ranked)))


@router.get("/optima", responses=TABLE_ANSWERS)
def list_optima(campaign_id: str, query: TableQuery, database: DatabaseDependency, accept: Accept = "*/*") -> Response:
    """The sets that share the best objective, the region of the space in which each lies, and how far the nearest worse set is; at
    most the first 10,000 of them."""
    campaign = _campaign(database, campaign_id)
    begun_with = _pinned(campaign)
    ranked = ranking(database, campaign, begun_with.weights, None)
    known, flat = alternatives(database, ranked.ranked, begun_with.space), form_of(query, accept) != "json"

    def rows(start: int, stop: int) -> list[Row]:
        found = zip(ranked.solutions(start, min(stop, len(known))), known.shown(start, stop), strict=True)
        return [{**_solution_row(one, flat=flat), "region": at.region, "to_worse": at.to_worse} for one, at in found]

    def columns() -> list[Column]:
        return [*_solution_columns(ranked, begun_with), Column("region", "integer"), Column("to_worse", "number")]

    return table_answer(f"optima-{campaign.id}", query, accept, columns, slices(rows, len(known)))


@router.get("/influence", responses=TABLE_ANSWERS)
def list_influence(campaign_id: str, query: TableQuery, database: DatabaseDependency, accept: Accept = "*/*") -> Response:
    """The influence map that the campaign uses: one row per scenario and searched parameter, none where it has no map (yet)."""
    campaign = _campaign(database, campaign_id)
    rows = _influence_rows(database, campaign)
    pages = slices(lambda start, stop: rows[start:stop], len(rows))
    return table_answer(f"influence-{campaign.id}", query, accept, lambda: influence.COLUMNS, pages)


@router.get("/robustness", responses=TABLE_ANSWERS)
def list_robustness(campaign_id: str, query: TableQuery, database: DatabaseDependency, accept: Accept = "*/*") -> Response:
    """The best sets by how far the vehicle may differ before they lose what makes them good: most robust first, the recommended one
    marked with the reason. None before the robustness stage."""
    campaign = _campaign(database, campaign_id)
    found, flat = _study(database, campaign, StageName.ROBUSTNESS), form_of(query, accept) != "json"
    begun_with = _pinned(campaign)

    def rows(start: int, stop: int) -> list[Row]:
        return [studies.robustness_row(one, flat=flat) for one in found[start:stop]]

    def columns() -> list[Column]:
        return studies.robustness_columns(list(begun_with.weights), begun_with.space.names)

    return table_answer(f"robustness-{campaign.id}", query, accept, columns, slices(rows, len(found)))


@router.get("/validation", responses=TABLE_ANSWERS)
def list_validation(campaign_id: str, query: TableQuery, database: DatabaseDependency, accept: Accept = "*/*") -> Response:
    """How often answers differ where the influence map says that they cannot, by scenario (Tables 1 and 2, Figure 14). None before the
    validation stage."""
    campaign = _campaign(database, campaign_id)
    found, flat = _study(database, campaign, StageName.VALIDATION), form_of(query, accept) != "json"

    def rows(start: int, stop: int) -> list[Row]:
        return [studies.validation_row(one, flat=flat) for one in found[start:stop]]

    return table_answer(f"validation-{campaign.id}", query, accept, studies.validation_columns, slices(rows, len(found)))


def _study(database: Database, campaign: StoredCampaign, stage: StageName) -> list[dict[str, Any]]:
    with database.read() as connection:
        found = stored_studies.get(connection, campaign.sequence, stage)
    items: list[dict[str, Any]] = [] if found is None else found["items"]
    return items


def _campaign(database: Database, campaign_id: str) -> StoredCampaign:
    with database.read() as connection:
        found = campaigns.get(connection, campaign_id)
    refuse_comparison(found)
    return found


def _pinned(campaign: StoredCampaign) -> ResolvedSpec:
    if campaign.kind != "calibration":
        raise ConflictError(f"{campaign.id} is a single evaluation, which ranks nothing; GET /api/v1/evaluations/{campaign.id}")
    return resolved_spec(campaign)


def _parameter_names(database: Database, campaign: StoredCampaign) -> Iterable[str]:
    """Those of the first row; of a campaign without rows yet, those it will have."""
    with database.read() as connection:
        rows, _ = results.page(connection, campaign.sequence, limit=1)
    return rows[0].parameters if rows else resolved_spec(campaign).space.names


def _solution_row(solution: Solution, *, flat: bool) -> Row:
    if not flat:
        return solution.model_dump(mode="json")
    row: dict[str, Any] = solution.model_dump(include={"rank", "objective", "rating", "iteration", "individual"})
    row |= {f"score_{name}": score for name, score in solution.scores.items()} | {"reused": " ".join(solution.reused)}
    return row | {parameter_column(name): value for name, value in solution.parameters.items()}


def _solution_columns(ranked: CampaignRanking, begun_with: ResolvedSpec) -> list[Column]:
    return [
        Column("rank", "integer"),
        Column("objective", "number"),
        Column("rating", "number"),
        *(Column(f"score_{name}", "integer") for name in ranked.scenarios),
        Column("reused", "text"),
        *(Column(parameter_column(name), "number") for name in begun_with.space.names),
        Column("iteration", "integer"),
        Column("individual", "integer"),
    ]


def _influence_rows(database: Database, campaign: StoredCampaign) -> list[Row]:
    if campaign.influence_map_id is None:
        return []
    with database.read() as connection:
        stored = influence_maps.get(connection, campaign.influence_map_id)
    return [row.model_dump(mode="json") for row in influence.campaign_rows(stored, _pinned(campaign))]
