"""Answers about the results of a campaign: verdicts, the front of several objectives, savings and costs, and all of them."""

from typing import Any, Literal

from pydantic import Field

from drivecal.contracts.campaign import Answer, Campaign, OutcomeCounts, Study
from drivecal.contracts.evaluation import FailureCause
from drivecal.contracts.setup import CampaignSetup
from drivecal.contracts.tables import RobustnessRow, Solution, ValidationRow


class SensitivityCost(OutcomeCounts):
    """Cost of a sensitivity stage: requested cells, simulated runs, CPU seconds of the workers."""

    seconds: float = 0.0


class MapCost(Answer):
    """The influence map in use and its cost. `made_by` is the id of the campaign that made it, null for expert knowledge."""

    id: str
    made_by: str | None
    runs: int
    seconds: float


class ScenarioAccount(OutcomeCounts):
    """The calibration stage in one scenario. `mean_seconds` is the mean CPU time of its simulated cells; without such cells, of the
    earlier simulations that answered its cells; null without either. `saved` has the saved seconds by outcome: number of cells times the
    mean. `predictor_seconds` is CPU time. `confirmed` counts cells that were simulated after the search to confirm the best set, and
    therefore save nothing."""

    scenario: str
    audited: int
    confirmed: int = 0
    mean_seconds: float | None
    simulated_seconds: float
    saved: dict[str, float]
    predictor_seconds: float = 0.0


class BalanceItem(Answer):
    """An addend of the net, in seconds: positive if saved, negative if spent. Its `name` is an outcome of cells, or the part of a campaign
    that cost time; `label` is the same in words."""

    name: str
    label: str
    seconds: float


class Accounting(Answer):
    """Savings and costs of a campaign, in cells and in CPU seconds of the workers.

    Repeated, reused and predicted cells save `saved_seconds`, unless they were `confirmed`. Audited cells are simulated, and save nothing.
    `net_seconds` is the sum of the `balance`: an estimate of the CPU time of the same campaign without reuse, less its own.

    `clock` is `wall` if runs take more than twice their CPU time, else `cpu`. With `wall` all seconds of simulations are wall-clock
    time of the workers. The runs that answered cells took `cpu_seconds` and `wall_seconds`. From `break_even` requested cells on the map
    pays; null if it cost or saved nothing.
    """

    clock: Literal["cpu", "wall"] = "cpu"
    cpu_seconds: float = 0.0
    wall_seconds: float = 0.0
    sensitivity: SensitivityCost
    map: MapCost | None
    scenarios: list[ScenarioAccount]
    runs: dict[str, int] = Field(default_factory=dict)
    """Starts of the simulator in all stages by what they were for, as `purpose` of the evaluations has it; all but the first one of a cell
    are `further`: a check that equal runs are equal, or after a breakdown or a lost worker."""
    saved_seconds: float
    net_seconds: float
    break_even: int | None
    """Null without a map, or with a map without a known cost."""
    balance: list[BalanceItem] = Field(default_factory=list)
    """The addends of `net_seconds` that are not 0."""
    remarks: list[str] = Field(default_factory=list)
    """Sentences about the runs, the map and its break-even."""
    sentence: str


Light = Literal["green", "amber", "red"]
Question = Literal["scores", "search", "baseline"]
"""Questions: are the scores right, is the search finished, and is its result better than the baseline?"""


class ResultVerdict(Answer):
    """A finding about a campaign's result. `code` is a key of `analysis.verdicts.SENTENCES`, `numbers` are its figures by name, and `text`
    is the sentence. The verdict is a reason for the answer to its `question`. A `neutral` light speaks neither for nor
    against the result."""

    code: str
    question: Question
    light: Light | Literal["neutral"]
    scenario: str | None = None
    numbers: dict[str, Any] = Field(default_factory=dict)
    text: str


class ResultAnswer(Answer):
    """The answer to a question about a result. `light`: that of the gravest of its verdicts that are not neutral: only evidence for a
    result is green, never a warning. Null before the end, unless it is red already, and if all are neutral. `text`: the answer in words."""

    question: Question
    title: str
    light: Light | None
    text: str


class ResultTrust(Answer):
    """The trust that a campaign's result deserves: an answer to each question that a verdict is about, and the verdicts, the gravest
    first."""

    answers: list[ResultAnswer]
    verdicts: list[ResultVerdict]

    def light(self, question: Question) -> Light | None:
        """Returns the light of a question; None without an answer."""
        return next((each.light for each in self.answers if each.question == question), None)


class ParameterImportance(Answer):
    """Half of what R² on held-out sets loses when the values of a parameter are shuffled among them: its total effect as a share of the
    variation. About 0: the score does not depend on it in these sets; below 0: nothing but chance. `lower`,
    `upper`: 95 % interval over the choice of the held-out sets, for this forest; `upper` holds an eighth of what it does not explain, too;
    another search visits other sets, and may weigh parameters otherwise."""

    parameter: str
    importance: float
    lower: float
    upper: float
    covered: float
    """Share of its range that the middle 80 % of the sets cover: 0.8 if they were drawn evenly."""


