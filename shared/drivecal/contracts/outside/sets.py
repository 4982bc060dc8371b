"""Sets that an outside optimizer proposes to a campaign, and their answers."""

from collections import Counter
from typing import Annotated

from pydantic import Field, StringConstraints, field_validator

from drivecal.contracts.campaign import Answer, Score, SearchEnd
from drivecal.contracts.specification import Model, Values
from drivecal.contracts.strict_json import Identifier

MOST_SETS = 1_000
"""Sets of a request."""
Key = Annotated[str, StringConstraints(min_length=1, max_length=200, pattern=r"^[A-Za-z0-9_:~-][A-Za-z0-9._:~-]*$")]
"""Letters, digits and `._:~-`, no point first, so that it can stand in a URL."""


class ProposedSet(Model):
    """A parameter set. Values between grid points become the nearest ones."""

    key: Key
    """Name of the set in the campaign; the same set under the same key is one set, however often it is sent."""
    parameters: Values
    scenarios: Annotated[list[Identifier], Field(min_length=1, max_length=1000)] | None = None
    """Null: all scenarios of the campaign."""
    replicates: Annotated[int, Field(ge=1, le=1000)] = 1
    """Runs in each scenario, under the seeds 1, 2, ...; above 1 only of a random simulator."""


class ProposedSets(Model):
    """Sets that are stored together or not at all."""

    sets: Annotated[list[ProposedSet], Field(min_length=1, max_length=MOST_SETS)]

    @field_validator("sets")
    @classmethod
    def _each_key_once(cls, value: list[ProposedSet]) -> list[ProposedSet]:
        [(key, count)] = Counter(each.key for each in value).most_common(1)
        if count > 1:
            raise ValueError(f"the key {key} is given twice; give each set a key of its own")
        return value


class AcceptedSets(Answer):
    """Stored sets: their `numbers` in the campaign by key; `changed` has the values of sets that were rounded or repaired.

    `weights` has the share of each scenario in the objective. `notes` name lists that coefficients give only nearly.
    """

    numbers: dict[str, int]
    weights: dict[str, float]
    changed: dict[str, dict[str, float | str]]
    notes: list[str]


class CancelledSet(Answer):
    """A set whose cancellation was requested; not `cancelled` if its cells were asked for already: they are finished."""

    key: str
    number: int
    cancelled: bool


class CellAnswered(Answer):
    """The answer of a cell. `number` is its place among the answers of the campaign, `set` the number of its set.

    `seed`: the seed of its run, 0 if the simulator does not depend on one.

    `wrong_at_most`: expected share of wrong answers among all with this `outcome`; 0 for runs of the very cell, null
    without a result. `metrics`: the measures of the run, null without one.
    """

    number: int
    set: int
    key: str
    parameters: dict[str, float | str]
    scenario: str
    seed: int
    evaluation: int
    outcome: str
    score: Score | None
    rating: float | None
    metrics: dict[str, float | None] | None
    failure: str | None
    detail: str | None
    reference: int | None
    wrong_at_most: float | None


class AnswerPage(Answer):
    """Answers by arrival. Ask next for those after `last`.

    `state` is that of the campaign, `ended_by` why its search ended: then no further cell is asked for. Once it `is_complete`, no answer
    follows.
    """

    items: list[CellAnswered]
    last: int
    state: str
    ended_by: SearchEnd | None
    is_complete: bool
