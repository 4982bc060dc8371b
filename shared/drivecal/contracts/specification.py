"""The campaign file: what a user submits, as YAML, JSON or REST body. Bounds on everything; unknown fields are refused.

These models check each field by itself. What needs the installed plug-ins (does the scenario exist, is the value on the grid) is
checked by `drivecal.campaigns.resolve.problem`, which both `POST /campaigns` and `drivecal submit --dry-run` go through.
"""

from typing import Annotated, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    Discriminator,
    Field,
    StringConstraints,
    Tag,
    ValidationInfo,
    field_validator,
    model_validator,
)

from drivecal.contracts.strict_json import UNIQUE, Choice, Identifier, Name, Number, ProblemName, Source
from drivecal.contracts.strict_json import Tag as CampaignTag
from drivecal.domain.scales import Scale

DEFAULT_PROBLEM = "highway"
"""Name of the built-in problem, its catalogue, and its parameters."""
LARGEST_POPULATION = 100_000
LARGEST_ITERATIONS = 10_000
LARGEST_CONFIRM = 1_000
LARGEST_BUDGET = 10_000_000
LARGEST_REPLICATES = 10_000


def _each_once(value: str | list[str]) -> str | list[str]:
    if isinstance(value, list) and len(set(value)) != len(value):
        raise ValueError("a scenario is listed twice; list each once")
    return value


_Scenarios = Annotated[list[Identifier], Field(min_length=1, max_length=1000, json_schema_extra=UNIQUE)]
Seed = Annotated[int, Field(ge=1, le=2**31 - 1)]
Catalogue = Annotated[Identifier | _Scenarios, AfterValidator(_each_once)]
"""A catalogue of scenarios, or a list of their ids."""
Curve = Annotated[list[Number], Field(max_length=1000)]
Given = Number | Choice | Curve | Annotated[list[Curve], Field(max_length=1000)]
"""A value from outside: a number, the text of a choice, a list of a curve's values, or lists of a map's values, one for each x."""
Values = Annotated[dict[Identifier, Given], Field(max_length=200)]
"""A value per parameter."""


class Model(BaseModel, extra="forbid", strict=True, frozen=True, allow_inf_nan=False):
    """The base of all that comes from outside: strict, closed, finite."""


class ParameterEntry(Model):
    """A parameter: a grid (`step`), continuous (none, or 0), integer, or a choice."""

    lower: Number | None = None
    """Smallest value; not for a choice."""
    upper: Number | None = None
    """Largest value; not for a choice."""
    step: Annotated[float, Field(ge=0, le=1e6), AfterValidator(lambda step: step or None)] | None = None
    """Distance of two values; null or 0: continuous."""
    integer: bool = False
    """Whole numbers only; the simulation gets an integer."""
    choices: Annotated[list[Choice], Field(min_length=2, max_length=1000)] | None = None
    """The texts of a choice, in place of bounds; the simulation gets the text."""
    unit: Annotated[str, StringConstraints(max_length=32)] = "1"
    """For readers; 1 is none."""
    description: Annotated[str, StringConstraints(max_length=1000)] = ""
    """For readers."""


class ParameterSpecification(ParameterEntry):
    """A parameter of the user's own space."""

    name: Identifier


class VehicleSpecification(Model):
    """A vehicle model and the parameters that differ from its nominal values, by name; of another problem, its varied parameters."""

    model: Identifier | None = None
    parameters: Annotated[dict[Identifier, Number], Field(max_length=100)] = {}


class MapReference(Model):
    """Takes an influence map that is stored already instead of computing one."""

    map: Annotated[str, StringConstraints(min_length=1, max_length=64)]


class SeparateThresholds(Model):
    """Influential from |mu| >= `mu` or sigma >= `sigma` on (Section IV-E)."""

    mu: Annotated[float, Field(gt=0, le=1e6)]
    sigma: Annotated[float, Field(gt=0, le=1e6)]


class SensitivitySpecification(Model):
    """Finds by elementary effects where each parameter can change the score of a scenario, before the search (Section II-A).

    `threshold` on s_rel, on |mu| and sigma separately, or `auto`. `sequential`: the design `lines` leaves out the runs that cannot change a
    bound; intervals between influential ones then have no figures.
    """

    design: Literal["lines", "paper"] = "lines"
    """`lines` along each parameter, or the trajectories of the `paper`."""
    intervals: Annotated[int, Field(ge=1, le=1000)] = 10
    """Into which the range of each parameter is divided."""
    samples: Annotated[int, Field(ge=2, le=10_000)] = 20
    """Elementary effects for each interval."""
    threshold: Annotated[float, Field(gt=0, le=1e6)] | Literal["auto"] | SeparateThresholds = 0.02
    """From which on an interval is influential."""
    seed: Annotated[int, Field(ge=0, le=2**63 - 1)] = 1
    sequential: bool = True


