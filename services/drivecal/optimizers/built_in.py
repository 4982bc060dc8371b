"""The built-in optimizers as plug-ins, with the settings that a campaign's `optimizer` section may hold."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Generic, Literal, Protocol, TypeVar, get_args

import numpy as np
from pydantic import BaseModel, Field

from drivecal.contracts.specification import OptimizerSpecification
from drivecal.domain.parameters import Indices, Kind
from drivecal.optimizers.genetic import GeneticAlgorithm, pairs_per_generation
from drivecal.optimizers.population import RandomSearch, start_population
from drivecal.optimizers.swarm import ParticleSwarm
from drivecal.plugins.ports import Ability, Optimizer, OptimizerPlugin

Share = Annotated[float, Field(gt=0, le=1)]


class GeneticSettings(OptimizerSpecification, extra="forbid"):
    """Genetic algorithm: the best sets have children, which mix the values of their parents; some of them change at random.

    Selection, recombination and mutation: the probabilities p_s, p_r and p_m of Table 4; p_m as in Section IV-C.
    """

    kind: Literal["genetic"] = "genetic"
    selection: Annotated[Share, Field(description="Share of the population that may have children.")] = 0.8
    recombination: Annotated[Share, Field(description="Share of those that have some.")] = 0.7
    mutation: Annotated[float, Field(ge=0, le=1, description="Share of the children in which one bit is flipped.")] = 0.5


class RandomSettings(OptimizerSpecification, extra="forbid"):
    """Random search: a part of the population is drawn again in each iteration after the first.

    The default of `renewal` is what the genetic algorithm renews with its own defaults, so that both request equally many cells.
    """

    kind: Literal["random"] = "random"
    renewal: Annotated[Share, Field(description="Share of the population that each iteration draws again.")] = 0.28

    @property
    def renewed(self) -> int:
        """Individuals redrawn per iteration, at least one."""
        return max(1, round(self.renewal * self.population))


class SwarmSettings(OptimizerSpecification, extra="forbid"):
    """Particle swarm: each set moves on, and is pulled to the best that it found and to the best of all.

    Pulls c1 to a particle's own best set and c2 to that of the swarm (Table 4), and the inertia factor, which Eq. 4 leaves blank.
    """

    kind: Literal["swarm"] = "swarm"
    c1: Annotated[float, Field(ge=0, le=1, description="Pull to the set's own best.")] = 0.5
    c2: Annotated[float, Field(ge=0, le=1, description="Pull to the best of all sets.")] = 0.5
    inertia: Annotated[float, Field(ge=0, le=1, description="Share of the last step that is kept.")] = 1.0


Chosen = TypeVar("Chosen", bound=OptimizerSpecification)


class Resumable(Optimizer, Protocol):
    """An optimizer whose state can be replaced by a saved one."""

    def resume(self, state: Mapping[str, Any]) -> None:
        """Continues from `state`. Raises InvalidInputError if it does not fit."""


@dataclass
class BuiltIn(Generic[Chosen]):
    """A plug-in of this package: see `drivecal.plugins.ports.OptimizerPlugin`.

    All kinds of parameters are alike to it: positions, bits and ranks of choices follow the order of their lists.
    """

    name: str
    settings: type[Chosen]
    begin: Callable[[Chosen, Indices, Indices, np.random.Generator], Resumable]
    """Returns an optimizer with settings, a start population, grid sizes, and a source of all its random numbers."""
    renewed: Callable[[Chosen], int] = lambda chosen: chosen.population
    """Returns the largest number of individuals that an iteration after the first requests."""
    supports: frozenset[Ability] = frozenset(get_args(Ability)) - {"objectives"}

    def requested_individuals(self, settings: BaseModel) -> int:
        """Returns the size of the first population, plus the individuals that each further iteration renews."""
        chosen = self._checked(settings)
        return chosen.population + (chosen.iterations - 1) * self.renewed(chosen)

    def create(
        self,
        settings: BaseModel,
        n_values: Indices,
        start: Indices | None = None,
        kinds: Sequence[Kind] | None = None,  # noqa: ARG002  # of the port
    ) -> Optimizer:
        chosen = self._checked(settings)
        generator = np.random.Generator(np.random.PCG64(chosen.seed))
        first = start_population(chosen.start, chosen.population, n_values, generator, start)
        return self.begin(chosen, first, n_values, generator)

    def restore(
        self,
        settings: BaseModel,
        n_values: Indices,
        state: Mapping[str, Any],
        kinds: Sequence[Kind] | None = None,  # noqa: ARG002  # of the port
    ) -> Optimizer:
        """See `drivecal.plugins.ports.OptimizerPlugin`. Raises InvalidInputError if the state does not fit."""
        chosen = self._checked(settings)
        blank = np.zeros((chosen.population, len(n_values)), dtype=np.int64)
        optimizer = self.begin(chosen, blank, n_values, np.random.Generator(np.random.PCG64(chosen.seed)))
        optimizer.resume(state)
        return optimizer

    def _checked(self, settings: BaseModel) -> Chosen:
        if not isinstance(settings, self.settings):
            raise TypeError(f"settings must be {self.settings.__name__}, not {type(settings).__name__}")
        return settings


class ExternalSettings(BaseModel, extra="forbid"):
    """Evaluates the sets that another program proposes, until the budget is used up or that program finishes the campaign."""

    kind: Literal["external"] = "external"
    seed: Annotated[int, Field(ge=0, lt=2**63, description="Seed of the checks of reused answers.")] = 1
    infeasible: Annotated[
        Literal["refuse", "repair"],
        Field(description="Refuses sets outside of the bounds or constraints, or takes a near set that keeps them."),
    ] = "refuse"


class External:
    """An optimizer without a search: its rounds are the sets that another program proposes."""

    name = "external"
    settings: type[BaseModel] = ExternalSettings
    supports: frozenset[Ability] = frozenset(get_args(Ability))


GENETIC: OptimizerPlugin = BuiltIn(
    "genetic",
    GeneticSettings,
    lambda chosen, first, n_values, generator: GeneticAlgorithm(
        first,
        n_values,
        selection=chosen.selection,
        recombination=chosen.recombination,
        mutation=chosen.mutation,
        generator=generator,
    ),
    lambda chosen: pairs_per_generation(chosen.population, chosen.selection, chosen.recombination),  # one child per pair
)
RANDOM: OptimizerPlugin = BuiltIn(
    "random",
    RandomSettings,
    lambda chosen, first, n_values, generator: RandomSearch(first, n_values, renewed=chosen.renewed, generator=generator),
    lambda chosen: chosen.renewed,
)
SWARM: OptimizerPlugin = BuiltIn(
    "swarm",
    SwarmSettings,
    lambda chosen, first, n_values, generator: ParticleSwarm(
        first, n_values, c1=chosen.c1, c2=chosen.c2, inertia=chosen.inertia, generator=generator
    ),
)
EXTERNAL = External()
