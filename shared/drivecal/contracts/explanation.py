"""Explanations why a cell was, or was not, answered without a simulation."""

from typing import Literal

from pydantic import Field

from drivecal.contracts.campaign import Answer, Score

Region = Literal["below", "influential", "above", "anywhere", "outside"]
"""Region of a value under the influence map: beyond the influential bounds, between them, `anywhere` if none exist, or `outside` of
the space that the map speaks of."""

Reason = Literal["repeated", "reused", "predicted", "simulated", "checked", "failed"]
"""Why a cell has its answer.

- `repeated`: a stored result of the same set.
- `reused`: a stored result of a set that differs only where it does not matter.
- `predicted`: released with its lot.
- `simulated`: nothing stored was near enough.
- `checked`: simulated to check an answer: an audit, a part of a lot's sample, or a confirmation of the best set.
- `failed`: no attempt gave a result.
"""


class Difference(Answer):
    """A parameter that differs between the cell and the stored set. `lower` and `upper` are the inclusive influential bounds of the map,
    null if it has none on that side. `blocks`: the two values do not lie in the same non-influential region."""

    parameter: str
    value: float | str
    reference_value: float | str
    region: Region
    reference_region: Region
    lower: float | None
    upper: float | None
    blocks: bool


class Reference(Answer):
    """A stored result: the evaluation that simulated it, its campaign's id, and what it gave (null while that is pending)."""

    evaluation: int
    campaign: str
    stage: str
    iteration: int
    individual: int
    score: Score | None
    failure: str | None
    claimed: list[str] = Field(default_factory=list)
    """Parameters of one set only: `added`, `removed` and `renamed` of problem.yaml say that both behave the same."""


class Check(Answer):
    """Comparison of a simulation with the answer that it checks.

    Attributes:
        expected: The score of the reference or the prediction.
        agrees: The scores are equal; null if one of the two has no result.
        wrong: They differ by more than the tolerance; null as above.
    """

    expected: Score | None
    agrees: bool | None
    wrong: bool | None


class InspectedLot(Answer):
    """A lot of predictions or reused answers: `sample` of `size` were simulated; with more than `acceptance` errors beyond the `tolerance`
    it is rejected.

    `limit` bounds the expected released errors for each answer in a lot, `known` counts the answers that the predictor had learned from
    (0 for references). `errors` and `verdict` (released or rejected) are null before the sample is simulated.
    """

    id: int
    size: int
    sample: int
    acceptance: int
    tolerance: float
    limit: float
    known: int
    errors: int | None
    verdict: str | None


class Prediction(Answer):
    """A prediction. `confidence`: the share of votes for scores within the tolerance, 0 to 1. `agrees` is true if the simulation
    of a sampled cell confirmed it."""

    score: Score
    confidence: float
    sampled: bool
    agrees: bool | None
    lot: InspectedLot | None


class Explanation(Answer):
    """Reason for the answer of a cell.

    `reference` is the donor (repeated, reused), the donor that is checked (checked), or the nearest stored set (simulated): fewest blocking
    parameters first, then the smallest distance. `distance` is that of the blocking parameters, in units of their ranges (Euclidean), and
    `stored` counts the results of the same setup that the campaign saw; both null if nothing was searched for.
    """

    evaluation: int
    campaign: str
    stage: str
    iteration: int
    individual: int
    scenario: str
    outcome: str | None
    score: Score | None
    failure: str | None
    parameters: dict[str, float | str] = Field(default_factory=dict)
    attempts: int = 0
    """Number of simulations that were tried."""
    detail: str | None = None
    """Report of the last attempt at a cell without a result."""
    reason: Reason
    sentence: str
    reference: Reference | None = None
    differences: list[Difference] = Field(default_factory=list)
    check: Check | None = None
    prediction: Prediction | None = None
    lot: InspectedLot | None = None
    """The lot of an answer by a reference; that of a predicted one is in `prediction`."""
    distance: float | None = None
    stored: int | None = None
