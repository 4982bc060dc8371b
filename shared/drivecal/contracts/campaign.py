"""Answers about campaigns, and messages of their event streams."""

from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from html import escape
from typing import Any, Generic, Literal, Self, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, Field, computed_field

from drivecal.domain.scales import COMFORT, Scale

RowModel = TypeVar("RowModel", bound=BaseModel)

Score = int | float
"""A score in units of the campaign's scale; an integer if it is whole (`domain.scales.plain`)."""
MOST_ROWS = 20
"""Rows of a table that a notebook shows; further ones are counted."""


class Answer(BaseModel):
    """The base of all answers: immutable; a client ignores unknown fields."""

    model_config = ConfigDict(frozen=True, extra="ignore", json_schema_serialization_defaults_required=True, defer_build=True)

    @classmethod
    def of(cls, stored: object, /, **more: Any) -> Self:
        """Returns the answer with the values that an object has under the names of its fields, and `more`, which count before these."""
        known = {name: getattr(stored, name) for name in cls.model_fields if name not in more and hasattr(stored, name)}
        return cls(**known, **more)


class Page(Answer, Generic[RowModel]):
    """Rows of a table in their order; `next_cursor` null on the last page."""

    items: list[RowModel]
    next_cursor: str | None = None

    def _repr_html_(self) -> str:
        """Returns the rows as a notebook shows them."""
        return html_table([row.model_dump(mode="json") for row in self.items])


class Progress(Answer):
    """Cells of the running stage: `done` of `total`. `eta_seconds`: wall-clock time to the end of the stage, by the pace of the newer half
    of the workers' answers; null until it can be estimated."""

    done: int = 0
    total: int = 0
    eta_seconds: float | None = None


class OutcomeCounts(Answer):
    """Cells with an answer, by its kind: requested = repeated + reused + predicted + simulated + failed.

    This class and its subclasses are the only list of the counters: columns and JSON in SQL, exports, metrics, checks and the page's types
    follow from their fields. `certified` is always 0: there are no certificates any more, and `reduction.certified` has no effect.
    """

    requested: int = 0
    repeated: int = 0
    reused: int = 0
    predicted: int = 0
    certified: int = 0
    simulated: int = 0
    failed: int = 0


class GenerationCounts(OutcomeCounts):
    """Cells of an iteration; proposed = carried_over + requested once all have their answers."""

    proposed: int = 0
    carried_over: int = 0
    audited: int = 0
    """Reusable cells that were simulated as a check; among `simulated`."""
    sampled: int = 0
    """Predicted cells that were drawn as the sample of their lot; among `simulated`."""


class CellCounts(GenerationCounts):
    """Cells of a stage; proposed = carried_over + pending + requested at every moment."""

    pending: int = 0
    unrepeatable: int = 0
    """Simulations that gave other bits than the stored run of the same cell: the setup does not name all that decides a run."""
    unscored: int = 0
    """Cells for whose measures the score's formula has no value, which are worth a failed run; simulated, or answered by stored runs."""
    runs: int = 0
    """Starts of the simulator for these cells, whatever for: retries and repeated runs included."""
    lost: int = 0
    """Starts, among `runs`, whose worker or server was killed: they take nothing from a budget. A cell at a worker on Ray, or whose
    server was killed, counts as started, so that the simulator counts at least `runs` - `lost` and at most `runs`."""
    shared: int = 0
    """Simulated cells that took a run of another campaign: they count in the budget of an `isolated` campaign."""
    discarded: int = 0
    """Cells of sets that a search gave up, because they could not be the best any more. They were not requested, and are in no sum."""
    cut: int = 0
    """Cells whose score is worse than the worth of a failed run, which they count as; simulated, or answered by stored runs."""


class ErrorRate(Answer):
    """Results of the self-check in a scenario. Audited answers with any change are `different`, beyond the tolerance `wrong`.

    `contradictions` counts reference keys with different simulated scores, among the campaign's results and their references. Of the `lots`
    of reused answers, with `inspected` cells and `sampled` ones, the `rejected` ones were simulated whole. `stopped` is always false.

    R_err is wrong / audited. Lots are sampled in different shares: with lots, R_err is no estimate for all answers. Without lots,
    `upper_95` is the upper end of the 95 % Clopper-Pearson interval of R_err; null before the first audit. With lots, it is a time-uniform
    upper limit of the share of wrong answers among the released ones; null before the first release, and for several runs."""

    audited: int = 0
    different: int = 0
    wrong: int = 0
    upper_95: float | None = None
    stopped: Literal[False] = False
    contradictions: int = 0
    lots: int = 0
    inspected: int = 0
    sampled: int = 0
    rejected: int = 0


