"""NSGA-II and NSGA-III of pymoo as optimizers of several objectives: `optimizer: {kind: nsga2}`, with the extra [pymoo]."""

from math import comb
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import ConfigDict

from drivecal.contracts.specification import OptimizerSpecification
from drivecal.domain.parameters import Indices
from drivecal.domain.rounding import Scaling
from drivecal.optimizers.built_in import ONE_OBJECTIVE, Beginning, BuiltIn
from drivecal.optimizers.repair import searchable
from drivecal.optimizers.replayed import Replayed, named, require, scaled, scalings_of
from drivecal.plugins.ports import Ability, DeclaringOptimizerPlugin, Floats

require("pymoo", extra="pymoo")

NO_RESULT = 1e30
"""Violation of an individual without a result: more than any of a constraint."""
TIE = 1e-6
"""Weight of the rating beside a single objective: it orders equal objectives."""


class Nsga2Settings(OptimizerSpecification):
    """NSGA-II (Deb 2002) with pymoo's operators and their defaults."""

    model_config = ConfigDict(extra="forbid")

    kind: Literal["nsga2"] = "nsga2"


class Nsga3Settings(OptimizerSpecification):
    """NSGA-III (Deb and Jain 2014) with pymoo's operators and their defaults, and as many reference directions as the population holds."""

    model_config = ConfigDict(extra="forbid")

    kind: Literal["nsga3"] = "nsga3"


class NsgaEngine:
    """Searches grid indices as whole numbers. Choices lie in the order of their list.

    pymoo learns the number of objectives, which it minimises, from the first answers.
    """

    def __init__(self, settings: OptimizerSpecification, n_values: Indices) -> None:
        self.library = named("pymoo")
        self._settings = settings
        self._last = searchable(n_values) - 1
        self._algorithm: Any = None
        self._scalings: list[Scaling] = []
        self._asked: Any = None
        self._population: Indices = np.empty((0, len(n_values)), dtype=np.int64)

    def propose(self) -> Indices:
        """See `replayed.Engine`. The last population fills up what pymoo leaves empty in small spaces: it proposes no row twice."""
        self._asked = self._algorithm.ask()
        population = self._population.copy()
        if self._asked is not None:
            population[: len(self._asked)] = self._asked.get("X").astype(np.int64)
        return population

    def learn(self, population: Indices, objectives: Floats, tie_breakers: Floats) -> None:
        """See `replayed.Engine`. Several objectives have violations in the place of tie breakers (`ports.Optimizer.tell`)."""
        violations = tie_breakers
        if objectives.ndim == 1:
            objectives, violations = (objectives + TIE * tie_breakers)[:, None], 0.0 * objectives
        missing = np.isnan(violations) | np.isnan(objectives).any(axis=1)
        self._scalings = self._scalings or scalings_of(objectives)
        costs = np.where(missing[:, None], 0.0, -scaled(objectives, self._scalings))
        violations = np.where(missing, NO_RESULT, violations)
        self._population = population
        rows = np.arange(0 if self._asked is None else len(self._asked))
        if self._algorithm is None:
            rows = np.sort(np.unique(population, axis=0, return_index=True)[1])
            self._algorithm = _algorithm(self._settings, self._last, population[rows], objectives.shape[1])
            self._asked = self._algorithm.ask()
        if len(rows):
            self._asked.set("X", population[rows], "F", costs[rows], "G", violations[rows, np.newaxis])
            self._algorithm.tell(infills=self._asked)


