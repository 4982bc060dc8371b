"""Resolves each part of a specification against the installed plug-ins, and adds its problems to the diagnostics."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import BaseModel, ValidationError

from drivecal.analysis.goals import Goals
from drivecal.campaigns.resolve.diagnostics import Diagnostics
from drivecal.campaigns.resolve.spaces import Parameterised, given_set
from drivecal.contracts.campaign import STUDIES
from drivecal.contracts.input_errors import nearest, problem
from drivecal.contracts.specification import (
    BudgetSpecification,
    CampaignSpecification,
    OptimizerSection,
    SensitivitySpecification,
    SeparateThresholds,
)
from drivecal.domain.constraints import Constraints
from drivecal.domain.parameters import Indices, ParameterSet, ParameterSpace, Setting
from drivecal.domain.scales import COMFORT, Scale
from drivecal.domain.scenarios import Scenario
from drivecal.domain.vehicles import VehicleParameter
from drivecal.optimizers.external import External
from drivecal.optimizers.repair import RepairingOptimizer, create_optimizer, lacking, restore_optimizer, supported
from drivecal.plugins import registry
from drivecal.plugins.ports import Ability, ConstrainedFunction, Optimizer, OptimizerPlugin
from drivecal.plugins.search import SearchPlugin
from drivecal.sensitivity import thresholds
from drivecal.sensitivity.analysis import SensitivityAnalysis
from drivecal.sensitivity.thresholds import SensitivitySettings

ORDERING = ("swarm", "cma_es")
"""Built-in optimizers that move through the values of a parameter in their order."""
MOST_WRONG_SETS = 200
"""Problems after which further start sets are not checked."""


BY_DEFAULT = 100
"""Simulations for each scenario of a search without a budget."""
UNLIMITED = 1_000_000
"""Cells that are expected at most of a search without a limit of simulations."""


@dataclass(frozen=True)
class Optimization:
    """The chosen optimizer with its checked settings, and the end of its search."""

    plugin: OptimizerPlugin | SearchPlugin
    settings: BaseModel
    budget: BudgetSpecification | None
    iterations: int | None
    """Largest number of iterations; None if the budget alone ends the search."""

    @property
    def by_cell(self) -> SearchPlugin | None:
        """The plug-in if it searches by the cell."""
        return self.plugin if isinstance(self.plugin, SearchPlugin) else None

    @property
    def is_external(self) -> bool:
        """True if another program proposes the sets."""
        return isinstance(self.plugin, External)

    @property
    def by_population(self) -> OptimizerPlugin:
        """The plug-in if it proposes whole populations. Raises TypeError."""
        if isinstance(self.plugin, SearchPlugin):
            raise TypeError(f"{self.plugin.name} searches by the cell")
        return self.plugin

    @property
    def population(self) -> int:
        """Sets in each iteration; 0 of a search by the cell."""
        return 0 if self.by_cell is not None else int(self._setting("population"))

    @property
    def seed(self) -> int:
        """Seed of the search."""
        return int(self._setting("seed"))

    def _setting(self, name: str) -> Any:
        """Returns a setting that plug-ins of its kind have."""
        return self.settings.model_dump(include={name})[name]

    def expected_cells(self, scenarios: int) -> tuple[int, int]:
        """Returns the largest numbers of proposed and of requested cells."""
        unknown = 0 if self.is_external else UNLIMITED
        most = unknown if self.budget is None or self.budget.simulations is None else self.budget.simulations
        if self.iterations is None:
            return most, most
        requested = self.by_population.requested_individuals(self.settings)
        return self.population * self.iterations * scenarios, requested * scenarios

    def begin(self, constraints: Constraints, start: Indices | None) -> Optimizer:
        """Returns a new optimizer of the space whose proposals keep the constraints; `start`: rows of its first population.

        Constraints fill the population up with feasible rows, for the optimizer's own start design knows none.
        """
        space = constraints.space
        if not constraints:
            return create_optimizer(self.by_population, self.settings, space.n_values, space.kinds, start)
        region = constraints.whole_region
        drawn = region.sample(self.population, np.random.Generator(np.random.PCG64(self.seed)))
        start = drawn if start is None else np.concatenate([start, drawn])[: self.population]
        optimizer = create_optimizer(self.by_population, self.settings, space.n_values, space.kinds, start)
        return RepairingOptimizer(optimizer, region.repair)

    def restore(self, constraints: Constraints, state: Mapping[str, Any]) -> Optimizer:
        """Returns the optimizer that continues from `state`."""
        space = constraints.space
        optimizer = restore_optimizer(self.by_population, self.settings, space.n_values, space.kinds, state)
        return RepairingOptimizer(optimizer, constraints.whole_region.repair) if constraints else optimizer


def find_scenarios(
    catalogue: str | list[str], listed: Sequence[str], diagnostics: Diagnostics
) -> dict[str, tuple[str, Scenario]]:
    """Returns scenarios of installed catalogues by id, in the catalogues' order.

    Args:
        catalogue: a catalogue's name, or ids of scenarios.
        listed: all ids of the specification, in whose order faults are numbered.
        diagnostics: gets the faults.

    Returns:
        the catalogue's name and the scenario, by the scenario's id.
    """
    if isinstance(catalogue, str):
        loaded = diagnostics.attempt(lambda: registry.catalogue(catalogue))
        return {} if loaded is None else {name: (loaded.name, scenario) for name, scenario in loaded.scenarios.items()}
    every: dict[str, list[tuple[str, Scenario]]] = {}
    for offered in registry.catalogues():
        for name, scenario in offered.scenarios.items():
            every.setdefault(name, []).append((offered.name, scenario))
    for name in catalogue:
        index = listed.index(name)
        if name not in every:
            diagnostics.add(f"catalogue[{index}]", f"there is no scenario {name!r}", f"installed: {', '.join(every)}")
        elif len(every[name]) > 1:
            owners = [owner for owner, _ in every[name]]
            message = f"{len(owners)} catalogues have a scenario {name!r}: {', '.join(owners)}"
            diagnostics.add(f"catalogue[{index}]", message, f"name one of the catalogues, e.g. catalogue: {owners[0]}")
    return {name: entries[0] for name, entries in every.items() if name in catalogue}


def note_threshold(specification: CampaignSpecification) -> tuple[str, ...]:
    """Notes the rate of misses of the threshold `auto` for an analysis' number of samples."""
    wanted = specification.sensitivity
    if not isinstance(wanted, SensitivitySpecification) or wanted.threshold != "auto":
        return ()
    return (thresholds.tolerance_text(wanted.samples),)


