"""CMA-ES (Hansen's package `cma`) as an optimizer: `optimizer: {kind: cma_es}`, with the extra [cma]."""

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import ConfigDict, Field

from drivecal.contracts.specification import OptimizerSpecification
from drivecal.domain.parameters import Indices
from drivecal.optimizers.built_in import Beginning, BuiltIn
from drivecal.optimizers.population import ranking
from drivecal.optimizers.repair import searchable
from drivecal.optimizers.replayed import Replayed, named, require
from drivecal.plugins.ports import DeclaringOptimizerPlugin, Floats

require("cma", extra="cma")


class CmaSettings(OptimizerSpecification):
    """`step`: the first standard deviation, in shares of the parameters' ranges."""

    model_config = ConfigDict(extra="forbid")

    kind: Literal["cma_es"] = "cma_es"
    step: Annotated[float, Field(gt=0, le=1)] = 0.3


class CmaEngine:
    """Searches the unit cube, beginning at the best start set; it proposes the grid points next to its own points.

    `cma` cannot search along a single axis: one parameter is searched in the plane, and the other axis has no effect.

    It receives ranks, the only input that CMA-ES uses: equal objectives are ordered by the rating.
    """

    def __init__(self, settings: CmaSettings, n_values: Indices) -> None:
        self.library = named("cma")
        self._settings = settings
        self._last = (searchable(n_values) - 1).astype(np.float64)
        self._generator = np.random.Generator(np.random.PCG64([settings.seed, 1]))
        self._strategy: Any = None
        self._points: list[Any] = []

    def propose(self) -> Indices:
        self._points = self._strategy.ask()
        indices: Indices = np.rint(np.array(self._points)[:, : len(self._last)] * self._last).astype(np.int64)
        return np.clip(indices, 0, self._last.astype(np.int64))

    def learn(self, population: Indices, objectives: Floats, tie_breakers: Floats) -> None:
        order = ranking(objectives, tie_breakers)
        if self._strategy is None:
            self._strategy = self._begin(population[order[0]] / self._last)
            return
        ranks = np.empty(len(order))
        ranks[order] = np.arange(len(order))
        self._strategy.tell(self._points, ranks.tolist())

    def _begin(self, centre: Floats) -> Any:
        import cma

        start = centre.tolist() if len(centre) > 1 else [*centre.tolist(), 0.5]
        options = {
            "popsize": self._settings.population,
            "bounds": [0, 1],
            "randn": lambda *shape: self._generator.standard_normal(shape),
            "seed": 0,  # never used: all draws come from `randn`
            "verbose": -9,
        }
        return cma.CMAEvolutionStrategy(start, self._settings.step, options)


class CmaPlugin(BuiltIn[CmaSettings]):
    """`optimizer: {kind: cma_es}`."""

    name = "cma_es"
    settings = CmaSettings

    def _optimizer(self, settings: CmaSettings, begin: Beginning) -> Replayed:
        return Replayed(begin.population, CmaEngine(settings, begin.n_values))


CMA_ES: DeclaringOptimizerPlugin = CmaPlugin()