class OptimizerSpecification(Model, extra="allow"):
    """Settings of all optimizers that propose whole populations; a plug-in's own extend them."""

    kind: Identifier = "genetic"
    """Its name; `GET /api/v1/optimizers` lists the installed ones."""
    population: Annotated[int, Field(ge=2, le=LARGEST_POPULATION)] = 1000
    """Parameter sets in each iteration."""
    iterations: Annotated[int, Field(ge=1, le=LARGEST_ITERATIONS)] = 20
    """Number of populations that the optimizer proposes."""
    start: Literal["lhs", "halton"] = "lhs"
    """Draw of the start population: Latin hypercube or Halton sequence."""
    seed: Annotated[int, Field(ge=0, le=2**63 - 1)] = 1
    start_sets: Annotated[list[Values], Field(max_length=LARGEST_POPULATION, fail_fast=True)] = []
    """Sets from expert knowledge: in the start population, after the baseline."""


class OptimizerSection(Model, extra="allow"):
    """The chosen optimizer with its settings, which the plug-in checks.

    Without `kind` it is `surrogate`, or `genetic` if the section has settings of populations.
    """

    kind: Identifier = "surrogate"
    """Its name; `GET /api/v1/optimizers` lists the installed ones."""
    seed: Annotated[int, Field(ge=0, le=2**63 - 1)] = 1
    start_sets: Annotated[list[Values], Field(max_length=LARGEST_POPULATION, fail_fast=True)] = []
    """Sets from expert knowledge, which are simulated first, after the baseline."""
    start_results: Source | None = None
    """Source of results from elsewhere, whose sets follow the start sets: at the nearest grid points, and simulated like any others."""
    population: Annotated[int, Field(ge=2, le=LARGEST_POPULATION)] | None = None
    """Parameter sets in each iteration; null of a search by the cell."""
    iterations: Annotated[int, Field(ge=1, le=LARGEST_ITERATIONS)] | None = None
    """Number of populations that the optimizer proposes; null if the budget ends the search."""
    start: Literal["lhs", "halton"] | None = None
    """Draw of the start population; null of a search by the cell."""

    @model_validator(mode="before")
    @classmethod
    def _infer_kind(cls, given: object) -> object:
        if isinstance(given, dict) and "kind" not in given and not given.keys() <= {"seed", "start_sets", "start_results"}:
            return {**given, "kind": "genetic"}
        return given


class BudgetSpecification(Model):
    """The end of a search: whatever is used up first."""

    simulations: Annotated[int, Field(ge=1, le=LARGEST_BUDGET)] | None = None
    """Runs that the simulator starts for the search, retries, checks and repeats included; for `surrogate`, stored answers, too."""
    minutes: Annotated[float, Field(gt=0, le=1e6)] | None = None
    """Wall-clock time of the search, without the time while it is paused or no server runs."""
    stagnation: Annotated[int, Field(ge=1, le=LARGEST_BUDGET)] | None = None
    """Simulations without a better set."""

    @model_validator(mode="after")
    def _ends(self) -> Self:
        if self.simulations is None and self.minutes is None and self.stagnation is None:
            raise ValueError("it has no end; give simulations, minutes or stagnation")
        return self


ReductionMode = Literal["off", "exact", "influence", "predicted", "both"]


