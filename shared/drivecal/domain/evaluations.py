"""How a cell, one (parameter set, scenario) pair, gets its answer, and what an answer is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from drivecal.domain.campaigns import StageName


class Outcome(StrEnum):
    """What answered a requested cell. Order of trying: repeated, reused, certified, simulated."""

    REPEATED = "repeated"
    """Same setup, same parameter set: its own stored result."""
    REUSED = "reused"
    """A reference that differs only inside non-influential regions (Figure 6 of the paper)."""
    CERTIFIED = "certified"
    """A stored run that is proved to be bit-identical to what the simulation would have given."""
    SIMULATED = "simulated"
    """A run that gave a result, a failure with score 0 included."""
    FAILED = "failed"
    """No result after all attempts: score null, ranked last, never a reference."""


class Failure(StrEnum):
    """Why a simulated run scores 0."""

    COLLISION = "collision"
    OFF_ROAD = "off_road"
    TASK_MISSED = "task_missed"
    UNSTABLE = "unstable"


class Breakdown(StrEnum):
    """Why a cell has no result at all after all attempts."""

    CRASH = "crash"
    HANG = "hang"
    MEMORY = "memory"
    ERROR = "error"


@dataclass(frozen=True, slots=True)
class Rating:
    """Comfort on the paper's scale: `rating` continuous in 0..7, `score` its rounding, 7 is best."""

    rating: float
    score: int


FAILED_RATING = Rating(rating=0.0, score=0)
"""What a run that failed (collision, off the road, task missed, unstable) is rated, whoever rates."""


@dataclass(frozen=True, slots=True)
class RunResult:
    """What one simulation gave: the measured metrics (names carry units), why it failed if it did, and its rating."""

    rating: Rating
    metrics: Mapping[str, float]
    failure: Failure | None = None


@dataclass(frozen=True, slots=True)
class Answered:
    """A result. `proven_by`: the number of the run that it provably repeats, where there is one; it was not simulated then, unless
    `agrees` says whether the simulation gave the same. `agrees` is False without `proven_by` where the simulation turned out not to be
    deterministic."""

    result: RunResult
    proven_by: int | None = None
    agrees: bool | None = None


@dataclass(frozen=True, slots=True)
class Donor:
    """A stored, simulated result: the evaluation that simulated it and what it gave."""

    evaluation: int
    run: int
    score: int
    rating: float
    failure: str | None


@dataclass(frozen=True, slots=True)
class CellScore:
    """The answer of one requested cell; `score` and `rating` are None where there is no result.

    `own` is False where it was copied from a reference: the set's own result, if there is one, counts more.
    """

    parameter_set: int
    """Its id."""
    scenario: str
    score: int | None
    rating: float | None
    own: bool
    iteration: int
    individual: int


@dataclass(frozen=True, slots=True)
class AuditCount:
    """The self-check of one scenario: `different`: any change of the score; `wrong`: by more than 1 (Eq. 8 of the paper)."""

    scenario: str
    audited: int
    different: int
    wrong: int


@dataclass(frozen=True, slots=True)
class OutcomeCosts:
    """Answered cells of one stage and scenario that have outcome and `audited` in common.

    `seconds`: CPU time that the campaign's own attempts took; `run_seconds`: that of the `runs` stored runs that answered the cells.
    """

    stage: StageName
    scenario: str
    outcome: Outcome
    audited: bool
    cells: int
    seconds: float
    runs: int
    run_seconds: float
