"""Results from elsewhere, of a vehicle, a test bench or another tool, and look-ups of stored results."""

from contextlib import suppress
from datetime import date as Date  # noqa: N812  a field has this name
from typing import Annotated, Self

from pydantic import BeforeValidator, Field, model_validator

from drivecal.contracts.campaign import Answer, Score
from drivecal.contracts.specification import DEFAULT_PROBLEM, Model, Values, VehicleSpecification
from drivecal.contracts.strict_json import Identifier, Number, ProblemName, Source

MOST_CELLS = 10_000
"""Cells of a look-up."""


def _day(given: object) -> object:
    with suppress(ValueError):  # other texts are refused as what they are
        return Date.fromisoformat(given) if isinstance(given, str) else given
    return given


class ResultLookup(Model):
    """Parameter sets whose stored results are wanted, each in all scenarios of the catalogue. Nothing is simulated."""

    sets: Annotated[list[Annotated[Values, Field(min_length=1)]], Field(min_length=1, max_length=MOST_CELLS)]
    problem: ProblemName = DEFAULT_PROBLEM
    catalogue: Identifier | None = None
    driving_function: Identifier | None = None
    vehicle: VehicleSpecification = VehicleSpecification()
    evaluator: Identifier | None = None


class StoredCell(Answer):
    """The stored result of a cell. `set` is the place of its set in the request, from 0; `evaluation` the cell that simulated it."""

    set: int
    scenario: str
    evaluation: int
    score: Score
    rating: float
    failure: str | None
    metrics: dict[str, float | None]


class StoredCells(Answer):
    """The stored ones of the `requested` cells, with a score of the evaluator."""

    requested: int
    items: list[StoredCell]


MOST_ROWS = 10_000
"""Cells of a request."""


class ImportedCell(Model):
    """Values of a set in a scenario: scores, measures, or both."""

    parameters: Annotated[Values, Field(min_length=1)]
    scenario: Identifier
    scores: Annotated[dict[Identifier, Number], Field(max_length=200, default_factory=dict)]
    measures: Annotated[dict[Identifier, Number], Field(max_length=200, default_factory=dict)]

    @model_validator(mode="after")
    def _has_values(self) -> Self:
        if not self.scores and not self.measures:
            raise ValueError("it has neither scores nor measures")
        return self


class ImportedResults(Model):
    """Results of one source and day. Drivecal compares them with simulations, and never uses them in place of one."""

    problem: ProblemName
    source: Source
    date: Annotated[Date, BeforeValidator(_day)]
    units: Annotated[dict[Identifier, str], Field(max_length=600, default_factory=dict)]
    """Units of parameters and measures; they have to be the problem's own."""
    rows: Annotated[list[ImportedCell], Field(min_length=1, max_length=MOST_ROWS)]


class ImportAnswer(Answer):
    """How many cells are new, and how many were stored before with the same values; `notes` on lists that coefficients give only nearly,
    and on values outside of the ranges, which are stored as well."""

    stored: int
    known: int
    notes: list[str]


class ImportDeleted(Answer):
    """How many cells were deleted."""

    deleted: int