class ReductionSpecification(Model):
    """Cells that may be answered without a simulation.

    The mode `off` simulates every cell. `exact` repeats results of equal parameter sets. `influence` copies results by an influence map
    (the paper's Figure 6). `predicted` adds predictions in inspected lots to `exact`. `both` is `influence` and `predicted`; it is the
    default with an analysis or a map. `limit` and `max_error` bound expected numbers of released errors (AOQL) in each scenario.
    """

    mode: ReductionMode = "predicted"
    tolerance: Annotated[float, Field(ge=0)] | None = None
    """Largest error of a prediction that does not count; null: the score's own tolerance, or 0 if it has steps."""
    limit: Annotated[float, Field(ge=0.001, le=0.5)] = 0.05
    """Largest expected number of errors released, per prediction in lots: samples and rejected lots included."""
    audit: Annotated[float, Field(ge=0, le=1)] = 0.02
    """Share of reused cells that is simulated as a check."""
    repeat: Annotated[float, Field(ge=0, le=1)] = 0.02
    """Share of simulated cells that run twice, to see whether they repeat, unless the problem says `deterministic: true`; 0: none."""
    max_error: Annotated[float, Field(gt=0, le=1)] = 0.02
    """Largest expected number of wrong answers released, per answer by a reference in lots; 1 makes no lots."""
    certified: bool = True
    """Accepted and without effect."""
    confirm: Annotated[int, Field(ge=0, le=LARGEST_CONFIRM)] = 20
    """Most sets simulated after the search, until the best has no score of a reference and no set is believed to be better."""
    isolated: bool = False
    """Sees no result of other campaigns, so that what it asks for and finds does not depend on them. Comparisons are. If the run
    of a cell is stored already, the cell takes it and still counts as simulated."""

    def tolerance_on(self, scale: Scale) -> float:
        """Returns the largest error of a prediction that does not count."""
        if self.tolerance is not None:
            return self.tolerance
        return scale.tolerance if scale.step is None else 0.0

    @property
    def uses_map(self) -> bool:
        """True if references may answer cells by an influence map."""
        return self.mode in {"influence", "both"}

    @property
    def predicts(self) -> bool:
        """True if predictions may answer cells."""
        return self.mode in {"predicted", "both"}

    def beside(self, sensitivity: object) -> Self:
        """Returns the settings of a document with this `sensitivity` section: who asks for a map and names no mode uses the map, too."""
        if sensitivity is None or "mode" in self.model_fields_set:
            return self
        settled = self.model_copy(update={"mode": "both"})
        settled.__pydantic_fields_set__.discard("mode")  # still a default
        return settled


class Quantile(Model):
    """The least value that this share of the weight does not exceed."""

    quantile: Annotated[float, Field(ge=0, le=1)]


ReferenceSet = Values | Annotated[str, StringConstraints(min_length=1, max_length=80)]
"""A set: `baseline`, values by parameter, or the id of a campaign, which means its best set, with `#2` the second."""


class GoalSpecification(Model):
    """A declared score or a stored measure, over scenarios, or the change from a set, which is known without a run.

    `min`, `max` and quantiles are computed from the values, even if lower values are better.
    """

    score: Identifier | None = None
    """A score that the problem declares; this or `measure`."""
    measure: Identifier | None = None
    """A stored measure; this or `score`."""
    changes: ReferenceSet | None = None
    """Number of parameters that differ from a set: `baseline`, values by parameter, or `ID` or `ID#2` of another campaign."""
    distance: ReferenceSet | None = None
    """Distance from such a set, in shares of the parameters' ranges; a choice that differs counts as 1."""
    norm: Literal["largest", "sum"] = "largest"
    """Kind of the distance: the largest difference of a parameter, or the sum."""
    name: Identifier | None = None
    """The score's or measure's own if left out."""
    scenarios: Literal["all"] | Annotated[list[Identifier], Field(min_length=1, max_length=1000)] = "all"
    weights: Annotated[dict[Identifier, Annotated[float, Field(gt=0, le=1e6)]], Field(max_length=1000)] = {}
    """By scenario; the campaign's if left out."""
    failed: Number | None = None
    """Worth of a measure of failed runs; null: a set with a failed run has no result here. A score has its own."""

    @model_validator(mode="after")
    def _names_a_value(self) -> Self:
        named = [name for name in ("score", "measure", "changes", "distance") if getattr(self, name) is not None]
        if len(named) > 1:
            raise ValueError(f"it names {' and '.join(named)}; give one of them")
        if not named and not getattr(self, "counts_failures", False):
            raise ValueError("it names no value; give score, measure, changes, distance or, as a constraint, rate")
        fields = type(self).model_fields
        others = [name for name in _OF_RUNS if name in fields and getattr(self, name) not in (fields[name].default, "minimise")]
        if others and named in (["changes"], ["distance"]):
            raise ValueError(f"a change from a set is the same in each scenario, and less is better; leave {others[0]} out")
        if self.score is not None and self.failed is not None:
            raise ValueError("a score has a worth of failed runs already; leave `failed` out")
        return self

    @property
    def label(self) -> str:
        """Name in results."""
        change = "changes" if self.changes is not None else "distance" if self.distance is not None else None
        return self.name or self.score or self.measure or change or "failures"


_OF_RUNS = ("scenarios", "weights", "failed", "aggregate", "direction", "at_least", "rate")
"""Fields of goals that say something about runs."""


