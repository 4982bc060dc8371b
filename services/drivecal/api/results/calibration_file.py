"""A chosen set as a file for calibration tools."""

from collections.abc import Sequence
from typing import Annotated, TypeVar

from pydantic import Field, StringConstraints

from drivecal.api.http.queries import RankedOf
from drivecal.api.responses import calibration
from drivecal.api.results.document import results_of
from drivecal.api.tables.front import front_table
from drivecal.api.tables.ranking import ranking
from drivecal.calibration_data.chosen import characteristics_of, curves_of, figures_of, quality_of
from drivecal.calibration_data.files import CalibrationFormat, labels_of, write
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.campaigns.results.front import front_of
from drivecal.contracts.assignments import assignments, settings
from drivecal.contracts.tables import FrontRow, Solution
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.storage import campaigns
from drivecal.storage.engine.database import Database

Ranked = TypeVar("Ranked", Solution, FrontRow)

LARGEST_RANK = 10**6
Rank = Annotated[int, Field(ge=1, le=LARGEST_RANK)]


class CalibrationFileOf(RankedOf):
    """A set: of rank `set` in the solutions, or of rank `front` on the front; without either the first of the front if the campaign has
    several objectives, else of the solutions. It is ranked by `weights` and, in the solutions, by another `score` or for a `variant`.
    `label`: a name in the file for a parameter, such as `P1=ACC_tGap_C`; others keep their names."""

    rank: Annotated[Rank | None, Field(alias="set")] = None
    front: Rank | None = None
    format: CalibrationFormat
    label: Annotated[list[Annotated[str, StringConstraints(max_length=300)]], Field(max_length=2000, default_factory=list)]

    @property
    def place(self) -> tuple[str, int]:
        """The field that names the rank, and the rank."""
        return ("set", self.rank or 1) if self.front is None else ("front", self.front)


def written(database: Database, campaign: str, query: CalibrationFileOf) -> bytes:
    """Returns the file of a campaign's set.

    Raises NotFoundError for an unknown campaign, InvalidInputError for a set that it does not have and unusable options, and
    ConflictError for a single evaluation.
    """
    if query.rank is not None and query.front is not None:
        raise InvalidInputError(Problem("front", "a set is of the solutions or of the front", "give set or front"))
    with database.read() as connection:
        stored = calibration(campaigns.get(connection, campaign), ", which ranks nothing")
    resolved = resolved_spec(stored).of_variant(query.variant)
    front = front_of(database, stored, resolved)
    on_front = query.front is not None or (query.rank is None and len(front.goals.objectives) > 1)
    if on_front and query.score is not None:
        raise InvalidInputError(Problem("score", "a front has no single score", "give set, the rank in the solutions"))
    given = None if query.weights is None else assignments(query.weights.split(","), "weights")
    chosen: Solution | FrontRow
    if on_front:
        chosen = _ranked(front_table(database, stored, front, query.weights), query, stored.id, "front")
    else:
        _, rank = query.place
        ranked = ranking(database, stored, resolved, query.weights, query.score)
        chosen = _ranked(ranked.solutions(rank - 1, rank), query, stored.id, "solutions")
    known = results_of(database, stored, front, (chosen.iteration, chosen.individual))
    figures = [*figures_of(known, chosen, given, query.score), *([("variant", query.variant)] if query.variant else [])]
    shapes = known.setup.shapes
    coefficients = {name for shape in shapes.values() for name in shape.names}
    parameters = [parameter for parameter in known.setup.parameters if parameter.name not in coefficients]
    named = labels_of(settings(query.label, "label"), [*shapes, *(parameter.name for parameter in parameters)])
    content = characteristics_of(chosen.parameters, parameters, named) + curves_of(chosen.parameters, shapes, named)
    return write(query.format, content, quality_of(known, chosen, figures))


def _ranked(listed: Sequence[Ranked], query: CalibrationFileOf, campaign: str, table: str) -> Ranked:
    """Returns the row of the wanted rank. Raises InvalidInputError if there is none."""
    field, rank = query.place
    for row in listed:
        if row.rank == rank:
            return row
    remedy = f"drivecal {table} {campaign} lists those that it has"
    raise InvalidInputError(Problem(field, f"campaign {campaign} has no set of rank {rank}", remedy))
