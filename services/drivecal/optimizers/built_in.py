"""The built-in optimizers as plug-ins, with the settings that a campaign's `optimizer` section may hold."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Generic, Literal, Protocol, TypeVar, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from drivecal.contracts.specification import OptimizerSpecification
from drivecal.domain.parameters import Indices, Kind
from drivecal.optimizers.genetic import GeneticAlgorithm, pairs_per_generation
from drivecal.optimizers.population import RandomSearch, start_population
from drivecal.optimizers.swarm import ParticleSwarm
from drivecal.plugins.ports import Ability, DeclaringOptimizerPlugin, Optimizer

ONE_OBJECTIVE: frozenset[Ability] = frozenset(get_args(Ability)) - {"objectives"}
Share = Annotated[float, Field(gt=0, le=1)]


class GeneticSettings(OptimizerSpecification):
    """Genetic algorithm: the best sets have children, which mix the values of their parents; some of them change at random.

    Selection, recombination and mutation: the probabilities p_s, p_r and p_m of Table 4; p_m as in Section IV-C.
    """

    model_config = ConfigDict(extra="forbid")

    kind: Literal["genetic"] = "genetic"
    selection: Annotated[Share, Field(description="Share of the population that may have children.")] = 0.8
    recombination: Annotated[Share, Field(description="Share of those that have some.")] = 0.7
    mutation: Annotated[float, Field(ge=0, le=1, description="Share of the children in which one bit is flipped.")] = 0.5


class RandomSettings(OptimizerSpecification):
    """Random search: a part of the population is drawn again in each iteration after the first.

    The default of `renewal` is what the genetic algorithm renews with its own defaults, so that both request equally many cells.
    """

    model_config = ConfigDict(extra="forbid")

    kind: Literal["random"] = "random"
    renewal: Annotated[Share, Field(description="Share of the population that each iteration draws again.")] = 0.28

    @property
    def renewed(self) -> int:
        """Individuals redrawn per iteration, at least one."""
        return max(1, round(self.renewal * self.population))


class SwarmSettings(OptimizerSpecification):
    """Particle swarm: each set moves on, and is pulled to the best that it found and to the best of all.

    Pulls c1 to a particle's own best set and c2 to that of the swarm (Table 4), and the inertia factor, which Eq. 4 leaves blank.
    """

    model_config = ConfigDict(extra="forbid")

    kind: Literal["swarm"] = "swarm"
    c1: Annotated[float, Field(ge=0, le=1, description="Pull to the set's own best.")] = 0.5
    c2: Annotated[float, Field(ge=0, le=1, description="Pull to the best of all sets.")] = 0.5
    inertia: Annotated[float, Field(ge=0, le=1, description="Share of the last step that is kept.")] = 1.0


Chosen = TypeVar("Chosen", bound=OptimizerSpecification)


@dataclass(frozen=True, slots=True)
class Beginning:
    """Start of an optimizer. CMA-ES has random numbers of its own, and does not use `generator`."""

    population: Indices
    n_values: Indices
    generator: np.random.Generator


class Resumable(Optimizer, Protocol):
    """An optimizer whose state can be replaced by a saved one."""

    def resume(self, state: Mapping[str, Any]) -> None:
        """Continues from `state`. Raises InvalidInputError if it does not fit."""


class BuiltIn(ABC, Generic[Chosen]):
    """Base of this package's plug-ins: see `drivecal.plugins.ports.DeclaringOptimizerPlugin`.

    All kinds of parameters are alike to them: positions, bits and ranks of choices follow the order of their lists.
    """

    name: str

    @property
    @abstractmethod
    def settings(self) -> type[Chosen]:
        """Validates the campaign's `optimizer` section."""

    def _renewed(self, settings: Chosen) -> int:  # a hook
        """Returns the largest number of individuals that an iteration after the first requests."""
        return settings.population

    @abstractmethod
    def _optimizer(self, settings: Chosen, begin: Beginning) -> Resumable:
        """Returns an optimizer that starts from a population."""

    @property
    def supports(self) -> frozenset[Ability]:
        return ONE_OBJECTIVE

    def requested_individuals(self, settings: BaseModel) -> int:
        """Returns the size of the first population, plus the individuals that each further iteration renews."""
        chosen = self._checked(settings)
        return chosen.population + (chosen.iterations - 1) * self._renewed(chosen)

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
        return self._optimizer(chosen, Beginning(first, n_values, generator))

    def restore(
        self,
        settings: BaseModel,
        n_values: Indices,
        state: Mapping[str, Any],
        kinds: Sequence[Kind] | None = None,  # noqa: ARG002  # of the port
    ) -> Optimizer:
        """See `drivecal.plugins.ports.DeclaringOptimizerPlugin`. Raises InvalidInputError if the state does not fit."""
        chosen = self._checked(settings)
        blank = np.zeros((chosen.population, len(n_values)), dtype=np.int64)
        generator = np.random.Generator(np.random.PCG64(chosen.seed))
        optimizer = self._optimizer(chosen, Beginning(blank, n_values, generator))
        optimizer.resume(state)
        return optimizer

    def _checked(self, settings: BaseModel) -> Chosen:
        if not isinstance(settings, self.settings):
            raise TypeError(f"settings must be {self.settings.__name__}, not {type(settings).__name__}")
        return settings


class GeneticPlugin(BuiltIn[GeneticSettings]):
    """`optimizer: {kind: genetic}`."""

    name = "genetic"
    settings = GeneticSettings

    def _renewed(self, settings: GeneticSettings) -> int:
        return pairs_per_generation(settings.population, settings.selection, settings.recombination)  # one child per pair

    def _optimizer(self, settings: GeneticSettings, begin: Beginning) -> GeneticAlgorithm:
        return GeneticAlgorithm(
            begin.population,
            begin.n_values,
            selection=settings.selection,
            recombination=settings.recombination,
            mutation=settings.mutation,
            generator=begin.generator,
        )


class RandomPlugin(BuiltIn[RandomSettings]):
    """`optimizer: {kind: random}`."""

    name = "random"
    settings = RandomSettings

    def _renewed(self, settings: RandomSettings) -> int:
        return settings.renewed

    def _optimizer(self, settings: RandomSettings, begin: Beginning) -> RandomSearch:
        return RandomSearch(begin.population, begin.n_values, renewed=settings.renewed, generator=begin.generator)


class SwarmPlugin(BuiltIn[SwarmSettings]):
    """`optimizer: {kind: swarm}`."""

    name = "swarm"
    settings = SwarmSettings

    def _optimizer(self, settings: SwarmSettings, begin: Beginning) -> ParticleSwarm:
        return ParticleSwarm(
            begin.population,
            begin.n_values,
            c1=settings.c1,
            c2=settings.c2,
            inertia=settings.inertia,
            generator=begin.generator,
        )


GENETIC: DeclaringOptimizerPlugin = GeneticPlugin()
RANDOM: DeclaringOptimizerPlugin = RandomPlugin()
SWARM: DeclaringOptimizerPlugin = SwarmPlugin()
