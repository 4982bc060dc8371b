"""The built-in optimizers as plug-ins, with the settings that a campaign's `optimizer` section may hold."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from drivecal.contracts.specification import OptimizerSpecification
from drivecal.domain.parameters import Indices
from drivecal.optimizers.genetic import GeneticAlgorithm, pairs_per_generation
from drivecal.optimizers.random_search import RandomSearch
from drivecal.optimizers.start import start_population
from drivecal.plugins.ports import Optimizer, OptimizerPlugin

Share = Annotated[float, Field(gt=0, le=1)]


class GeneticSettings(OptimizerSpecification):
    """The paper's p_s, p_r and p_m (Table 4; p_m as in Section IV-C) under their names in words."""

    model_config = ConfigDict(extra="forbid")

    kind: Literal["genetic"] = "genetic"
    selection: Share = 0.8
    recombination: Share = 0.7
    mutation: Annotated[float, Field(ge=0, le=1)] = 0.5


class RandomSettings(OptimizerSpecification):
    """`renewal` is the share of the population drawn anew in each iteration after the first.

    Its default is what the genetic algorithm renews with its own defaults, so that both request equally many cells.
    """

    model_config = ConfigDict(extra="forbid")

    kind: Literal["random"] = "random"
    renewal: Share = 0.28

    @property
    def renewed(self) -> int:
        """Individuals drawn anew per iteration, at least one."""
        return max(1, round(self.renewal * self.population))


Chosen = TypeVar("Chosen", bound=OptimizerSpecification)


def _checked(settings: BaseModel, wanted: type[Chosen]) -> Chosen:
    if not isinstance(settings, wanted):
        raise TypeError(f"settings must be {wanted.__name__}, not {type(settings).__name__}")
    return settings


def _generator(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(seed))


class GeneticPlugin:
    """`optimizer: {kind: genetic}`."""

    name = "genetic"
    settings: type[BaseModel] = GeneticSettings

    def requested_individuals(self, settings: BaseModel) -> int:
        """The first population and one child per pair in each further iteration."""
        chosen = _checked(settings, GeneticSettings)
        children = pairs_per_generation(chosen.population, chosen.selection, chosen.recombination)
        return chosen.population + (chosen.iterations - 1) * children

    def create(self, settings: BaseModel, n_values: Indices, start: Indices | None = None) -> Optimizer:
        """See `drivecal.plugins.ports.OptimizerPlugin`."""
        chosen = _checked(settings, GeneticSettings)
        generator = _generator(chosen.seed)
        first = start_population(chosen.start, chosen.population, n_values, generator, start)
        return self._optimizer(chosen, first, n_values, generator)

    def restore(self, settings: BaseModel, n_values: Indices, state: Mapping[str, Any]) -> Optimizer:
        """See `drivecal.plugins.ports.OptimizerPlugin`. Raises InvalidInputError where the state does not fit."""
        chosen = _checked(settings, GeneticSettings)
        blank = np.zeros((chosen.population, len(n_values)), dtype=np.int64)
        optimizer = self._optimizer(chosen, blank, n_values, _generator(chosen.seed))
        optimizer.resume(state)
        return optimizer

    @staticmethod
    def _optimizer(
        settings: GeneticSettings, first: Indices, n_values: Indices, generator: np.random.Generator
    ) -> GeneticAlgorithm:
        return GeneticAlgorithm(
            first,
            n_values,
            selection=settings.selection,
            recombination=settings.recombination,
            mutation=settings.mutation,
            generator=generator,
        )


class RandomPlugin:
    """`optimizer: {kind: random}`."""

    name = "random"
    settings: type[BaseModel] = RandomSettings

    def requested_individuals(self, settings: BaseModel) -> int:
        """The first population and the renewed share in each further iteration."""
        chosen = _checked(settings, RandomSettings)
        return chosen.population + (chosen.iterations - 1) * chosen.renewed

    def create(self, settings: BaseModel, n_values: Indices, start: Indices | None = None) -> Optimizer:
        """See `drivecal.plugins.ports.OptimizerPlugin`."""
        chosen = _checked(settings, RandomSettings)
        generator = _generator(chosen.seed)
        first = start_population(chosen.start, chosen.population, n_values, generator, start)
        return self._optimizer(chosen, first, n_values, generator)

    def restore(self, settings: BaseModel, n_values: Indices, state: Mapping[str, Any]) -> Optimizer:
        """See `drivecal.plugins.ports.OptimizerPlugin`. Raises InvalidInputError where the state does not fit."""
        chosen = _checked(settings, RandomSettings)
        blank = np.zeros((chosen.population, len(n_values)), dtype=np.int64)
        optimizer = self._optimizer(chosen, blank, n_values, _generator(chosen.seed))
        optimizer.resume(state)
        return optimizer

    @staticmethod
    def _optimizer(settings: RandomSettings, first: Indices, n_values: Indices, generator: np.random.Generator) -> RandomSearch:
        return RandomSearch(first, n_values, renewed=settings.renewed, generator=generator)


GENETIC: OptimizerPlugin = GeneticPlugin()
RANDOM: OptimizerPlugin = RandomPlugin()