class Released(Answer):
    """Lots of predicted answers in a scenario: `rejected` ones were simulated whole, the others' `predicted` answers were released.

    `different` counts the `sampled` predictions with an error above the tolerance. The expected number of errors released is at most
    `limit` (AOQL) times the `inspected` predictions: all in lots, with samples and rejected lots. `upper_95` is a time-uniform upper limit
    of the share of errors among released answers. `mean_error` and `largest_error`, in the score's unit, are errors of the samples of
    released lots, and estimate the released answers. All three are null before the first release. `asked` counts the predictor's batches:
    it predicts once it knows enough, unless it costs more than it saves. `seconds` is its CPU time.
    """

    asked: int = 0
    lots: int = 0
    inspected: int = 0
    rejected: int = 0
    predicted: int = 0
    sampled: int = 0
    different: int = 0
    mean_error: float | None = None
    largest_error: float | None = None
    limit: float
    upper_95: float | None = None
    seconds: float = 0.0


class Best(Answer):
    """The best parameter set so far. `alternatives` counts all sets whose objective is equal within 1e-9, this one included; `violation`:
    of the constraints, in shares, above 0 only if no set keeps them all."""

    objective: float
    parameters: dict[str, float | str]
    scores: dict[str, Score]
    alternatives: int
    violation: float = 0.0
    undecided: bool = False
    """Its runs do not decide whether it keeps its rates; `violation` is small then, and above 0."""
    constraints: dict[str, float] = {}
    """The constrained amounts, as of `Solution`."""
    failed: list[str] = []
    """Scenarios where each of its runs failed."""
    replicates: int = 1
    """Seeds under which it ran."""
    failures: int = 0
    """Failed runs under all its seeds."""
    failure_interval: tuple[float, float] | None = None
    """Exact 95 % interval of the share of its runs that fail, by runs that did not choose the set; null with one seed."""
    noise: dict[str, float] = {}
    """Standard deviation of a run's score by scenario, failures and effects that all sets have in common left out, as far as known."""
    standard_error: float | None = None
    """Standard error of the objective; null if the simulator is not random."""
    lower: float | None = None
    """Lower end of the interval of the objective, at `replicates.confidence`, by runs that did not choose the set; null without any, and
    for a quantile if they are too few."""
    upper: float | None = None
    """Upper end of that interval."""
    probability_best: float | None = None
    """Probability that no other evaluated set is better; null if the simulator is not random, and as in `solutions`."""
    close: int = 0
    """Number of sets that may be equally good, at the campaign's confidence."""


class Baseline(Answer):
    """The user's parameter set for comparison. Null scores are still missing. `violation` is the sum of the violations, as shares;
    `undecided` as in `Best`. `close`: its runs, of a random simulator, do not tell which of both is better. `gain`: the best
    set's improvement on it under the seeds that report both; null without two of them. `seeds` of its scores, if there are several;
    `best_objective` and `best_scores` are the best set's under these seeds, if they report it."""

    objective: float | None
    parameters: dict[str, float | str]
    scores: dict[str, Score | None]
    violation: float = 0.0
    undecided: bool = False
    close: bool = False
    gain: float | None = None
    seeds: list[int] = []
    best_objective: float | None = None
    best_scores: dict[str, Score | None] = {}


class Confirmation(Answer):
    """Simulation of the best set of a search, or of its front, because scores may be copies. `confirmed`: all its scores were simulated;
    `untried`: likewise, but a set with better copied or predicted scores was not; `unconfirmed`: a score is still a copy.

    `tried` counts the simulated sets, `dismissed` the sets that a prediction alone ruled out. `objective` is the best set's, `believed` is
    the best at the end of the search, `reach` is an untried set's; all three are null for a front. `copied` lists the scenarios of the
    best set's copied scores. `failed` is true if its simulation failed. `front` counts the sets of the front, and is null for a single
    objective. `front_copied` counts the front's sets with a copy."""

    state: Literal["confirmed", "untried", "unconfirmed"]
    tried: int
    dismissed: int = 0
    objective: float | None = None
    believed: float | None = None
    reach: float | None = None
    copied: list[str] = []
    failed: bool = False
    front: int | None = None
    front_copied: int = 0


class FirstObjective(Answer):
    """The first of a campaign's objectives, whose values `best` and `baseline` have."""

    name: str
    unit: str
    direction: Literal["maximise", "minimise"]


SearchEnd = Literal["budget", "stagnation", "iterations", "finished"]


class Repaired(Answer):
    """Infeasible proposals of a search, and the `distinct` sets that they became."""

    proposed: int = 0
    distinct: int = 0

    def __add__(self, other: "Repaired") -> "Repaired":
        return Repaired(proposed=self.proposed + other.proposed, distinct=self.distinct + other.distinct)

    @property
    def collapses(self) -> bool:
        """True if fewer than a tenth of the proposals lead to new sets."""
        return 10 * self.distinct < self.proposed


