"""A chosen set as a file for calibration tools."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

from drivecal.api.responses import calibration
from drivecal.api.results.document import results_of
from drivecal.api.tables.front import front_table
from drivecal.api.tables.ranking import ranking
from drivecal.calibration_data.chosen import characteristics_of, figures_of, quality_of
from drivecal.calibration_data.files import CalibrationFormat, labels_of, write
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.campaigns.results.front import front_of
from drivecal.contracts.assignments import assignments
from drivecal.contracts.strict_json import shown
from drivecal.contracts.tables import FrontRow, Solution
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.storage import campaigns
from drivecal.storage.engine.database import Database

RankedIn = Literal["solutions", "front"]
Ranked = TypeVar("Ranked", Solution, FrontRow)

LARGEST_RANK = 10**6


@dataclass(frozen=True, slots=True)
class Choice:
    """A set by its campaign, its table, by default that of its kind of campaign, and its rank."""

    campaign: str
    table: RankedIn | None
    rank: int
    field: str = "set"


@dataclass(frozen=True, slots=True)
class RankedOtherwise:
    """Weights and score that a set is chosen by, each None for the campaign's own."""

    weights: str | None = None
    score: str | None = None


def written(database: Database, choice: Choice, form: CalibrationFormat, by: RankedOtherwise, labels: Sequence[str]) -> bytes:
    """Returns the file of a set. `labels`: names for parameters, `P1=ACC_tGap_C`. Raises
    NotFoundError for an unknown campaign, InvalidInputError for a set that it does not have and unusable options, and ConflictError for
    a comparison or a single evaluation."""
    with database.read() as connection:
        stored = calibration(campaigns.get(connection, choice.campaign), ", which ranks nothing")
    resolved = resolved_spec(stored)
    front = front_of(database, stored, resolved)
    table = choice.table or ("front" if len(front.goals.objectives) > 1 else "solutions")
    _check(table, by)
    given = None if by.weights is None else assignments(by.weights.split(","), "weights")
    chosen: Solution | FrontRow
    if table == "front":
        chosen = of_rank(front_table(database, stored, front, by.weights), choice, stored.id, table)
    else:
        ranked = ranking(database, stored, resolved, by.weights, by.score)
        chosen = of_rank(ranked.solutions(choice.rank - 1, choice.rank), choice, stored.id, table)
    known = results_of(database, stored, front, (chosen.iteration, chosen.individual))
    figures = figures_of(known, chosen, given, by.score)
    parameters = known.setup.parameters
    named = labels_of(_document(labels), [parameter.name for parameter in parameters])
    return write(form, characteristics_of(chosen.parameters, parameters, named), quality_of(known, chosen, figures))


def of_rank(listed: Sequence[Ranked], choice: Choice, campaign: str, table: RankedIn) -> Ranked:
    """Returns the row of the choice's rank. Raises InvalidInputError if there is none."""
    for row in listed:
        if row.rank == choice.rank:
            return row
    remedy = f"drivecal {table} {campaign} lists those that it has"
    raise InvalidInputError(Problem(choice.field, f"campaign {campaign} has no set of rank {choice.rank}", remedy))


def _check(table: str, by: RankedOtherwise) -> None:
    if by.score is not None and table != "solutions":
        raise InvalidInputError(Problem("score", "a front has no single score", "give set, the rank in the solutions"))


def _document(labels: Sequence[str]) -> dict[str, str]:
    """Returns labels as a file of names has them. Raises InvalidInputError for two of one parameter."""
    document = dict[str, str]()
    for text in labels:
        name, _, label = text.partition("=")
        if name in document:
            raise InvalidInputError(Problem("label", f"{shown(name)} has two labels", "give it one"))
        document[name] = label
    return document