class ObjectiveSpecification(GoalSpecification):
    """An objective."""

    aggregate: Literal["mean", "min", "max"] | Quantile = "mean"
    """Combines the values of all scenarios into one."""
    direction: Literal["maximise", "minimise"] | None = None
    """Needed for a measure; a score has its own."""
    tolerance: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    """Differences up to it do not count; a score's own tolerance is not taken over."""


class ConstraintSpecification(GoalSpecification):
    """A constraint: without `aggregate`, it has to hold in every scenario.

    With `rate`, for random simulators, a share of the runs may break it. Without score and measure, it is the share that fails.
    """

    aggregate: Literal["mean", "min", "max"] | Quantile | None = None
    """Combines the values of all scenarios into one; null: the constraint holds in each."""
    at_least: Number | None = None
    at_most: Number | None = None
    rate: Annotated[float, Field(ge=1e-9, lt=1)] | None = None
    """Largest share of the runs, over seeds and scenarios, that may be beyond the limit, shown at `replicates.confidence`. A failed run
    is beyond it unless `failed` is not."""

    @property
    def counts_failures(self) -> bool:
        """True if it bounds the rate of failed runs, and so names no value."""
        return self.rate is not None and {self.score, self.measure} == {None} and self.changes is self.distance is None

    @model_validator(mode="after")
    def _has_a_limit(self) -> Self:
        if self.rate is not None and self.aggregate is not None:
            raise ValueError("a rate counts the runs of every scenario; leave `aggregate` out")
        if self.counts_failures:
            if any(given is not None for given in (self.at_least, self.at_most, self.failed)):
                raise ValueError("a limit is one of a score or a measure; name one, or give `rate` alone for failed runs")
            return self
        if (self.at_least is None) == (self.at_most is None):
            raise ValueError(f"it has {'no limit' if self.at_least is None else 'two limits'}; give at_least or at_most")
        if (self.changes or self.distance) and (self.at_most or 0.0) < 0:
            raise ValueError("no set is nearer than 0; give at_most of 0 or more")
        return self


class RobustnessSpecification(Model):
    """Robustness of the best sets against other vehicles (Sections II-C and IV-D).

    Boxes have the half widths k `delta`, k = 1 .. `steps`, in shares of the vehicle parameters' ranges (the paper's Table 8); each box has
    `samples` vehicles. The `condition` `max` allows a change of at most `eta` (in units of the score) in every scenario and vehicle (as in
    the paper). The condition `mean` bounds the vehicles' mean change, relative to the score, strictly below `eta`.
    """

    delta: Annotated[float, Field(gt=0, le=1)] = 0.01
    steps: Annotated[int, Field(ge=1, le=100)] = 10
    samples: Annotated[int, Field(ge=1, le=10_000)] = 30
    eta: Annotated[float, Field(gt=0)] | None = None
    """By default the score's tolerance, or 1 % of its range without one; of a `mean`, 1."""
    condition: Literal["max", "mean"] = "max"
    solutions: Annotated[int, Field(ge=0, le=1000)] = 20
    """Largest number of sets with the best objective to examine, in addition to `sets`. One set of each region of the space comes first."""
    sets: Annotated[list[Values], Field(max_length=1000)] = []
    """Sets to be examined in any case."""
    of: Annotated[str, StringConstraints(min_length=1, max_length=64)] | None = None
    """The id of an ended campaign whose best sets are examined, if this one has no optimizer."""
    seed: Annotated[int, Field(ge=0, le=2**63 - 1)] = 1

    def on(self, scale: Scale) -> "RobustnessSpecification":
        """Returns the settings with a number as `eta`."""
        eta = self.eta or (1.0 if self.condition == "mean" else scale.tolerance or 0.01 * scale.span)
        return self.model_copy(update={"eta": eta})


class ValidationSpecification(Model):
    """A check of results that the influence map allows to reuse (Section V), or of released predictions `of` an ended campaign.

    Latin hypercubes of `samples`, twice as many, ... at most `largest` sets are drawn until their sets with a reduction cover all effects
    of the reducible parameters. Each of these is compared with `references` variants. To check predictions, `samples` of them are simulated
    in each scenario.
    """

    samples: Annotated[int, Field(ge=1, le=1_000_000)] = 200
    references: Annotated[int, Field(ge=1, le=1000)] = 30
    largest: Annotated[int, Field(ge=1, le=1_000_000)] = 20_000
    of: str | None = None
    """The id of an ended campaign whose predictions are examined."""
    seed: Annotated[int, Field(ge=0, le=2**63 - 1)] = 1


