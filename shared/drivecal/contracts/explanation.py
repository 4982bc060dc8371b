"""Explanations why a cell was, or was not, answered without a simulation."""

from typing import Literal

from pydantic import Field

from drivecal.contracts.campaign import Answer

Region = Literal["below", "influential", "above", "anywhere", "outside"]
"""Region of a value under the influence map: beyond the influential bounds, between them, `anywhere` where none exist, or `outside` of
the space that the map speaks of."""

Reason = Literal[
    "repeated",
    "reused",
    "certified",
    "audited",
    "confirmation",
    "blocked",
    "nothing_stored",
    "unanswered",
    "stopped",
    "no_map",
    "exact_only",
    "off",
    "analysis",
    "study",
]
"""`confirmation`: simulated after the search, for the best set owed its score there to a reference. `blocked`: something is stored, but
every set differs where it matters. `unanswered`: the cell that was to answer it has no result. `stopped`: the self-check stopped reuse in
this scenario. `no_map`, `exact_only`, `off`: the campaign allows no reuse. `analysis`: a cell of the sensitivity stage, which only
repeats."""


class Difference(Answer):
    """A parameter in which the cell and the stored set differ. `lower` and `upper` are the inclusive influential bounds of the map, null
    where it has none on that side. `blocks`: the two values do not lie in the same non-influential region."""

    parameter: str
    value: float
    reference_value: float
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
    score: int | None
    failure: str | None


class Audit(Answer):
    """Comparison with the reference that would have answered the cell (audited), or had (confirmation). `agrees`: equal scores;
    `wrong`: they differ by more than 1 (Eq. 8). Null where one of the two has no result."""

    score: int | None
    reference_score: int | None
    agrees: bool | None
    wrong: bool | None


class Proof(Answer):
    """Certificate of a cell with another answer: its run would repeat that of evaluation `reference`, bit for bit.

    Of a reused cell: `score` is what a simulation would have given, `agrees` whether the reference's is the same, `wrong`: they differ by
    more than 1 (Eq. 8). Of a cell that was simulated to check the certificate: `agrees` says whether both runs are the same.
    """

    reference: Reference
    score: int | None
    agrees: bool | None
    wrong: bool | None


class Explanation(Answer):
    """Why a cell was answered as it was.

    `reference` is the donor (repeated, reused), the donor that was not trusted (audited, confirmation), or the nearest stored set
    (blocked): fewest blocking parameters first, then the smallest distance. `distance` is that of the blocking parameters, in units of
    their ranges (Euclidean), and `stored` counts the results of the same setup that the campaign saw; both null if nothing was
    searched for.
    """

    evaluation: int
    campaign: str
    stage: str
    iteration: int
    individual: int
    scenario: str
    outcome: str | None
    score: int | None
    failure: str | None
    reason: Reason
    sentence: str
    reference: Reference | None = None
    differences: list[Difference] = Field(default_factory=list)
    audit: Audit | None = None
    proof: Proof | None = None
    distance: float | None = None
    stored: int | None = None
