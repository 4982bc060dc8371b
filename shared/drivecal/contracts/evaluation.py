"""Answers about evaluations: a parameter set in a scenario, or in all of a catalogue, and why a cell was answered without a simulation."""

from typing import Literal

from pydantic import Field

from drivecal.contracts.campaign import Answer, Score
from drivecal.contracts.tables import EvaluationRow
from drivecal.domain.scales import Scale


class EvaluatedCell(Answer):
    """A scenario of a single evaluation. `outcome`, `score` and `rating` are null while the answer is pending.

    Under several seeds, scores and metrics are means, null if a run lacks one. `id` and `worker` belong to the first run; the table
    `evaluations` has a row for each.
    """

    id: int
    scenario: str
    outcome: str | None
    score: Score | None
    rating: float | None
    reference: int | None
    failure: str | None
    milliseconds: float | None
    """CPU time of the cell's simulations; null without one."""
    worker: str | None
    detail: str | None = None
    """Reason of the missing result, if all attempts failed; else the breakdown before a later attempt."""
    metrics: dict[str, float | None] | None = None
    """The measured metrics, their units in their names; null if this run does not define it."""
    seeds: list[int] = Field(default_factory=list)
    """Seeds of its runs; empty if the simulator does not depend on one."""
    failures: int = 0
    """Failed runs, if there are several."""
    scores: list[Score | None] = Field(default_factory=list)
    """Scores by seed, if there are several."""
    standard_error: float | None = None
    """Standard error of the score; this and the following are null for a single run and for equal scores."""
    lower: float | None = None
    """Lower end of its 95 % interval (Student)."""
    upper: float | None = None
    within: dict[str, tuple[float, float]] = Field(default_factory=dict)
    """95 % intervals of the metrics."""


class CampaignOfEvaluation(Answer):
    """Context of an evaluation's numbers: `problem` is highway or the digest of a bundle, `scale` that of its score."""

    id: str
    problem: str
    scale: Scale


class EvaluationDetail(EvaluationRow):
    """A row of a campaign's evaluations with all that is known of it.

    `detail`: why there is no result, or none at first, in words. `metrics`: the measures of its run, null without one. `parameters`: the
    values of its parameters, which are fields of the row as well.
    """

    detail: str | None
    metrics: dict[str, float | None] | None
    parameters: dict[str, float | str]
    campaign: CampaignOfEvaluation


class CellNumber(Answer):
    """The evaluation behind the score of a set in a scenario. A score that is a mean over seeds shows its first one."""

    evaluation: int
    runs: list[tuple[int, int]] = Field(default_factory=list)
    """Seed and number of each of the set's evaluations, first the seeds that report it; empty if the simulator is not random."""


class PendingTrace(Answer):
    """The time series of an evaluation are being made."""

    evaluation: int
    state: str
    degraded: str | None = None
    links: dict[str, str] = Field(default_factory=dict)


class LaneStrip(Answer):
    """The area of a lane: its `right` and its `left` border, with a row of x, y (m) in each for the same places."""

    right: list[list[float]]
    left: list[list[float]]


class RoadSurface(Answer):
    """Lanes from above. `edges`: lines beyond which there is no lane; `markings`: lines between two lanes. Rows of x, y (m)."""

    lanes: list[LaneStrip]
    edges: list[list[list[float]]]
    markings: list[list[list[float]]]


class ReplayVehicle(Answer):
    """A vehicle near the ego vehicle, as long as it is: its lists begin at number `first` of the replay's times.

    Place of its centre (m), heading (rad), length and width (m). A vehicle that comes back is another entry of the same `id`.
    """

    id: str
    first: int
    length_m: float
    width_m: float
    x_m: list[float]
    y_m: list[float]
    heading_rad: list[float]


class ReplayEgo(Answer):
    """The controlled vehicle: as `ReplayVehicle`, with its speed, its place along the route and its offset from the lane's centre."""

    length_m: float
    width_m: float
    x_m: list[float]
    y_m: list[float]
    heading_rad: list[float]
    speed_mps: list[float]
    position_m: list[float]
    offset_m: list[float]


class ReplayPlan(Answer):
    """A trajectory that a driving function decided for at `made_at_s`, rounded to six decimals; `time_s` counts from there."""

    made_at_s: float
    time_s: list[float]
    x_m: list[float]
    y_m: list[float]
    heading_rad: list[float]
    curvature_1pm: list[float]
    speed_mps: list[float]
    acceleration_mps2: list[float]


class ReplayAnswer(Answer):
    """A drive on the roads of a network, in its coordinates.

    `line`: rows of place along the route, x, y (m) and heading (rad); `route`: its lanes where the vehicle drives. `time_s`: equally
    spaced but for the last one. A driving function makes `plans`.
    """

    time_s: list[float]
    line: list[list[float]]
    route: RoadSurface
    ego: ReplayEgo
    others: list[ReplayVehicle]
    plans: list[ReplayPlan] = Field(default_factory=list)


class SeriesAnswer(Answer):
    """A run with the time series that its simulator reported; the manifest has their units.

    A driving function's run has a value after each step (`time_s`), in SI units, named by the series: the ego vehicle's s and d (Frenet),
    place, heading, speed, side slip, yaw rate, accelerations and their jerks over the last 0.5 s, and `ID_s_m` and so on of other vehicles.
    `replay` shows a run of a simulator `highway` from above; null for other simulators, and if the drive has no length.
    """

    measures: dict[str, float | None]
    failure: str | None
    series: dict[str, list[float]]
    replay: ReplayAnswer | None = None


class Evaluation(Answer):
    """A single evaluation. Asked for in one scenario, that scenario's answer is at the top level as well."""

    id: str
    state: str
    parameters: dict[str, float | str]
    scenario: str | None
    """Null if all scenarios of the catalogue were requested."""
    objective: float | None
    """The mean score over scenarios and seeds, null until all have one."""
    standard_error: float | None = None
    """Standard error of the objective over the seeds; null for a single one, and if all are equal."""
    lower: float | None = None
    """Lower end of its 95 % interval."""
    upper: float | None = None
    items: list[EvaluatedCell]
    outcome: str | None = None
    score: Score | None = None
    rating: float | None = None
    failure: str | None = None
    metrics: dict[str, float | None] | None = None
    error: str | None = None
    notes: list[str] = Field(default_factory=list)
    """E.g. values off the grid, which are simulated as given."""
    unrepeatable: int = 0
    """Simulations that differ from the stored run of the same cell, whose `metrics` these are."""
    links: dict[str, str] = Field(default_factory=dict)


class FailureCause(Answer):
    """Cells of a campaign that failed for the same cause.

    For the `kind` `no_result`, the cause is crash, hang, memory or error, and `detail` is the last message. `retried`: likewise, but a
    later attempt gave a result. For `failed`, the cause is the failure of the system under test that the simulation reported. For
    `unscored`, it is the reason why the formula has no value for the measures. `example` is the first of the `cells`. Details that differ
    only in numbers and temporary paths are one cause.
    """

    kind: Literal["no_result", "retried", "failed", "unscored"]
    cause: str
    detail: str | None = None
    scenarios: list[str]
    cells: int
    example: int


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
    """Report of the last attempt without a result."""
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
