"""The chosen optimizer of a campaign with its checked settings, and the end of its search."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import BaseModel, ValidationError

from drivecal.analysis.goals import Goals
from drivecal.contracts.campaign import STUDIES
from drivecal.contracts.input_errors import nearest, problem
from drivecal.contracts.specification import (
    BudgetSpecification,
    CampaignSpecification,
    OptimizerSection,
    SensitivitySpecification,
)
from drivecal.domain.constraints import Constraints
from drivecal.domain.errors import Diagnostics
from drivecal.domain.parameters import Indices
from drivecal.optimizers.built_in import External
from drivecal.optimizers.repair import RepairingOptimizer
from drivecal.plugins import registry
from drivecal.plugins.ports import Ability, Optimizer, OptimizerPlugin
from drivecal.plugins.search import SearchPlugin

ORDERING = "swarm"
"""The built-in optimizer that moves through the values of a parameter in their order."""
SIMULATIONS_OF_A_SCENARIO = 100
"""Simulations for each scenario of a search without a budget."""
BEGINNINGS = {"start_sets", "start_results"}
"""Settings of every search, which no plug-in sees."""
UNLIMITED = 1_000_000
"""Cells that are expected at most of a search without a limit of simulations."""
WITHOUT_POPULATIONS = SearchPlugin | External
"""Optimizers that search by the cell, and another program that proposes the sets."""


@dataclass(frozen=True)
class Optimization:
    """The chosen optimizer with its checked settings, and the end of its search."""

    plugin: OptimizerPlugin | SearchPlugin | External
    settings: BaseModel
    budget: BudgetSpecification | None
    iterations: int | None
    """Largest number of iterations; None if the budget alone ends the search."""

    @property
    def has_populations(self) -> bool:
        """True if the plug-in proposes whole populations."""
        return not isinstance(self.plugin, WITHOUT_POPULATIONS)

    @property
    def by_population(self) -> OptimizerPlugin:
        """The plug-in if it proposes whole populations. Raises TypeError."""
        if isinstance(self.plugin, WITHOUT_POPULATIONS):
            raise TypeError(f"{self.plugin.name} proposes no populations")
        return self.plugin

    @property
    def population(self) -> int:
        """Sets in each iteration; 0 without populations."""
        return int(self._setting("population")) if self.has_populations else 0

    @property
    def seed(self) -> int:
        """Seed of the search."""
        return int(self._setting("seed"))

    def _setting(self, name: str) -> Any:
        """Returns a setting that plug-ins of its kind have."""
        return self.settings.model_dump(include={name})[name]

    def expected_cells(self, scenarios: int) -> tuple[int, int]:
        """Returns the largest numbers of proposed and of requested cells."""
        unknown = 0 if isinstance(self.plugin, External) else UNLIMITED
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
            return self.by_population.create(self.settings, space.n_values, start, space.kinds)
        region = constraints.whole_region
        drawn = region.sample(self.population, np.random.Generator(np.random.PCG64(self.seed)))
        start = drawn if start is None else np.concatenate([start, drawn])[: self.population]
        optimizer = self.by_population.create(self.settings, space.n_values, start, space.kinds)
        return RepairingOptimizer(optimizer, region.repair)

    def restore(self, constraints: Constraints, state: Mapping[str, Any]) -> Optimizer:
        """Returns the optimizer that continues from `state`."""
        space = constraints.space
        optimizer = self.by_population.restore(self.settings, space.n_values, state, space.kinds)
        return RepairingOptimizer(optimizer, constraints.whole_region.repair) if constraints else optimizer


def choose_optimizer(specification: CampaignSpecification, scenarios: int, diagnostics: Diagnostics) -> Optimization | None:
    """Returns the optimizer of a problem with a number of weighted scenarios, with its checked settings; None if none is requested."""
    wanted = specification.optimizer
    if wanted is None:
        analyses = isinstance(specification.sensitivity, SensitivitySpecification)
        if not analyses and not any(getattr(specification, study) for study in STUDIES):
            diagnostics.add("optimizer", "there is nothing to do", "choose an optimizer, an analysis or another stage")
        return None
    plugin = diagnostics.attempt(lambda: registry.optimizer(wanted.kind))
    if plugin is None:
        return None
    try:
        settings = plugin.settings.model_validate(wanted.model_dump(exclude=BEGINNINGS, exclude_none=True))
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
    if budget is None and isinstance(plugin, SearchPlugin):
        budget = BudgetSpecification(simulations=SIMULATIONS_OF_A_SCENARIO * max(1, scenarios))
    is_endless = isinstance(plugin, WITHOUT_POPULATIONS) or (budget is not None and wanted.iterations is None)
    iterations = None if is_endless else int(settings.model_dump(include={"iterations"})["iterations"])
    return Optimization(plugin, settings, budget, iterations)


def settled_search(specification: CampaignSpecification, chosen: Optimization | None) -> dict[str, Any]:
    """Returns the specification's optimizer and budget with their defaults, by field."""
    if chosen is None or specification.optimizer is None:
        return {}
    left_out = BEGINNINGS if chosen.iterations is not None else BEGINNINGS | {"iterations"}
    settings = specification.optimizer.model_dump(include=BEGINNINGS) | chosen.settings.model_dump(exclude=left_out)
    return {"optimizer": OptimizerSection.model_validate(settings), "budget": chosen.budget}


def note_search(optimization: Optimization | None, constraints: Constraints | None) -> tuple[str, ...]:
    """Notes how the search treats constraints, and choices to which an optimizer gives an order."""
    if optimization is None or constraints is None:
        return ()
    notes: list[str] = []
    free = {parameter.name for parameter in constraints.space.searched}
    if breakable := [text for text, names in constraints.read.items() if names & free]:
        notes.append(f"sets that break {', '.join(breakable)} are replaced by feasible ones near them")
    choices = [parameter.name for parameter in constraints.space.searched if parameter.choices]
    if choices and optimization.plugin.name == ORDERING:
        notes.append(f"{optimization.plugin.name} treats the choices of {', '.join(choices)} as ordered, as they are listed")
    return tuple(notes)


def check_abilities(
    optimization: Optimization | None, constraints: Constraints | None, goals: Goals, diagnostics: Diagnostics
) -> None:
    """Adds a problem for each kind of parameter that the optimizer does not search, for constraints on parameters that it does not cope
    with, and for several objectives or constraints on results if it handles a single number only."""
    if optimization is None or constraints is None:
        return
    wanted: set[Ability] = {*constraints.space.kinds, *(("constraints",) if constraints else ())}
    name = optimization.plugin.name
    if goals.is_vector and "objectives" not in optimization.plugin.supports:
        message = f"{name} searches by a single number, without constraints on results"
        diagnostics.add("optimizer.kind", message, "choose surrogate, or give one objective and no constraints")
    for ability in sorted(wanted - optimization.plugin.supports):
        concerned = [parameter.name for parameter in constraints.space.searched if parameter.kind == ability]
        message = f"{name} does not support {ability} parameters ({', '.join(concerned)})"
        if ability == "constraints":
            message = f"{name} does not support constraints"
        remedy = f"choose another optimizer, or let the plug-in declare {ability!r} in `supports`"
        diagnostics.add("optimizer.kind", message, remedy)
