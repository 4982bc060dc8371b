"""The frame of optimizers that replace the least fit of a population in every iteration and leave all others untouched."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np

from drivecal.domain.parameters import Indices
from drivecal.optimizers.checks import checked_answers, fitting
from drivecal.optimizers.ranking import ranking
from drivecal.optimizers.state import dump_floats, dump_generator, load_floats, load_generator
from drivecal.plugins.ports import Floats, Proposal


class ReplacementOptimizer(ABC):
    """Ask/tell over individuals, integer rows of shape (n_searched,), that a subclass translates to grid indices.

    `ask` answers with the same proposal until `tell` has been called. The best individual is never replaced as long as fewer than all
    are, so that the population's best objective cannot fall.
    """

    def __init__(self, individuals: Indices, generator: np.random.Generator) -> None:
        """`individuals`: the start population, shape (n, n_searched). All later draws come from `generator`."""
        self._individuals = individuals
        self._generator = generator
        self._changed = np.ones(len(individuals), dtype=np.bool_)
        self._objectives: Floats | None = None
        self._tie_breakers: Floats | None = None

    @abstractmethod
    def _indices(self, individuals: Indices) -> Indices:
        """The grid indices that `individuals` stand for; both of shape (n, n_searched)."""

    @abstractmethod
    def _newcomers(self, order: Indices) -> Indices:
        """The individuals that replace the least fit, shape (n_new, n_searched); `order` ranks the population, fittest first."""

    def ask(self) -> Proposal:
        """The next population; its individuals that were replaced are `changed`, in the first iteration all."""
        if self._objectives is not None and self._tie_breakers is not None:
            order = ranking(self._objectives, self._tie_breakers)
            newcomers = self._newcomers(order)
            replaced = order[len(order) - len(newcomers) :]
            self._individuals = self._individuals.copy()
            self._individuals[replaced] = newcomers
            self._changed = np.zeros(len(order), dtype=np.bool_)
            self._changed[replaced] = True
            self._objectives = self._tie_breakers = None
        return Proposal(self._indices(self._individuals), self._changed.copy())

    def tell(self, objectives: Floats, tie_breakers: Floats) -> None:
        """The answers to the last `ask`, see `drivecal.plugins.ports.Optimizer`.

        Raises RuntimeError if they were given already, ValueError if there is no finite number or NaN per individual.
        """
        if self._objectives is not None:
            raise RuntimeError("the objectives of this population are known already; ask for the next one")
        self._objectives, self._tie_breakers = checked_answers(objectives, tie_breakers, len(self._changed))

    def state(self) -> dict[str, Any]:
        """The state as data for strict JSON: individuals, what the last `ask` changed, their answers if known, the generator."""
        return {
            "individuals": self._individuals.tolist(),
            "changed": self._changed.tolist(),
            "objectives": dump_floats(self._objectives),
            "tie_breakers": dump_floats(self._tie_breakers),
            "generator": dump_generator(self._generator),
        }

    def resume(self, state: Mapping[str, Any]) -> None:
        """Continues from `state`. Raises InvalidInputError if it belongs to a population of another size or another space."""
        self._individuals = fitting(np.array(state["individuals"], dtype=np.int64), self._individuals)
        self._changed = np.array(state["changed"], dtype=np.bool_)
        self._objectives = load_floats(state["objectives"])
        self._tie_breakers = load_floats(state["tie_breakers"])
        self._generator = load_generator(state["generator"])