def choose_optimizer(specification: CampaignSpecification, scenarios: int, diagnostics: Diagnostics) -> Optimization | None:
    """Returns the optimizer of a problem with a number of weighted scenarios, with its checked settings; None if none is requested."""
    wanted = specification.optimizer
    if wanted is None:
        analyses = isinstance(specification.sensitivity, SensitivitySpecification)
        if not analyses and not any(getattr(specification, study) for study in STUDIES):
            diagnostics.add(
                "optimizer", "there is nothing to do", "choose an optimizer, a sensitivity analysis or another stage"
            )
        return None
    plugin = diagnostics.attempt(lambda: registry.optimizer(wanted.kind))
    if plugin is None:
        return None
    try:
        settings = plugin.settings.model_validate(wanted.model_dump(exclude={"start_sets"}, exclude_none=True))
    except ValidationError as error:
        for detail in error.errors(include_url=False):
            field = ".".join(["optimizer", *(str(part) for part in detail["loc"])])
            if detail["type"] == "extra_forbidden":
                remedy = nearest(str(detail["loc"][-1]), list(plugin.settings.model_fields))
                diagnostics.add(field, f"{plugin.name} has no such setting", remedy)
            else:
                diagnostics.problems.append(problem(field, detail))
        return None
    budget = specification.budget
    if budget is None and isinstance(plugin, SearchPlugin) and not isinstance(plugin, External):
        budget = BudgetSpecification(simulations=BY_DEFAULT * max(1, scenarios))
    ends_by_budget = budget is not None and wanted.iterations is None
    iterations = (
        None
        if ends_by_budget or isinstance(plugin, SearchPlugin)
        else int(settings.model_dump(include={"iterations"})["iterations"])
    )
    return Optimization(plugin, settings, budget, iterations)


def settled_search(specification: CampaignSpecification, chosen: Optimization | None) -> dict[str, Any]:
    """Returns the specification's optimizer and budget with their defaults, by field."""
    if chosen is None or specification.optimizer is None:
        return {}
    left_out = {"start_sets"} if chosen.iterations is not None else {"start_sets", "iterations"}
    settings = specification.optimizer.model_dump(include={"start_sets"}) | chosen.settings.model_dump(exclude=left_out)
    return {"optimizer": OptimizerSection.model_validate(settings), "budget": chosen.budget}