class SearchState(Answer):
    """The stored state of a campaign's search; its rounds are rows of their own."""

    room: int
    """Cells of a round."""
    ended_by: SearchEnd | None = None
    simulated: int = 0
    """Simulations in closed rounds."""
    better_at: int = 0
    """Their number when the last better set was found."""
    stood_still_at: int | None = None
    """First round after which the search had stood still for as long as the budget allows."""
    stale: int = 0
    """Closed generations without a new set, up to now."""
    surest: float | None = None
    """Objective of the best set whose scores are all its own: copied and predicted ones may be too good."""
    repaired: Repaired = Repaired()
    predictions_off: str | None = None
    """Why predictions are off; null while they are on, or too little is known."""
    last_look: list[int] | None = None
    """Ids of dismissed sets to simulate after the search; null before its end."""
    spent_minutes: float | None = None
    """Minutes of the search up to its last stored result, or its end, without those while it was paused or no server ran."""
    reuse_seconds: float = 0.0
    """CPU time of the dispatcher for look-ups, keys and lots."""


class Spent(Answer):
    """The used part of a budget; minutes of the wall clock up to the last result. `stored`: simulations of other campaigns that count in
    the budget of an `isolated` campaign, among `simulations`."""

    simulations: int = 0
    stored: int = 0
    minutes: float = 0.0


class Seconds(Answer):
    """`wall`: since the campaign started; `simulating`: CPU time of the workers."""

    wall: float = 0.0
    simulating: float = 0.0


PROGRESS = "progress"
"""The name of what is sent between events, without an id: how far the campaign is now."""


class CampaignEvent(Answer):
    """Something that happened to a campaign; what more it holds depends on its `kind`.

    `id` is what the stream can be resumed after; null for what is not stored: that the dispatcher is silent, and that it speaks again.
    """

    id: int | None = None
    kind: str
    campaign: str
    at: datetime
    text: str = ""
    """The event as a line for readers; its wording may change."""
    data: dict[str, Any] = Field(default_factory=dict)


class CampaignProgress(Answer):
    """Fields of `Campaign` that change while it runs."""

    stages: dict[str, CellCounts] = {}  # without stages that have not begun
    state: str
    requested_action: str | None = None
    """`pause`, `resume` or `cancel` if requested and not done yet."""
    degraded: str | None = None
    """Reason why it is slow or stands still for now."""
    waiting: str | None = None
    """Reason why it waits to be started or to go on, with its place in the queue, or why some of its cells wait: for a licence, say."""
    stage: str | None = None
    iteration: int | None = None
    """Iteration of the search, counted from 0."""
    progress: Progress = Progress()
    seconds: Seconds = Seconds()

    @computed_field  # type: ignore[prop-decorator]  # decorated properties
    @property
    def cells(self) -> CellCounts:
        """The calibration stage, or a single evaluation."""
        return self.stages.get("calibration", CellCounts())

    @computed_field  # type: ignore[prop-decorator]  # decorated properties
    @property
    def sensitivity_cells(self) -> CellCounts:
        """The sensitivity stage."""
        return self.stages.get("sensitivity", CellCounts())


