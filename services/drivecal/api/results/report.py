"""The data and tables of a report, from stored rows."""

from collections.abc import Iterable, Iterator, Sequence

from pydantic import BaseModel
from sqlalchemy import Connection

from drivecal.api.responses import calibration
from drivecal.api.results.document import results_of
from drivecal.api.routes.tables import ranked_columns
from drivecal.api.tables.front import front_table
from drivecal.api.tables.influence import campaign_rows
from drivecal.api.tables.paging import ROWS_AT_A_TIME, csv_pieces
from drivecal.api.tables.ranking import CampaignRanking, ranking
from drivecal.campaigns.resolve.resolved_spec import ResolvedSpec, resolved_spec
from drivecal.campaigns.results.front import front_of
from drivecal.campaigns.results.optima import alternatives
from drivecal.contracts.tables import (
    Column,
    Generation,
    OptimumRow,
    RobustnessRow,
    Solution,
    ValidationRow,
    columns_of,
    file_row,
)
from drivecal.contracts.tables import InfluenceRow as Influence
from drivecal.report.data import RANKED, Report, ReportData
from drivecal.storage import campaigns, generations
from drivecal.storage.engine.database import Database
from drivecal.storage.references import influence_maps

MOST_GENERATIONS = 100_000


def report_of(database: Database, identifier: str) -> Report:
    """Returns the report of a campaign. Raises NotFoundError for an unknown one, ConflictError for a single evaluation."""
    with database.read() as connection:
        stored = calibration(campaigns.get(connection, identifier))
    resolved = resolved_spec(stored)
    several = bool(stored.spec.get("objectives")) and stored.best is not None
    front = front_of(database, stored, resolved) if several else None
    ranked = ranking(database, stored, resolved, None)
    with database.read() as connection:
        used = None if stored.influence_map_id is None else influence_maps.get(connection, stored.influence_map_id)
        iterations = _generations(connection, stored.sequence)
    data = ReportData(
        results=results_of(database, stored, front),
        generations=iterations,
        solutions=ranked.solutions(0, RANKED),
        optima=_optima(database, ranked, resolved),
        influence=[] if used is None else campaign_rows(used, resolved),
        basis=None if used is None else used.basis,
        front=() if front is None else front_table(database, stored, front),
    )
    sets = (ranked.solutions(start, start + ROWS_AT_A_TIME) for start in range(0, len(ranked), ROWS_AT_A_TIME))
    tables = {
        "generations": _csv(columns_of(Generation), [iterations]),
        "solutions": _csv(ranked_columns(Solution, ranked.scenarios, resolved), sets),
        "optima": _csv(ranked_columns(OptimumRow, ranked.scenarios, resolved), [data.optima]),
        "influence": _csv(columns_of(Influence), [data.influence]),
    }
    for study in data.results.of_stage("robustness")[:1]:
        tables["robustness"] = _csv(ranked_columns(RobustnessRow, resolved.weights, resolved), [study.robustness])
    for study in data.results.of_stage("validation")[:1]:
        tables["validation"] = _csv(columns_of(ValidationRow), [study.validation])
    return Report(data, tables)


def _generations(connection: Connection, sequence: int) -> list[Generation]:
    page, _ = generations.page(connection, sequence, limit=MOST_GENERATIONS)
    return [Generation(iteration=iteration, **figures.flat) for iteration, figures in page]


def _optima(database: Database, ranked: CampaignRanking, resolved: ResolvedSpec) -> list[OptimumRow]:
    if not len(ranked):
        return []
    known = alternatives(database, ranked.ranked, resolved.space)
    placed = zip(ranked.solutions(0, len(known)), known.shown(0, len(known)), strict=True)
    return [OptimumRow(**dict(solution), region=at.region, to_worse=at.to_worse) for solution, at in placed]


def _csv(columns: Sequence[Column], pieces: Iterable[Sequence[BaseModel]]) -> Iterator[bytes]:
    return csv_pieces(columns, ([file_row(row) for row in piece] for piece in pieces))
