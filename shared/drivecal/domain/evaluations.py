"""Results of cells, i.e. (parameter set, scenario) pairs, and the ways to answer cells."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

from drivecal.domain.campaigns import StageName
from drivecal.domain.parameters import ParameterSet


class Outcome(StrEnum):
    """The way a requested cell was answered, in the order of trying: repeated, reused, predicted, simulated."""

    REPEATED = "repeated"
    """Stored result of the same parameter set in the same setup."""
    REUSED = "reused"
    """Result of a reference that differs only inside non-influential regions (Figure 6 of the paper)."""
    PREDICTED = "predicted"
    """Prediction of a released lot, whose sample was simulated (Dodge and Romig 1959); never a reference, never an optimum."""
    SIMULATED = "simulated"
    """Simulated run, including a failure, which is worth the scale's `failed`."""
    FAILED = "failed"
    """No result after all attempts: score null, ranked last, never a reference."""


ANSWERED_BY_DONOR = (Outcome.REPEATED, Outcome.REUSED)
"""Outcomes of cells that a donor answers: on the basis of an equal set, or of an influence map."""
NOT_SIMULATED = (Outcome.REUSED, Outcome.PREDICTED)
"""Outcomes for which no run of the very cell is known."""


class Purpose(StrEnum):
    """The reason for which a cell was asked for (`contracts.tables.EvaluationRow`); stages but the calibration have one each."""

    SEARCH = "search"
    START = "start"
    CHOICE = "choice"
    REPORT = "report"
    CONFIRMATION = "confirmation"
    AUDIT = "audit"
    SAMPLE = "sample"
    EVALUATION = "evaluation"
    SENSITIVITY = "sensitivity"
    ROBUSTNESS = "robustness"
    VALIDATION = "validation"
    CLAIMS = "claims"


INSPECTED = {Purpose.AUDIT: "audited", Purpose.SAMPLE: "sampled"}
"""Purposes of cells that are simulated to check an answer that they could have had, and the names of their counts."""


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


class Donor(NamedTuple):
    """A stored, simulated result and the evaluation that simulated it. A look-up makes thousands, and a frozen dataclass takes three times
    as long."""

    evaluation: int
    run: int
    score: float
    rating: float
    failure: str | None


@dataclass(frozen=True, slots=True)
class RequestedCell:
    """A cell that a stage asks for: `plan` and the fields after it are known once it is planned.

    `individual` numbers the parameter sets of an iteration. `reference_key` is None without an influence map. Of `purpose` START,
    no reference answers the scores, because others are compared with them. `donor`: the stored result that answers the cell, or that an
    inspection does not trust; `plan` is its basis, an equal set or an influence map. `leader`: position of the cell of the same population
    whose simulation answers this cell.
    """

    individual: int
    scenario: str
    parameters: ParameterSet
    reference_key: bytes | None = None
    plan: Outcome = Outcome.SIMULATED
    donor: Donor | None = None
    leader: int | None = None
    purpose: Purpose = Purpose.SEARCH
    from_equal_campaign: bool = False
    """The donor answered the same cell in an equal campaign, after an inspection."""
    seed: int = 1
    has_seed: bool = False
    """It is stored with its seed (`Bench.has_seed`)."""
    stage: StageName = StageName.CALIBRATION
    iteration: int = 0
    setup_id: int = 0
    parameter_set_id: int = 0
    """Numbers of setup and parameter set in the database."""
    lot: int | None = None
    confidence: float | None = None
    predicted_score: float | None = None
    predicted_rating: float | None = None

    @property
    def answered_at_once(self) -> bool:
        """True if a stored result is the cell's answer as soon as the cell is stored: it waits for no leader and no verdict."""
        return self.donor is not None and self.lot is None and self.plan in ANSWERED_BY_DONOR


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
    seed: int = 1
    failed: bool = False
    """The run ended with a failure of the system under test."""
    values: Mapping[str, float] = field(default_factory=dict)
    """Other values of the run that answered the cell, by their keys."""

    @property
    def worth(self) -> tuple[bool, bool, bool, int, int]:
        """Orders answers for one cell: a result before none, an own one before a copy, a copy before a prediction, then the earlier one."""
        return self.score is not None, self.own, not self.predicted, -self.iteration, -self.individual


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

    `seconds`: CPU time of the campaign's own attempts. `runs` simulated runs answered the cells and took `run_seconds` of CPU time, without
    second runs. `occupied_seconds` and `occupied_run_seconds` are the same two sums, counted by the time for which a run occupied its
    worker: that is wall-clock time if simulators wait.
    """

    stage: StageName
    scenario: str
    outcome: Outcome
    audited: bool
    cells: int
    seconds: float
    runs: int
    run_seconds: float
    occupied_seconds: float = 0.0
    occupied_run_seconds: float = 0.0
