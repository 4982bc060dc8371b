"""Comparisons of optimizers and reductions: the file that a user submits, and the analysis of campaigns with a common tag.

A comparison is no object of its own: each optimizer calibrates the same problem from start populations of each size under each seed
with each reduction, in an ordinary campaign with the comparison's tag.
"""

from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator

from drivecal.contracts.campaign import Answer, Pace
from drivecal.contracts.specification import (
    LARGEST_ITERATIONS,
    LARGEST_POPULATION,
    BudgetSpecification,
    Model,
    ProblemSpecification,
    ReductionMode,
    ReductionSpecification,
)
from drivecal.contracts.strict_json import UNIQUE, Identifier, Name

AnyReduction = ReductionMode | ReductionSpecification
EXACT_ALONE: list[AnyReduction] = ["exact"]
LARGEST_RUNS = 1_000
"""Campaigns of one comparison."""


class ComparedOptimizer(Model, extra="allow"):
    """An optimizer with its own settings, checked by its plug-in. Population, iterations, start and seed are the comparison's."""

    kind: Identifier


class ComparisonSpecification(ProblemSpecification):
    """A campaign for every optimizer x population x seed x reduction. A search by the cell has no population, and one campaign for all.

    The start population depends on its size (and on the seed if `start` is `lhs`), never on the optimizer.
    """

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
    budget: BudgetSpecification | None = None
    """The end of every search, in the place of `iterations`."""
    start: Literal["lhs", "halton"] = "lhs"
    reductions: Annotated[list[AnyReduction], Field(min_length=1, max_length=20, json_schema_extra=UNIQUE)] = Field(
        default_factory=lambda: EXACT_ALONE
    )
    """Modes, alone or with settings. Only modes that use a map get it.
    All are `isolated`; those with references or predictions confirm up to 100 sets unless `confirm` is given."""

    @field_validator("reductions")
    @classmethod
    def _use_the_map(cls, value: list[AnyReduction], info: ValidationInfo) -> list[AnyReduction]:
        """Settles settings without a mode as a campaign does."""
        sensitivity = info.data.get("sensitivity")
        return [each.beside(sensitivity) if isinstance(each, ReductionSpecification) else each for each in value]


class ExpectedComparison(Pace):
    """Upper bounds of a comparison's cost: proposed cells, simulations without sharing between campaigns, and their time.

    Campaigns simulate together what they have in common, the start population first of all; so it will be less.
    """

    runs: int
    proposed: int
    at_most: int


class Improvement(Answer):
    """An iteration, counted from 1, after which a run had another best set; `simulations` of the run up to there."""

    iteration: int
    simulations: int
    best: float
    rating: float | None


class ComparedRun(Answer):
    """A compared campaign. `best` is its best objective, shared by `alternatives` sets.

    `simulations`: cells of its calibration that had no answer among the run's own earlier cells or its predictions. An isolated campaign
    needs as many on an empty database. `confirmations` of them follow the search, to simulate its best set. `analysis`: the same of its
    sensitivity stage. `converged_at`: the iteration after which the best objective stayed for at least 10 further iterations, null if it
    did not. `success`: no compared campaign found better; null of random simulators.
    """

    campaign: str
    name: str
    optimizer: str
    """Its kind, with the settings that differ between the compared campaigns."""
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
    scores are too good: `best` is what it believed, this is what it has. A campaign with `reduction.confirm` has its best set simulated
    after the search, and the next one if it falls: then this is the objective of the first set of the final ranking. Otherwise, before
    its end, or if a note says that the best set is not confirmed, it is a lower bound. Of a random simulator it is the reported objective,
    and `best` that of lucky runs. Groups and successes use this value."""
    rating: float | None
    """The weighted continuous rating of the best set, which separates optima of the same objective; as the search believed, as are
    `alternatives` and `mean`."""
    alternatives: int
    mean: float | None
    """Mean objective of the last population."""
    converged_at: int | None
    simulations_to_converge: int | None
    success: bool | None
    course: list[Improvement]
    """The first iteration with a result, each that improved on it, and the last one."""


class ComparedGroup(Answer):
    """The campaigns of one optimizer, population size and reduction.

    `best`, `mean`, `minimum` (the worst: the highest of an objective to minimise): over the final optima (`simulated_best`) of its `seeds`
    campaigns that have one; the means of iterations and simulations to convergence are over the `converged` ones. Of random simulators
    `rating`, `alternatives` and `successes` are null, and `after` is empty: during a search they are luck.
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
    successes: int | None
    """Campaigns whose best set is as good as the best of all."""
    after: dict[int, float | None] = Field(default_factory=dict)
    """Mean of the best objectives after a quarter, a half and all of the simulations that every compared campaign has made."""


class Comparison(Answer):
    """The campaigns of a tag, compared: in their order, and by optimizer, population and reduction."""

    tag: str
    direction: Literal["maximise", "minimise"]
    runs: list[ComparedRun]
    groups: list[ComparedGroup]