def own_baseline(
    given: Mapping[str, Setting] | None, constraints: Constraints | None
) -> tuple[ParameterSet | None, tuple[str, ...]]:
    """The problem's baseline, and a note if this campaign's space does not hold it."""
    diagnostics = Diagnostics()
    baseline = given_set(given, constraints, "baseline", diagnostics)
    if not diagnostics.problems:
        return baseline, ()
    return None, (f"the problem's baseline is left out: {'; '.join(str(problem) for problem in diagnostics.problems)}",)


def find_start_sets(
    specification: CampaignSpecification,
    baseline: ParameterSet | None,
    constraints: Constraints | None,
    diagnostics: Diagnostics,
    population: int | None,
) -> tuple[ParameterSet, ...]:
    """Returns the sets that a search begins with, each once: the baseline, then sets from expert knowledge. `population`: the most."""
    wanted = specification.optimizer
    listed = [] if wanted is None else wanted.start_sets
    start_sets: list[ParameterSet | None] = []
    for index, given in enumerate(listed):
        if len(diagnostics.problems) > MOST_WRONG_SETS:
            break  # enough for one message
        start_sets.append(given_set(given, constraints, f"optimizer.start_sets[{index}]", diagnostics))
    together = tuple(dict.fromkeys(parameter_set for parameter_set in (baseline, *start_sets) if parameter_set is not None))
    if population is not None and len(together) > population:
        message = f"{len(together)} sets, the baseline included, do not fit into a population of {population}"
        diagnostics.add("optimizer.start_sets", message, "give fewer, or a larger population")
    return together


def find_robust_sets(
    specification: CampaignSpecification,
    varied: Sequence[VehicleParameter],
    constraints: Constraints | None,
    diagnostics: Diagnostics,
) -> tuple[ParameterSet, ...]:
    """The sets that the robustness stage always examines; adds the stage's problems."""
    wanted = specification.robustness
    if wanted is None:
        return ()
    if specification.optimizer is None and not wanted.sets and wanted.of is None:
        remedy = "choose an optimizer, or name sets in robustness.sets or a campaign in robustness.of"
        diagnostics.add("robustness", "there are no solutions to examine", remedy)
    if not wanted.solutions and not wanted.sets:
        diagnostics.add("robustness.solutions", "0 examines no set", "give at least 1, or name sets in robustness.sets")
    if specification.optimizer is not None and wanted.of is not None:
        diagnostics.add("robustness.of", "this campaign searches its own solutions", "leave it out, or give optimizer: null")
    if not varied:
        remedy = "leave it out, declare `varied` in problem.yaml, or give the conditions to be robust against as scenarios"
        diagnostics.add("robustness", "the problem has no varied parameters", remedy)
    named = [given_set(given, constraints, f"robustness.sets[{index}]", diagnostics) for index, given in enumerate(wanted.sets)]
    return tuple(dict.fromkeys(parameter_set for parameter_set in named if parameter_set is not None))


def check_units(specification: CampaignSpecification, scale: Scale, diagnostics: Diagnostics) -> None:
    """Adds a problem for every difference of scores that is wider than their range."""
    wanted = specification.robustness
    given = {} if wanted is None else {"robustness.eta": wanted.eta}
    given |= {} if specification.reduction.tolerance is None else {"reduction.tolerance": specification.reduction.tolerance}
    for field, value in given.items():
        if value > scale.span:
            message = f"{value:g} is more than the whole range of the score {scale.name}, {scale.lower:g} to {scale.upper:g}"
            diagnostics.add(field, message, f"give at most {scale.amount(scale.span)}")


def note_predictions(specification: CampaignSpecification, scale: Scale) -> tuple[str, ...]:
    """Notes that scores without steps are hardly predicted if no difference is tolerated."""
    reduction = specification.reduction
    if specification.optimizer is None or not reduction.predicts or scale.step is not None or reduction.tolerance_on(scale) > 0:
        return ()
    remedy = "a `tolerance` of the score in problem.yaml, or `reduction.tolerance`, lets predictions answer cells"
    return (f"the score {scale.name} has neither steps nor a tolerance, so hardly any prediction is right: {remedy}",)


def check_validation(specification: CampaignSpecification, diagnostics: Diagnostics) -> None:
    """Adds a problem if there is no map to validate, if the numbers do not fit, or if a search would seem to have another's errors."""
    wanted = specification.validation
    if wanted is None:
        return
    if specification.optimizer is not None and wanted.of is not None:
        diagnostics.add("validation.of", "this campaign searches its own solutions", "leave it out, or give optimizer: null")
    if specification.sensitivity is None and wanted.of is None:
        diagnostics.add("validation", "there is no influence map to validate", "ask for a sensitivity analysis, or name a map")
    if wanted.of is None and wanted.largest < wanted.samples:
        message = f"{wanted.largest:,} is less than the first {wanted.samples:,} samples"
        diagnostics.add("validation.largest", message, "give at least as many")


