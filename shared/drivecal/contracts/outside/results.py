"""Look-ups of stored results."""

from typing import Annotated

from pydantic import Field

from drivecal.contracts.campaign import Answer, Score
from drivecal.contracts.specification import DEFAULT_PROBLEM, Model, Values, VehicleSpecification
from drivecal.contracts.strict_json import Identifier, ProblemName

MOST_CELLS = 10_000
"""Cells of a look-up."""


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
