"""Results of cells, i.e. (parameter set, scenario) pairs, and the ways in which cells are answered."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

from drivecal.domain.campaigns import StageName


class Outcome(StrEnum):
    """The way in which a requested cell was answered, in the order of trying: repeated, reused, predicted, certified, simulated."""

    REPEATED = "repeated"
    """Stored result of the same parameter set in the same setup."""
    REUSED = "reused"
    """Result of a reference that differs only inside non-influential regions (Figure 6 of the paper)."""
    PREDICTED = "predicted"
    """Prediction of a released lot, whose sample was simulated (Dodge and Romig 1959); never a reference, never an optimum."""
    CERTIFIED = "certified"
    """Stored run that is proved to be bit-identical to the simulation."""
    SIMULATED = "simulated"
    """Simulated run, including a failure, which is worth the scale's `failed`."""
    FAILED = "failed"
    """No result after all attempts: score null, ranked last, never a reference."""


class Failure(StrEnum):
    """Reason for which a simulated run is worth the scale's `failed`."""

    COLLISION = "collision"
    OFF_ROAD = "off_road"
    TASK_MISSED = "task_missed"
    UNSTABLE = "unstable"


class Breakdown(StrEnum):
    """Reason for which a cell has no result after all attempts."""

    CRASH = "crash"
    HANG = "hang"
    MEMORY = "memory"
    ERROR = "error"


@dataclass(frozen=True, slots=True)
class Rating:
    """A run in units of the campaign's scale: `score` is what counts, `rating` a finer number that orders equal scores.

    On a scale with steps, `score` is the rating rounded to a step; on others both are the same. `undefined`: why the formula of the score
    has no value, so that the run has the worth of a failed one. `cut`: the formula's value if it is worse than a failed run's worth, which
    the run then counts as.
    """

    rating: float
    score: float
    undefined: str | None = None
    cut: float | None = None


FAILED_RATING = Rating(rating=0.0, score=0)
"""Rating of every failed run (collision, off the road, task missed, unstable), independent of the evaluator."""


@dataclass(frozen=True, slots=True)
class RunResult:
    """Result of one simulation: its rating, the measured metrics (names carry units), the failure, if any, and its certificate.

    `proven_by`: the number of the run that the result provably repeats, None without a certificate. `agrees`: whether a simulation gave
    the same result as the certificate, None if it was not simulated. `agrees` is False without `proven_by` if the simulation turned out
    not to be deterministic. `certifying`: CPU time (ms) of looking for the certificate and of recording the run, less what repeated
    decisions spared; no part of the result.
    """

    rating: Rating
    metrics: Mapping[str, float]
    failure: Failure | None = None
    proven_by: int | None = None
    agrees: bool | None = None
    certifying: float = field(default=0.0, compare=False)


class Donor(NamedTuple):
    """A stored, simulated result and the evaluation that simulated it. A look-up makes thousands, and a frozen dataclass takes three times
    as long."""

    evaluation: int
    run: int
    score: float
    rating: float
    failure: str | None


@dataclass(frozen=True, slots=True)
class CellScore:
    """Score of one requested cell; `score` and `rating` are None without a result.

    `own` is False if the score was copied from a reference or predicted: the set's own result, if it exists, takes precedence.
    """

    parameter_set: int
    """Id of the parameter set."""
    scenario: str
    score: float | None
    rating: float | None
    own: bool
    iteration: int
    individual: int
    predicted: bool = False
    values: Mapping[str, float] = field(default_factory=dict)
    """Other values of the run that answered the cell, by their keys."""


@dataclass(frozen=True, slots=True)
class AuditCount:
    """Audited cells of one scenario: `different` ones changed their score, `wrong` ones by more than the tolerance (Eq. 8)."""

    scenario: str
    audited: int
    different: int
    wrong: int


@dataclass(frozen=True, slots=True)
class OutcomeCosts:
    """Answered cells of one stage and scenario that have outcome and `audited` in common.

    `seconds`: CPU time that the campaign's own attempts took; certificates took `certifying_seconds` of it. `run_seconds`: CPU time of
    the `runs` simulated runs that answered the cells, without certificates. `occupied_seconds`, `occupied_run_seconds`: the same of own
    runs and of those runs by the time for which they occupied their workers, which is wall-clock time if simulators wait.
    """

    stage: StageName
    scenario: str
    outcome: Outcome
    audited: bool
    cells: int
    seconds: float
    runs: int
    run_seconds: float
    certifying_seconds: float = 0.0
    occupied_seconds: float = 0.0
    occupied_run_seconds: float = 0.0