def _names_a_map(given: object) -> bool:
    return isinstance(given, MapReference) or (isinstance(given, dict) and "map" in given)


MaybeSensitivity = (
    Annotated[
        Annotated[SensitivitySpecification, Tag("analysis")] | Annotated[MapReference, Tag("map")],
        Discriminator(lambda given: "map" if _names_a_map(given) else "analysis"),
    ]
    | None
)


class ProblemSpecification(Model):
    """The calibration problem, common to campaigns and comparisons."""

    name: Name = "campaign"
    priority: Annotated[int, Field(ge=-100, le=100)] = 0
    """Cells of a higher priority go first; campaigns of the same one share the workers."""
    problem: ProblemName = DEFAULT_PROBLEM
    """The built-in problem, or the name or digest of a pushed bundle; a name means its latest push."""
    catalogue: Catalogue | None = None
    """The scenarios: a catalogue, or a list of scenario ids; null: all of the problem."""
    parameters: Identifier | Annotated[list[ParameterSpecification], Field(min_length=1, max_length=200)] | None = None
    """The searched space: a named one, or a list; null: the problem's own."""
    fixed: Values = {}
    """Values of parameters that are not searched."""
    baseline: Values | None = None
    """The set that results are compared with; null: the problem's own."""
    weights: Annotated[dict[Identifier, Annotated[float, Field(ge=0, le=1e6)]], Field(max_length=1000)] = {}
    """By scenario, in the objective: 1 if left out; 0 leaves a scenario out."""
    driving_function: Identifier | None = None
    vehicle: VehicleSpecification = VehicleSpecification()
    evaluator: Identifier | None = None
    """Rates runs: a score's name, or on the motorway `reference` or `learned`; null: the problem's first score."""
    sensitivity: MaybeSensitivity = None
    """A new analysis, a stored map, or neither."""


class ReplicatesSpecification(Model):
    """Runs of a set in a scenario of a random simulator, under the seeds 1, 2, ...: the same for all sets."""

    least: Annotated[int, Field(ge=1, le=LARGEST_REPLICATES)] = 1
    """Runs of each set that the search asks for."""
    most: Annotated[int, Field(ge=1, le=LARGEST_REPLICATES)] = 20
    """Runs of a set that may be the best."""
    confidence: Annotated[float, Field(ge=0.5, le=0.999)] = 0.95
    """Confidence of intervals, and of the choice of the best set."""
    aggregate: Literal["mean"] | Quantile = "mean"
    """Combines the objectives under a set's seeds. A quantile is one of the objective in its own units, whatever the direction."""

    @property
    def level(self) -> float | None:
        """Level of the quantile; None for the mean."""
        return None if self.aggregate == "mean" else self.aggregate.quantile

    @model_validator(mode="after")
    def _are_ordered(self) -> Self:
        if self.least > self.most:
            raise ValueError(f"least is {self.least} and most is {self.most}; give at least as many")
        if self.level in {0.0, 1.0}:
            raise ValueError("runs do not show the least or the largest objective; give a quantile above 0 and below 1")
        return self


class VariantVehicle(Model):
    """Parameters of a vehicle that differ from the campaign's, by name; of another problem, its varied parameters."""

    parameters: Annotated[dict[Identifier, Number], Field(max_length=100)] = {}


class VariantSpecification(Model):
    """A variant of the product, such as a market: some of the campaign's scenarios, their weights, and its vehicle."""

    scenarios: Literal["all"] | Annotated[_Scenarios, AfterValidator(_each_once)] = "all"
    weights: Annotated[dict[Identifier, Annotated[float, Field(gt=0, le=1e6)]], Field(max_length=1000)] = {}
    """By scenario: 1 if left out; the campaign's without any."""
    vehicle: VariantVehicle = VariantVehicle()