def _algorithm(settings: OptimizerSpecification, last: Indices, first: Indices, n_objectives: int) -> Any:
    """Returns pymoo's algorithm, which begins with distinct sets of the start population."""
    from pymoo.algorithms.moo.nsga2 import NSGA2
    from pymoo.algorithms.moo.nsga3 import NSGA3
    from pymoo.core.duplicate import DuplicateElimination
    from pymoo.core.population import Population
    from pymoo.core.problem import Problem
    from pymoo.operators.crossover.sbx import SBX
    from pymoo.operators.mutation.pm import PM
    from pymoo.operators.repair.rounding import RoundingRepair
    from pymoo.operators.selection.tournament import TournamentSelection
    from pymoo.termination import get_termination

    class Distinct(DuplicateElimination):  # type: ignore[misc]  # a class of pymoo, which has no types
        """Tells rows of whole numbers apart in memory of their number; pymoo's own compares all with all."""

        def _do(self, pop: Any, other: Any, is_duplicate: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
            seen = set() if other is None else {row.tobytes() for row in other.get("X").astype(np.int64)}
            for place, row in enumerate(pop.get("X").astype(np.int64)):
                is_duplicate[place] = row.tobytes() in seen
                if other is None:
                    seen.add(row.tobytes())
            return is_duplicate

    whole = RoundingRepair()
    parts: dict[str, Any] = {
        "pop_size": settings.population,
        "sampling": Population.new("X", first),
        "mutation": PM(eta=20, repair=whole),
        "termination": get_termination("n_gen", settings.iterations + 1),
        "seed": settings.seed % 2**32,
        "output": None,
        "eliminate_duplicates": Distinct(),
    }
    if settings.kind == "nsga2":
        algorithm = NSGA2(crossover=SBX(eta=15, prob=0.9, repair=whole), **parts)
    else:
        selection = TournamentSelection(func_comp=_feasible_first)
        crossover = SBX(eta=30, prob=1.0, repair=whole)
        algorithm = NSGA3(directions(settings.population, n_objectives), selection=selection, crossover=crossover, **parts)
    lower, upper = np.zeros(len(last)), last.astype(np.float64)
    return algorithm.setup(Problem(n_var=len(last), n_obj=n_objectives, n_ieq_constr=1, xl=lower, xu=upper))


def directions(population: int, n_objectives: int) -> Floats:
    """Returns evenly spread reference directions (Das and Dennis 1998), as many as a population holds, shape (n, n_objectives)."""
    from pymoo.util.ref_dirs import get_reference_directions

    if n_objectives == 1:
        return np.ones((1, 1))
    partitions = 1
    while comb(partitions + n_objectives, n_objectives - 1) <= population:
        partitions += 1
    return np.asarray(get_reference_directions("das-dennis", n_objectives, n_partitions=partitions), dtype=np.float64)


def _feasible_first(pop: Any, pairs: Indices, random_state: np.random.Generator, **_: object) -> npt.NDArray[np.int64]:
    """Returns the winners of tournaments between pairs of positions, shape (n, 1): the smaller violation, else either.

    pymoo's own draws between infeasible individuals from an unseeded generator.
    """
    violations = pop.get("CV")[:, 0]
    left, right = violations[pairs[:, 0]], violations[pairs[:, 1]]
    drawn = random_state.integers(0, 2, len(pairs))
    return np.where((left < right) | ((left == right) & (drawn == 0)), pairs[:, 0], pairs[:, 1])[:, np.newaxis]


class NsgaPlugin(BuiltIn[OptimizerSpecification]):
    """`optimizer: {kind: nsga2}` or `{kind: nsga3}`."""

    def __init__(self, name: str, settings: type[OptimizerSpecification]) -> None:
        self.name = name
        self._settings = settings

    @property
    def settings(self) -> type[OptimizerSpecification]:
        """Validates the campaign's `optimizer` section."""
        return self._settings

    @property
    def supports(self) -> frozenset[Ability]:
        """See `drivecal.plugins.ports.DeclaringOptimizerPlugin`."""
        return ONE_OBJECTIVE | {"objectives"}

    def _optimizer(self, settings: OptimizerSpecification, begin: Beginning) -> Replayed:
        return Replayed(begin.population, NsgaEngine(settings, begin.n_values))


NSGA2: DeclaringOptimizerPlugin = NsgaPlugin("nsga2", Nsga2Settings)
NSGA3: DeclaringOptimizerPlugin = NsgaPlugin("nsga3", Nsga3Settings)
