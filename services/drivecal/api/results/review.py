"""The data of a review sheet, from the functions behind the other answers, and what a calibration file needs of them."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import TypeVar
from urllib.parse import urlencode

from drivecal.api.responses import ROOT, calibration
from drivecal.api.results.document import results_of
from drivecal.api.tables.front import front_table, summary
from drivecal.api.tables.ranking import ranking
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.campaigns.results.front import baseline_of, front_of
from drivecal.contracts.tables import FrontRow, Solution
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.report.data import RankedIn, Review, ReviewedSet, ScoreOrigin
from drivecal.storage import campaigns, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import runs

Ranked = TypeVar("Ranked", Solution, FrontRow)

LARGEST_RANK = 10**6
_AGAINST = re.compile(r"(?:(?P<campaign>[0-9A-Za-z-]{8,64})(?::(?P<rank>[1-9][0-9]{0,5}))?|(?P<own>[1-9][0-9]{0,5}))")


@dataclass(frozen=True, slots=True)
class Choice:
    """A set by its campaign, its table, by default that of its kind of campaign, and its rank."""

    campaign: str
    table: RankedIn | None
    rank: int
    field: str = "set"


def review_of(database: Database, choice: Choice, against: str | None) -> Review:
    """Returns the data of a sheet. Raises NotFoundError for an unknown campaign, InvalidInputError for a set that it does not have, and
    ConflictError for a comparison or a single evaluation."""
    first = _reviewed(database, choice)
    if against is None:
        sets = {"chosen": first}
        named = {}
    else:
        second = _reviewed(database, _other(against, first))
        sets = {"A": first, "B": second}
        named = {"against": f"{second.id}:{second.chosen.rank}"}
    field = "front" if first.table == "front" else "set"
    query = f"/campaigns/{first.id}/review?{urlencode({field: str(first.chosen.rank)} | named, safe=':')}"
    return Review(sets, query, version("drivecal"))


def _other(against: str, first: ReviewedSet) -> Choice:
    given = _AGAINST.fullmatch(against)
    if given is None:
        remedy = f"a rank, the id of a campaign, or ID:RANK as in GET {ROOT}/campaigns/ID/review?against=ID:2"
        raise InvalidInputError(Problem("against", "it names no set", remedy))
    if given["own"] is not None:
        return Choice(first.id, first.table, int(given["own"]), "against")
    return Choice(given["campaign"], first.table, int(given["rank"] or 1), "against")


def _reviewed(database: Database, choice: Choice) -> ReviewedSet:
    with database.read() as connection:
        stored = calibration(campaigns.get(connection, choice.campaign), ", which ranks nothing")
    resolved = resolved_spec(stored)
    front = front_of(database, stored, resolved)
    several = len(front.goals.objectives) > 1
    table: RankedIn = choice.table or ("front" if several else "solutions")
    rows = front_table(database, stored, front) if several or table == "front" else ()
    chosen: Solution | FrontRow
    if table == "front":
        chosen = of_rank(rows, choice, stored.id, table)
    else:
        ranked = ranking(database, stored, resolved, None)
        chosen = of_rank(ranked.solutions(choice.rank - 1, choice.rank), choice, stored.id, table)
    place = (chosen.iteration or 0, chosen.individual or 0)  # both are known: no set of another campaign is among them
    return ReviewedSet(
        results=results_of(database, stored, front, place),
        table=table,
        chosen=chosen,
        cells=_cells(database, stored, chosen),
        summary=summary(front, baseline_of(database, stored, front)),
        front=rows if several else (),
    )


def of_rank(listed: Sequence[Ranked], choice: Choice, campaign: str, table: RankedIn) -> Ranked:
    """Returns the row of the choice's rank. Raises InvalidInputError if there is none."""
    for row in listed:
        if row.rank == choice.rank:
            return row
    remedy = f"drivecal {table} {campaign} lists those that it has"
    raise InvalidInputError(Problem(choice.field, f"campaign {campaign} has no set of rank {choice.rank}", remedy))


def _cells(database: Database, stored: StoredCampaign, chosen: Solution | FrontRow) -> dict[str, ScoreOrigin]:
    """Returns the cells that the scores of a set are taken from, by scenario: that of another campaign if it simulated the cell later."""
    cells: dict[str, ScoreOrigin] = {}
    if chosen.iteration is None or chosen.individual is None:
        return cells
    with database.read() as connection:
        later = runs.simulated_later(connection, stored.sequence, resolved_spec(stored).evaluator)
        corrected = {(run.parameter_set, run.scenario): run for run in later}
        for scenario in chosen.scores:
            number = results.number_at(connection, stored.sequence, chosen.iteration, chosen.individual, scenario)
            cell = results.by_id(connection, number)
            outcome = "failed" if cell.outcome is None else cell.outcome.value
            run = corrected.get((cell.parameter_set_id, scenario))
            if cell.is_copied and scenario not in chosen.reused and run is not None:
                cells[scenario] = ScoreOrigin(run.evaluation, "later", run.campaign)
            else:
                cells[scenario] = ScoreOrigin(number, outcome)
    return cells
