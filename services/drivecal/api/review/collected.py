"""The data of a review sheet, from the functions behind the other answers, and what a calibration file needs of them."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import TypeVar
from urllib.parse import urlencode

from drivecal.api.responses import ROOT, calibration, campaign_answer
from drivecal.api.routes import background
from drivecal.api.tables.chosen import set_at
from drivecal.api.tables.front import front_table, summary
from drivecal.api.tables.ranking import ranking
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.campaigns.results.front import baseline_of, front_of
from drivecal.contracts.campaign import Study, StudyName
from drivecal.contracts.tables import FrontRow, RobustnessRow, Solution, ValidationRow
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.report.data import Row, Studied
from drivecal.report.review.data import RankedIn, Review, ReviewedSet, ScoreOrigin
from drivecal.storage import campaigns, results, studies
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now
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
        named = {"against": f"{second.campaign.id}:{second.chosen.rank}"}
    field = "front" if first.table == "front" else "set"
    query = f"/campaigns/{first.campaign.id}/review?{urlencode({field: str(first.chosen.rank)} | named, safe=':')}"
    return Review(sets, query, version("drivecal"))


def _other(against: str, first: ReviewedSet) -> Choice:
    given = _AGAINST.fullmatch(against)
    if given is None:
        remedy = f"a rank, the id of a campaign, or ID:RANK as in GET {ROOT}/campaigns/ID/review?against=ID:2"
        raise InvalidInputError(Problem("against", "it names no set", remedy))
    if given["own"] is not None:
        return Choice(first.campaign.id, first.table, int(given["own"]), "against")
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
    made = background.list_studies(stored.id, database).items
    baseline = baseline_of(database, stored, front)
    place = (chosen.iteration or 0, chosen.individual or 0)  # both are known: no set of another campaign is among them
    in_question = set_at(database, stored, front, place, baseline)
    return ReviewedSet(
        campaign=campaign_answer(stored, now(), silent=None),
        setup=background.setup(stored.id, database),
        table=table,
        chosen=chosen,
        cells=_cells(database, stored, chosen),
        summary=summary(front, baseline),
        trust=background.trust_in(database, stored.id, front, in_question),
        front=rows if several else (),
        robustness=studied_by(database, made, "robustness", RobustnessRow),
        validation=studied_by(database, made, "validation", ValidationRow),
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
            if not cell.is_copied or scenario in chosen.reused:
                cells[scenario] = ScoreOrigin(number, outcome)
            elif run is not None:
                cells[scenario] = ScoreOrigin(run.evaluation, "later", run.campaign)
            else:  # a certificate says which run it repeats
                cells[scenario] = ScoreOrigin(number, "certified")
    return cells


def studied_by(database: Database, made: list[Study], stage: StudyName, model: type[Row]) -> list[Studied[Row]]:
    """Returns the rows of those studies that succeeded, each with its study."""
    studied = []
    for study in made:
        if study.stage == stage and study.state == CampaignState.SUCCEEDED:
            with database.read() as connection:
                sequence = campaigns.get(connection, study.campaign).sequence
                document = studies.get(connection, sequence, StageName(stage)) or {"items": []}
            rows = [model.model_validate(item) for item in document["items"]]
            studied += [Studied(study, rows)] if rows else []
    return studied
