"""Comparisons of optimizers, and of reductions: what a user submits, and what the service answers.

A comparison is a campaign of kind `comparison`: the same problem is calibrated by each optimizer from start populations of each size
under each seed with each reduction, and every such run is an ordinary campaign of its own.
"""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator

from drivecal.contracts.campaign import Answer
from drivecal.contracts.specification import (
    LARGEST_ITERATIONS,
    LARGEST_POPULATION,
    ProblemSpecification,
    ReductionMode,
    ReductionSpecification,
)
from drivecal.contracts.strict_json import UNIQUE, Identifier, Label, Name

AnyReduction = ReductionMode | ReductionSpecification
EXACT_ALONE: list[AnyReduction] = ["exact"]
LARGEST_RUNS = 1_000
"""Runs of one comparison."""


class ComparedOptimizer(BaseModel):
    """An optimizer with its own settings, checked by its plug-in; `label` is its name in the tables, its
    kind if none is given. Population, iterations, start and seed are the comparison's."""

    model_config = ConfigDict(extra="allow", strict=True, frozen=True, allow_inf_nan=False)

    kind: Identifier
    label: Label | None = None


class ComparisonSpecification(ProblemSpecification):
    """Every optimizer x population x seed x reduction is a run. The start population depends on its size (and, where `start` is `lhs`, on
    the seed), never on the optimizer."""

    kind: Literal["comparison"] = "comparison"
    name: Name = "comparison"
    optimizers: Annotated[list[ComparedOptimizer], Field(min_length=1, max_length=50)]
    populations: Annotated[
        list[Annotated[int, Field(ge=2, le=LARGEST_POPULATION)]], Field(min_length=1, max_length=50, json_schema_extra=UNIQUE)
    ]
    seeds: Annotated[
        list[Annotated[int, Field(ge=0, le=2**63 - 1)]], Field(min_length=3, max_length=LARGEST_RUNS, json_schema_extra=UNIQUE)
    ]
    """At least three, as in the paper: fewer say nothing about chance."""
    iterations: Annotated[int, Field(ge=1, le=LARGEST_ITERATIONS)] = 80
    start: Literal["lhs", "halton"] = "halton"
    reductions: Annotated[list[AnyReduction], Field(min_length=1, max_length=20, json_schema_extra=UNIQUE)] = Field(
        default_factory=lambda: EXACT_ALONE
    )
    """Modes, alone or with settings; only those that use a map or `narrow` get it. The others are compared with the first, seed by seed.
    Runs with references or predictions confirm up to 100 sets unless `confirm` is given."""
    at_a_time: Annotated[int, Field(ge=1, le=64)] = 4
    """Runs that are active at the same time, so that workers need not wait for the last cell of one run's iteration. Changes no result."""

    @field_validator("reductions")
    @classmethod
    def _use_the_map(cls, value: list[AnyReduction], info: ValidationInfo) -> list[AnyReduction]:
        """Settles settings without a mode as a campaign does."""
        sensitivity = info.data.get("sensitivity")
        return [each.beside(sensitivity) if isinstance(each, ReductionSpecification) else each for each in value]


class ExpectedComparison(Answer):
    """Upper bounds of a comparison's cost: proposed cells, simulations without sharing between runs, and their time.

    Runs simulate together what they have in common, the start population first of all; so it will be less.
    """

    runs: int
    proposed: int
    at_most: int
    milliseconds: float
    """Time for which one simulation occupies a worker: CPU time, or wall-clock time if the simulator waits."""
    measured: bool
    """Whether that was measured in these setups; else none was made yet, and it is assumed."""
    workers: int | None
    """Workers at this moment; null if the dispatcher is silent."""
    seconds: float | None
    """`at_most` simulations on the `workers`, without planning, optimizers and predictions; null if workers are unknown."""
    notes: list[str] = Field(default_factory=list)


class ComparedRun(Answer):
    """A run. Iterations count from 1; `best` is the best objective, shared by `alternatives` sets.

    `simulations`: cells of its calibration that had no answer among the run's own earlier cells or its predictions, simulated by any
    campaign: the simulations that the run alone would need on an empty database. `confirmations` of them follow the search, to simulate
    its best set. `analysis`: the same of its sensitivity stage. `converged_at`: the iteration after which the best objective stayed for
    at least 10 further iterations, null if it did not; `alternatives_converged_at`: after which the number of alternatives
    stayed for more than 5. `success`: no run of the comparison found better.
    """

    run: str
    """The id of its campaign."""
    optimizer: str
    population: int
    seed: int
    reduction: str
    state: str
    iterations: int
    requested: int
    simulations: int
    confirmations: int = 0
    analysis: int
    best: float | None
    simulated_best: float | None = None
    """The best objective of a set whose every score was simulated for itself. If references answer cells, a search prefers sets whose
    scores are too good: `best` is what it believed, this is what it has. Runs with reuse have their best set simulated after the search,
    and the next one if it falls (`reduction.confirm`): then this is the objective of the first set of the final ranking. Of runs that
    are not that far, ended before, are of an earlier release or note that their best set is not confirmed, it is a lower bound.
    Groups, pairs and successes use this value."""
    rating: float | None
    """The weighted continuous rating of the best set, which tells optima of the same objective apart; as the search believed, as are
    `alternatives` and `mean`."""
    alternatives: int
    mean: float | None
    """Mean objective of the last population."""
    converged_at: int | None
    simulations_to_converge: int | None
    alternatives_converged_at: int | None
    success: bool


class ComparedGroup(Answer):
    """The runs of one optimizer, population size and reduction.

    `best`, `mean`, `minimum` (the worst: the highest of an objective to minimise): over the final optima (`simulated_best` of the table
    `comparison`) of its `seeds` runs that have one; the means of iterations and simulations to convergence are over the `converged` ones.
    """

    optimizer: str
    population: int
    reduction: str
    seeds: int
    best: float | None
    mean: float | None
    minimum: float | None
    rating: float | None
    """Mean, of the best sets."""
    alternatives: float | None
    """Mean number of alternative optima."""
    simulations: float | None
    """Mean number of simulations."""
    converged: int
    iterations_to_converge: float | None
    simulations_to_converge: float | None
    successes: int


class ComparedPair(Answer):
    """Two ended runs that differ in the reduction alone. `best`, `base_best`: their final optima (`simulated_best` of the table
    `comparison`); `difference`: that of `run` less that of `base_run`; `saved`: simulations."""

    optimizer: str
    population: int
    seed: int
    reduction: str
    base: str
    run: str
    base_run: str
    best: float
    base_best: float
    difference: float
    simulations: int
    base_simulations: int
    saved: int


class ReductionEffect(Answer):
    """The pairs of one optimizer and population size, or of all (null), summed up.

    `mean_difference` with the 95 % confidence interval of Student's t, null for less than two pairs and without spread. `better`, `equal`,
    `worse`: the final optimum with the reduction; `sign_test`: two-sided p of the exact sign test; `different_upper_95`: upper end of the
    exact 95 % interval of the share of searches that end elsewhere. `saved_share`: of the simulations without it.
    """

    optimizer: str | None
    population: int | None
    reduction: str
    base: str
    pairs: int
    mean_difference: float
    lower_95: float | None
    upper_95: float | None
    better: int
    equal: int
    worse: int
    sign_test: float
    different_upper_95: float
    simulations: int
    base_simulations: int
    saved_share: float
