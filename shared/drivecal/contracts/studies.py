"""What the service answers about the best sets and the stages after the calibration: robustness and validation."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from drivecal.contracts.campaign import Answer, Solution


class OptimumRow(Solution):
    """One of the sets that share the best objective: an alternative optimum (Section IV-C).

    `region`: sets of one number are neighbours, or joined by a chain of neighbours; `to_worse`: how far, as a root mean square in shares
    of the searched ranges, the nearest set of a lower objective lies; null where there is none.
    """

    region: int
    to_worse: float | None


class Study(Answer):
    """A study of what a campaign found, made by that `campaign` itself or by another one; `settings` as in its specification, `vehicle`:
    the model that was driven."""

    campaign: str
    name: str
    stage: Literal["robustness", "validation"]
    state: str
    settings: dict[str, Any]
    vehicle: str | None = None
    ended_at: datetime | None


class StudyPage(Answer):
    """The studies of a campaign's best sets and of its influence map, newest first."""

    items: list[Study]
    next_cursor: str | None = None


class BoxTrial(Answer):
    """A solution in the vehicles of one box: `radius` is half its width in shares of the vehicle parameters' ranges; `deviations` are what
    the condition compares with eta, by scenario, null where a vehicle has no result."""

    box: int
    radius: float
    holds: bool
    deviations: dict[str, float | None]


class RobustnessRow(Answer):
    """One of the best sets, ordered by robustness: the degree, then the objective, then the rating.

    `scores`: simulated in the nominal vehicle. `degree`: the multiples of delta up to which the condition holds, at least so many where
    `at_least`; `radius`: the widest box in which it held (delta_max from below). `region`: sets of one number are neighbours;
    `to_worse`: how far, in shares of the ranges, the nearest set of a lower objective lies.
    """

    rank: int
    objective: float | None
    rating: float | None
    parameters: dict[str, float]
    scores: dict[str, int | None]
    region: int
    to_worse: float | None
    degree: int
    at_least: bool
    radius: float
    recommended: bool
    reason: str | None
    """Of the recommended one: why it is."""
    trials: list[BoxTrial]


class ValidationRow(Answer):
    """One scenario of the validation (Tables 1 and 2, Figure 14).

    `reducible` parameters have a region in which they do not matter; of their `effects` (main effects and interactions) so many were
    `covered`. `drawn`: the size of the Latin hypercube, of which `bases` that qualify were kept (n*_LHS), each compared with
    `references` variants (n_ref). `wrong`: |dF| > 1; R_err = wrong / compared (Eq. 8) with its 95 % Clopper-Pearson interval;
    `different`: any change. `histogram`: how many variants differ from their base by how many points.
    """

    scenario: str
    reducible: int
    effects: int
    covered: int
    drawn: int
    bases: int
    references: int
    compared: int
    wrong: int
    different: int
    error_rate: float | None
    lower_95: float | None
    upper_95: float | None
    histogram: dict[int, int]