def note_search(optimization: Optimization | None, constraints: Constraints | None) -> tuple[str, ...]:
    """Notes how the search treats constraints, and choices to which an optimizer gives an order."""
    if optimization is None or constraints is None:
        return ()
    notes: list[str] = []
    if constraints:
        notes.append(f"sets that break {', '.join(constraints.listed)} are replaced by feasible ones near them")
    choices = [parameter.name for parameter in constraints.space.searched if parameter.choices]
    if choices and optimization.plugin.name in ORDERING:
        notes.append(
            f"{optimization.plugin.name} treats the choices of {', '.join(choices)} as ordered, as they are listed; optuna does not"
        )
    return tuple(notes)


def constraints_of(function: Parameterised, space: ParameterSpace) -> Constraints:
    """Returns the constraints of a driving function; none for a plug-in without."""
    return Constraints(space, function.constraints if isinstance(function, ConstrainedFunction) else {})


def find_constraints(function: Parameterised | None, space: ParameterSpace, diagnostics: Diagnostics) -> Constraints | None:
    """The constraints of the search; None if they leave nothing, with the problem in `diagnostics`."""
    if function is None:
        return None
    constraints = constraints_of(function, space)
    if constraints:
        last = space.n_values - 1
        if diagnostics.attempt(lambda: constraints.region(0 * last, last)) is None:
            return None
    return constraints


def check_abilities(
    optimization: Optimization | None, constraints: Constraints | None, goals: Goals | None, diagnostics: Diagnostics
) -> None:
    """Adds a problem for each kind of parameter that the optimizer does not search, for constraints on parameters that it does not cope
    with, and for several objectives or constraints on results if it handles a single number only."""
    if optimization is None or constraints is None:
        return
    wanted: set[Ability] = {*constraints.space.kinds, *(("constraints",) if constraints else ())}
    name = optimization.plugin.name
    if goals is not None and goals.is_vector and "objectives" not in supported(optimization.plugin):
        message = f"{name} searches by a single number, without constraints on results"
        diagnostics.add("optimizer.kind", message, "choose surrogate or optuna, or give one objective and no constraints")
    for ability in lacking(optimization.plugin, wanted):
        concerned = [parameter.name for parameter in constraints.space.searched if parameter.kind == ability]
        message = f"{name} does not support {ability} parameters ({', '.join(concerned)})"
        if ability == "constraints":
            message = f"{name} does not support constraints"
        remedy = f"choose another optimizer, or let the plug-in declare {ability!r} in `supports`"
        diagnostics.add("optimizer.kind", message, remedy)


def plan_analysis(
    wanted: SensitivitySpecification, constraints: Constraints, scenarios: Sequence[str], scale: Scale = COMFORT
) -> SensitivityAnalysis:
    """Plans a new sensitivity analysis. Raises InvalidInputError if the space does not allow it."""
    threshold = wanted.threshold
    settings = SensitivitySettings(
        design=wanted.design,
        intervals=wanted.intervals,
        samples=wanted.samples,
        threshold=thresholds.MuSigmaThresholds(threshold.mu, threshold.sigma)
        if isinstance(threshold, SeparateThresholds)
        else threshold,
        seed=wanted.seed,
        sequential=wanted.sequential,
    )
    feasible = constraints.feasible if constraints else None
    return SensitivityAnalysis(constraints.space, scenarios, settings, scale, feasible)


def normalise_weights(
    given: Mapping[str, float], scenarios: Sequence[str], diagnostics: Diagnostics
) -> tuple[dict[str, float], tuple[str, ...]]:
    """Positive weights by scenario, of sum 1 (Eq. 6), with a note that names the scenarios of weight 0."""
    for name in given:
        if scenarios and name not in scenarios:
            diagnostics.add(
                f"weights.{name}", f"there is no scenario {name!r} in the catalogue", f"one of {', '.join(scenarios)}"
            )
    weights = {name: float(given.get(name, 1.0)) for name in scenarios}
    total = sum(weights.values())
    if scenarios and total == 0:
        diagnostics.add(
            "weights", "all weights are 0, so nothing would be simulated", "give at least one scenario a positive weight"
        )
        return {}, ()
    left_out = [name for name, weight in weights.items() if weight == 0]
    notes = (f"not simulated because their weight is 0: {', '.join(left_out)}",) if left_out else ()
    return {name: weight / total for name, weight in weights.items() if weight > 0}, notes