class Campaign(CampaignProgress):
    """A campaign as `GET /campaigns/{id}` shows it."""

    id: str
    name: str
    kind: str = "calibration"
    owner: str | None = None
    """Name of the token that submitted it; null without tokens."""
    priority: int = 0
    scale: Scale = COMFORT
    """Scale of the scores: direction, usual range, tolerance, unit. Before a campaign starts, the scale of the comfort score."""
    objective: FirstObjective | None = None
    """Null: the weighted mean of the score."""
    error_rate: dict[str, ErrorRate] = {}
    released: dict[str, Released] = {}
    """Predicted answers by scenario; empty if the campaign predicts nothing."""
    best: Best | None = None
    confirmation: Confirmation | None = None
    """Null before the end of the search, and if no score of its best set was a copy."""
    baseline: Baseline | None = None
    budget: dict[str, float | None] | None = None
    """The end of the search: `simulations`, `minutes`, `stagnation`; null without a search, and if its number of iterations ends it."""
    spent: Spent = Spent()
    ended_by: SearchEnd | Literal["cancelled", "failed"] | None = None
    """Why the search ended; null before, and without a search."""
    curves: dict[str, dict[str, Any]] = {}
    """Curves and maps of the best set: `names` of coefficients, `axes`, `values`; of an ended campaign alone the range of `good` sets."""
    repaired: Repaired = Repaired()
    error: str | None = None
    notes: list[str] = []
    """Remarks for the reader: scenarios left out by weight 0, rejected lots."""
    rerun_of: str | None = None
    tags: list[str] = []
    created_at: datetime | None = None
    started_at: datetime | None = None
    ended_at: datetime | None = None
    spec: dict[str, Any] = {}
    """The specification with its defaults. Empty in a list if longer than 20,000 characters: read the campaign by its id."""
    links: dict[str, str] = {}

    def _repr_html_(self) -> str:
        """Returns the campaign as a notebook shows it."""
        done, total, seconds = self.progress.done, self.progress.total, self.progress.eta_seconds
        bar = f'<progress value="{done}" max="{total}"></progress>' if total and self.ended_at is None else ""
        facts = {
            "campaign": self.name,
            "id": self.id,
            "state": self.state,
            "stage": self.stage,
            "progress": f"{done:,} of {total:,} cells",
            "seconds left": None if seconds is None or self.state != "running" else round(seconds),
            "degraded": self.degraded,
            "waiting": self.waiting,
            "error": self.error,
        }
        best = {} if self.best is None else {"best objective": self.best.objective, **self.best.parameters}
        for name, curve in self.curves.items():
            best = {key: value for key, value in best.items() if key not in curve["names"]}
            best[f"{name} at {', '.join(map(str, curve['axes']))}"] = curve["values"]
            if good := curve.get("good"):
                best[f"{name}, range of {good['sets']} good sets"] = f"{good['lower']} to {good['upper']}"
        return bar + html_facts({name: value for name, value in (facts | best).items() if value is not None})


class CampaignPage(Page[Campaign]):
    """A page of campaigns, newest first; `next_cursor` null on the last."""


class Pace(Answer):
    """The time that simulations take on the workers of this moment."""

    milliseconds: float | None = None
    """Time for which one simulation occupies a worker: CPU time, or wall-clock time if the simulator waits. Null before a user's own
    simulator has run in these setups."""
    measured: bool = False
    """True if `milliseconds` was measured in these setups, false if it is assumed."""
    workers: int | None = None
    """Workers at this moment that can run at once, as the resources of the scenarios allow; null if the dispatcher is silent."""
    seconds: float | None = None
    """Upper limit of the simulations' time on the `workers`. Includes 20 ms for each cell that `surrogate` chooses; excludes planning,
    predictions and other optimizers. Null if time or workers are unknown."""
    notes: list[str] = []


class ExpectedRuns(Pace):
    """Upper bounds of a campaign's cost: proposed cells by stage, and simulations without any reuse. `problem`: its name, as given."""

    problem: str = ""
    sensitivity: int
    """Runs of the intervals, at most if `sequential` or with constraints; its results decide confirmations and the global analysis."""
    sensitivity_at_most: int
    calibration_proposed: int
    calibration_at_most: int
    robustness: int
    validation: int


StudyName = Literal["robustness", "validation"]
STUDIES: tuple[StudyName, ...] = get_args(StudyName)


class Study(Answer):
    """A study of a campaign's results, made by that `campaign` itself or by another one; `settings` as in its specification, `vehicle`:
    the model that was driven, `in_own_vehicle`: it is the vehicle of the campaign whose results are studied, with equal parameters."""

    campaign: str
    name: str
    stage: StudyName
    state: str
    settings: dict[str, Any]
    vehicle: str | None = None
    in_own_vehicle: bool = True
    ended_at: datetime | None


class StudyPage(Page[Study]):
    """The studies of a campaign's best sets and of its influence map, newest first."""


def _flat(row: Mapping[str, Any]) -> dict[str, Any]:
    """Returns a row whose mappings are columns of their own."""
    columns: dict[str, Any] = {}
    for name, value in row.items():
        columns.update({f"{name}.{key}": each for key, each in value.items()} if isinstance(value, Mapping) else {name: value})
    return columns


def html_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Returns rows as a table, without empty columns."""
    shown = [_flat(row) for row in rows[:MOST_ROWS]]
    columns = list(dict.fromkeys(name for row in shown for name, value in row.items() if value is not None))
    lines = [_line("th", columns), *(_line("td", [row.get(name) for name in columns]) for row in shown)]
    more = f"<p>{len(rows) - len(shown):,} more rows</p>" if len(rows) > len(shown) else ""
    return f"<table>{''.join(lines)}</table>{more}"


def html_facts(facts: Mapping[str, object]) -> str:
    """Returns named values as a table of two columns."""
    return f"<table>{''.join(_line('td', (name, value)) for name, value in facts.items())}</table>"


def _line(tag: str, values: Iterable[object]) -> str:
    return f"<tr>{''.join(f'<{tag}>{escape(_text(value))}</{tag}>' for value in values)}</tr>"


def _text(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)
