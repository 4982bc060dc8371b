"""Parts of tests: what tests of the removal of old results ask of a database before and after."""

from typing import Any

from sqlalchemy import text
from tests.support.runs import get

from drivecal.api.tables.ranking import earlier_best, ranking
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.campaigns.results.explanation import explain
from drivecal.campaigns.results.verification import verify
from drivecal.storage import campaigns, generations, lots, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database

SPACE = [{"name": f"P{number}", "lower": 0, "upper": 1, "step": 0.25} for number in range(1, 12)]


def set_column(database: Database, campaign: StoredCampaign, column: str, value: object) -> None:
    with database.transaction() as connection:
        statement = text(f"UPDATE campaigns SET {column} = :value WHERE sequence = :number")
        connection.execute(statement, {"value": value, "number": campaign.sequence})


def answers(database: Database, campaign: StoredCampaign) -> tuple[Any, ...]:
    """What a campaign answers: its row and cells, its ranking, the references of its cells, and the best set of its first campaign."""
    stored = get(database, campaign)
    with database.read() as connection:
        cells = list(results.stream(connection, campaign.sequence))
        figures, _ = generations.page(connection, campaign.sequence, limit=1_000)
        corrected = list(results.answers(connection, campaign.sequence, cells[0].stage, corrected_by=evaluator(stored)))
        explained = [explain(connection, cell.id) for cell in cells if cell.reference is not None]
        inspected = lots.of_campaign(connection, campaign.sequence)
        first = None if stored.rerun_of is None else campaigns.get(connection, stored.rerun_of)
    ranked = ranking(database, stored, resolved_spec(stored), None)
    earlier = None if first is None else earlier_best(database, stored, first)
    return stored, cells, figures, corrected, explained, inspected, ranked.solutions(0, len(ranked)), earlier


def evaluator(campaign: StoredCampaign) -> str:
    return resolved_spec(campaign).evaluator


def problems(database: Database) -> list[str]:
    return [problem for verdict in verify(database, full=True) for problem in verdict.problems]
