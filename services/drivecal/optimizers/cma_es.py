"""CMA-ES (Hansen's package `cma`) as an optimizer: `optimizer: {kind: cma_es}`, with the extra [cma].

The state of a strategy cannot be stored as plain data. So the answers are stored: it is deterministic for a seed, and replaying the same
answers restores the same state. Another version of the package may draw otherwise, so that a digest of every proposal is stored, too, and
each replayed proposal must have the same.
"""

from collections.abc import Mapping
from hashlib import sha256
from importlib.metadata import version
from importlib.util import find_spec
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from drivecal.contracts.specification import OptimizerSpecification
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.parameters import Indices
from drivecal.optimizers.built_in import BuiltIn
from drivecal.optimizers.population import dump_floats, load_floats, ranking
from drivecal.optimizers.repair import checked_answers, fitting, searchable
from drivecal.plugins.ports import Floats, OptimizerPlugin, Proposal

if find_spec("cma") is None:
    raise InvalidInputError(Problem("optimizer.kind", "it needs the package cma", "install the extra [cma] on the server"))


class CmaSettings(OptimizerSpecification, extra="forbid"):
    """`step`: the first standard deviation, in shares of the parameters' ranges."""

    kind: Literal["cma_es"] = "cma_es"
    step: Annotated[float, Field(gt=0, le=1)] = 0.3


class CmaEs:
    """Searches the unit cube, beginning at the best start set; it proposes the grid points next to its own points.

    `cma` cannot search along a single axis: one parameter is searched in the plane, and the other axis has no effect.

    It receives ranks, the only input that CMA-ES uses: equal objectives are ordered by the rating.
    """

    def __init__(self, settings: CmaSettings, first: Indices, n_values: Indices) -> None:
        """`first`: the start population, shape (n, n_searched)."""
        self._settings = settings
        self._first = self._population = first
        self._last = (searchable(n_values) - 1).astype(np.float64)
        self._generator = np.random.Generator(np.random.PCG64([settings.seed, 1]))
        self._library = f"cma {version('cma')}"
        self._changed = np.ones(len(first), dtype=np.bool_)
        self._strategy: Any = None
        self._points: list[Any] = []
        self._history: list[tuple[Floats, Floats]] = []
        self._digests = [_digest(first)]
        self._told = False

    def ask(self) -> Proposal:
        """The next population; individuals that are proposed again in the same place are not `changed`."""
        if self._told:
            before, self._points = self._population, self._strategy.ask()
            nearest = np.rint(np.array(self._points)[:, : len(self._last)] * self._last)
            self._population = np.clip(nearest, 0, self._last).astype(np.int64)
            self._changed = (self._population != before).any(axis=1)
            self._digests.append(_digest(self._population))
            self._told = False
        return Proposal(self._population.copy(), self._changed.copy())

    def tell(self, objectives: Floats, tie_breakers: Floats) -> None:
        """The answers to the last `ask`. Raises RuntimeError if they were given already, ValueError if they do not fit."""
        answers = checked_answers(objectives, tie_breakers, len(self._changed), told=self._told)
        self._history.append(answers)
        order = ranking(*answers)
        if self._strategy is None:
            self._strategy = self._begin(self._population[order[0]] / self._last)
        else:
            self._strategy.tell(self._points, np.argsort(order).astype(np.float64).tolist())
        self._told = True

    def state(self) -> dict[str, Any]:
        """The start population, all answers since, and a digest of every proposal, as data for strict JSON."""
        return {
            "first": self._first.tolist(),
            "told": [[dump_floats(objectives), dump_floats(ties)] for objectives, ties in self._history],
            "asked": not self._told,
            "digests": list(self._digests),
            "library": self._library,
        }

    def resume(self, state: Mapping[str, Any]) -> None:
        """Replays all answers. Raises InvalidInputError if it belongs to a population of another size or another space, and at the first
        proposal whose digest is another one.
        """
        self._first = self._population = fitting(np.array(state["first"], dtype=np.int64), self._first)
        self._digests = [_digest(self._first)]
        self._compare(state)
        for objectives, ties in state["told"]:
            self.ask()
            self._compare(state)
            self.tell(load_floats(objectives), load_floats(ties))
        if state["asked"]:
            self.ask()
            self._compare(state)

    def _compare(self, state: Mapping[str, Any]) -> None:
        """Raises InvalidInputError if the last proposal is not the saved one."""
        iteration, saved, library = len(self._digests) - 1, state["digests"], state["library"]
        if self._digests[iteration:] != saved[iteration : iteration + 1]:
            before = "it did when the campaign ran" if library == self._library else f"{library} did"
            differs = f"for iteration {iteration}, {self._library} proposes another population than {before}"
            remedy = "submit the campaign again: stored results answer the cells that were simulated"
            raise InvalidInputError(Problem("", f"the search cannot be resumed: {differs}", remedy))

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


def _digest(population: Indices) -> str:
    """Sixteen hexadecimal digits of a population, shape and order included."""
    shape = "x".join(map(str, population.shape))
    return sha256(shape.encode() + population.astype("<i8").tobytes()).hexdigest()[:16]


CMA_ES: OptimizerPlugin = BuiltIn("cma_es", CmaSettings, lambda chosen, first, n_values, _: CmaEs(chosen, first, n_values))