class CampaignSpecification(ProblemSpecification):
    """A whole campaign. Everything has a default: `{}` searches the paper's problem with 100 simulations for each scenario."""

    optimizer: OptimizerSection | None = OptimizerSection()
    """Null if only other stages are requested."""
    budget: BudgetSpecification | None = None
    """The end of the search; null: 100 simulations for each scenario, or the optimizer's own number of iterations."""
    replicates: ReplicatesSpecification = ReplicatesSpecification()
    """Runs of a set in a scenario, if the simulator is random."""
    reduction: ReductionSpecification = Field(default=ReductionSpecification(), validate_default=True)
    """Cells that may be answered without a simulation."""
    robustness: RobustnessSpecification | None = None
    """A study of the best sets in other vehicles, after the search; null: none."""
    validation: ValidationSpecification | None = None
    """A study of reuse or of predictions; null: none."""
    objectives: Annotated[list[ObjectiveSpecification], Field(min_length=1, max_length=20)] | None = None
    """Null: the weighted mean of the campaign's score."""
    constraints: Annotated[list[ConstraintSpecification], Field(max_length=100)] = []
    """On scores and measures; sets that keep them are better than sets that do not."""
    variants: Annotated[dict[Identifier, VariantSpecification], Field(max_length=20)] = {}
    """By name; the search looks for the best set of each, and for the best set that all have in common."""
    common: Literal["mean", "worst"] = "mean"
    """Objective of the best common set: the mean of the variants' objectives, or the worst of them."""

    @field_validator("reduction")
    @classmethod
    def _use_the_map(cls, value: ReductionSpecification, info: ValidationInfo) -> ReductionSpecification:
        return value.beside(info.data.get("sensitivity"))


class RerunSpecification(Model):
    """Changes of a rerun; everything else, with references and influence map, comes from the first campaign.

    Weights of 0 leave scenarios out, missing ones are 1; without any, command line and Python client send the first campaign's. Another
    `evaluator` rates stored runs again, without a simulation; a map from the first one's ratings is made again, mostly from them.
    """

    weights: Annotated[dict[Identifier, Annotated[float, Field(ge=0, le=1e6)]], Field(max_length=1000)]
    name: Name | None = None
    problem: ProblemName | None = None
    """Another push of the first campaign's problem, e.g. with another score: runs of unchanged files are rated again."""
    evaluator: Identifier | None = None
    optimizer: OptimizerSection | None = None
    budget: BudgetSpecification | None = None
    reduction: ReductionSpecification | None = None


class InfluenceSpecification(Model):
    """Expert knowledge of one parameter in one scenario: inclusive influential bounds in parameter units; null is the space's own."""

    influential: bool = True
    lower: Number | None = None
    upper: Number | None = None


class InfluenceMapSpecification(Model):
    """A posted influence map of every push of a `problem`, checked against the grid of `parameters`. What is not listed is influential."""

    name: Name = "influence map"
    problem: ProblemName = DEFAULT_PROBLEM
    catalogue: Catalogue | None = None
    parameters: Identifier | Annotated[list[ParameterSpecification], Field(min_length=1, max_length=200)] | None = None
    driving_function: Identifier | None = None
    scenarios: Annotated[
        dict[Identifier, Annotated[dict[Identifier, InfluenceSpecification], Field(max_length=200)]],
        Field(min_length=1, max_length=1000),
    ]


class EvaluationSpecification(Model):
    """A parameter set in a scenario, or in all of the catalogue. Notes of the answer name values off the grid, simulated as given."""

    parameters: Annotated[Values, Field(min_length=1)]
    scenario: Identifier | None = None
    seeds: Annotated[int, Field(ge=1, le=1000)] | Annotated[list[Seed], Field(min_length=1, max_length=1000)] = 1
    """Runs in a scenario, under the seeds 1, 2, ..., or their seeds. The answer has the means of several."""
    problem: ProblemName = DEFAULT_PROBLEM
    catalogue: Catalogue | None = None
    driving_function: Identifier | None = None
    vehicle: VehicleSpecification = VehicleSpecification()
    evaluator: Identifier | None = None
    fresh: bool = False
    """Simulates again what is stored."""


DECIDING = CampaignSpecification.model_fields.keys() & EvaluationSpecification.model_fields.keys() - {"parameters"}
"""Settings of a campaign that decide the score of a set, and that an evaluation of the set takes from it."""


Tags = Annotated[list[CampaignTag], Field(max_length=20)]


class CampaignChanges(Model):
    """Changes of a campaign's labels; fields that are left out stay. `tags` replaces all tags, `add_tags` and `remove_tags` leave others
    as they are: give these or `tags`. A campaign has at most 20 tags."""

    name: Name | None = None
    tags: Tags | None = None
    add_tags: Tags | None = None
    remove_tags: Tags | None = None

    @field_validator("add_tags", "remove_tags")
    @classmethod
    def _not_with_tags(cls, value: list[str] | None, info: ValidationInfo) -> list[str] | None:
        if value is not None and info.data.get("tags") is not None:
            raise ValueError("`tags` replaces all tags already; leave one of them out")
        return value