WEAK, CLEAR, WIDE = 0.5, 0.025, 0.4


class ImportanceAnswer(Answer):
    """The importance of parameters among the sets of a search. `r2`: how well the forest predicts held-out sets, 1 exactly, 0 no better
    than their mean. Both are null, and `items` empty, if there are too few sets, their values are all the same, or `r2` is not above 0."""

    scenario: str | None
    """Null: for the objective."""
    method: str
    sets: int
    """Sets with values of their own; copies of references and predictions do not count."""
    held_out: int | None = None
    r2: float | None = None
    weak: float = WEAK
    """`r2` below which importances mean little."""
    covered: float | None = None
    """Mean over the parameters of the share of the range that the middle 80 % of the sets cover."""
    wide: float = WIDE
    """`covered` below which importances, and their order, hold near these sets only."""
    scenarios: list[str] = Field(default_factory=list)
    """With too few complete sets, the scenarios whose mean it is, each by its share in the variation of the objective; else empty. `sets`
    and `held_out` are the largest ones of the scenarios, and `r2` is their mean."""
    clear: float = CLEAR
    """Importance from which on a parameter matters among the sets of a search."""
    notes: list[str] = Field(default_factory=list)
    """Why there is none; a weak fit, and parameters on which importance and influence map disagree."""
    items: list[ParameterImportance] = Field(default_factory=list)


class FrontObjective(Answer):
    """An objective, in its own units: best and worst value on the front, null without one.

    `aggregate`: mean, min, max or `quantile Q` over the scenarios.
    """

    name: str
    unit: str
    direction: str
    aggregate: str
    scenarios: dict[str, float]
    """Weights, of sum 1."""
    tolerance: float
    best: float | None
    worst: float | None


class FrontGrowth(Answer):
    """The front of all sets up to an `iteration`, counted from 0, without tolerances; -1: the sets of other campaigns. `new`: its points
    that the front before did not have."""

    iteration: int
    size: int
    new: int


class FrontBaseline(Answer):
    """The campaign's baseline among its objectives; `rank`: its place on the front, null if it is dominated. `violation` and
    `undecided` as in `Best`, `values` as in `FrontRow`."""

    objectives: dict[str, float]
    violation: float
    undecided: bool = False
    constraints: dict[str, float] = Field(default_factory=dict)
    """The constrained amounts, by the names of the constraints."""
    values: dict[str, float] = Field(default_factory=dict)
    rank: int | None


class FrontSummary(Answer):
    """The front of a campaign: `evaluated` sets have a value of every objective, `feasible` ones keep all constraints, `size` make the
    front; `copied` of these have a score of a reference. `knee` and `extremes` are ranks in the table; the knee is null without one.
    `baseline`: null without one, and until it has a value of every objective."""

    objectives: list[FrontObjective]
    constraints: list[str]
    evaluated: int
    feasible: int
    size: int
    close: int = 0
    """Further sets whose runs do not tell that a set of the front beats them in every objective; 0 if the simulator is not random."""
    copied: int
    knee: int | None
    extremes: dict[str, int] = Field(default_factory=dict)
    baseline: FrontBaseline | None = None
    growth: list[FrontGrowth]


class VariantResult(Answer):
    """The best set of a variant and its value under the best set that all variants have in common; null until they are known.

    The common set is worse by `cost`. This is below 0 if the set breaks constraints of the variant, by `violation`, or by the noise of a
    random simulator: both sets are compared under the seeds that they have in common."""

    name: str
    scenarios: dict[str, float]
    """Weights, of sum 1."""
    best: Solution | None
    common: float | None = None
    cost: float | None = None
    violation: float = 0.0


class StudyResult(Answer):
    """A study that succeeded, with its rows of the table that it made."""

    study: Study
    robustness: list[RobustnessRow] = Field(default_factory=list)
    validation: list[ValidationRow] = Field(default_factory=list)


class CampaignResults(Answer):
    """The results of a campaign, for page and command line: its settings (`campaign.spec`, `setup`), the best sets, checks and doubts
    (`trust`), and costs (`accounting`, null before the first answered cell).

    `front` is null with a single objective, and before a set has a value of each. `failures` lists the causes of failed cells. `studies`
    lists the succeeded studies of any campaign: in the campaign's own vehicle first, the newest first. `variants` has the campaign's."""

    campaign: Campaign
    setup: CampaignSetup
    trust: ResultTrust
    accounting: Accounting | None = None
    front: FrontSummary | None = None
    failures: list[FailureCause] = Field(default_factory=list)
    variants: list[VariantResult] = Field(default_factory=list)
    studies: list[StudyResult] = Field(default_factory=list)
