"""The frame of optimizers that replace the least fit: start, order, replacement and state. Random search is the simplest."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from drivecal.domain.parameters import Indices
from drivecal.domain.rounding import levels
from drivecal.optimizers.repair import checked_answers, fitting
from drivecal.plugins.ports import Floats, Proposal


def dump_generator(generator: np.random.Generator) -> dict[str, Any]:
    """The generator's state: names and plain integers of any size."""
    return dict(generator.bit_generator.state)


def load_generator(state: Mapping[str, Any]) -> np.random.Generator:
    """The inverse of `dump_generator`; draws continue where they stopped."""
    generator = np.random.Generator(np.random.PCG64())
    generator.bit_generator.state = state
    return generator


def dump_floats(values: Floats) -> list[Any]:
    """Lists of the array's shape; NaN becomes null, which JSON knows."""
    plain = values.astype(object)
    plain[np.isnan(values)] = None
    return list(plain.tolist())


def load_floats(values: Sequence[Any]) -> Floats:
    """The inverse of `dump_floats`."""
    return np.array(values, dtype=np.float64)  # None becomes NaN


Design = Literal["lhs", "halton"]


def start_population(
    design: Design, size: int, n_values: Indices, generator: np.random.Generator, given: Indices | None = None
) -> Indices:
    """The first population, shape (size, n_searched): the rows of `given`, then points of the design.

    The design has `size` points, and its first ones are taken, so that a search with other given sets begins with the same points, whose
    results are stored. `lhs` draws from `generator`: each parameter's range is cut into `size` equal strata, each with its point.
    `halton` is the plain sequence without its first point, the corner of the space; it is the same for every seed (Section IV-B starts
    both optimizers from one such population per size). Raises ValueError if `given` has more rows than fit.
    """
    from scipy.stats import qmc  # takes more than a second, which commands that only look things up need not pay

    expert = np.empty((0, len(n_values)), dtype=np.int64) if given is None else given
    if len(expert) > size:
        raise ValueError(f"{len(expert)} given sets do not fit into a population of {size}")
    if design == "lhs":
        points = qmc.LatinHypercube(len(n_values), rng=generator).random(size)
    else:
        points = qmc.Halton(len(n_values), scramble=False).fast_forward(1).random(size)
    return np.concatenate([expert, np.floor(points[: size - len(expert)] * n_values).astype(np.int64)])


def ranking(objectives: Floats, tie_breakers: Floats) -> Indices:
    """Positions from the fittest to the least fit, shape (n,): by objective, ones equal but for rounding by tie breaker, then by position.

    NaN, an individual without a result, comes last.
    """
    first, second = fitness(objectives, tie_breakers).T
    order: Indices = np.lexsort((-second, levels(-first))).astype(np.int64)  # stable: equal keys stay in order of position
    return order


def fitness(objectives: Floats, tie_breakers: Floats) -> Floats:
    """Returns sort keys, the first column before the second, higher is fitter; shape (n, 2). NaN is lowest."""
    return np.column_stack([np.where(np.isnan(each), -np.inf, each) for each in (objectives, tie_breakers)])


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
        self._answers: tuple[Floats, Floats] | None = None

    @abstractmethod
    def _indices(self, individuals: Indices) -> Indices:
        """The grid indices that `individuals` stand for; both of shape (n, n_searched)."""

    @abstractmethod
    def _newcomers(self, order: Indices) -> Indices:
        """The individuals that replace the least fit, shape (n_new, n_searched); `order` ranks the population, fittest first."""

    def ask(self) -> Proposal:
        """The next population; its individuals that were replaced are `changed`, in the first iteration all."""
        if self._answers is not None:
            order = ranking(*self._answers)
            newcomers = self._newcomers(order)
            replaced = order[len(order) - len(newcomers) :]
            self._individuals = self._individuals.copy()
            self._individuals[replaced] = newcomers
            self._changed = np.zeros(len(order), dtype=np.bool_)
            self._changed[replaced] = True
            self._answers = None
        return Proposal(self._indices(self._individuals), self._changed.copy())

    def tell(self, objectives: Floats, tie_breakers: Floats) -> None:
        """The answers to the last `ask`, see `drivecal.plugins.ports.Optimizer`.

        Raises RuntimeError if they were given already, ValueError if there is no finite number or NaN per individual.
        """
        self._answers = checked_answers(objectives, tie_breakers, len(self._changed), told=self._answers is not None)

    def state(self) -> dict[str, Any]:
        """The state as data for strict JSON: individuals, what the last `ask` changed, their answers if known, the generator."""
        return {
            "individuals": self._individuals.tolist(),
            "changed": self._changed.tolist(),
            "answers": None if self._answers is None else [dump_floats(each) for each in self._answers],
            "generator": dump_generator(self._generator),
        }

    def resume(self, state: Mapping[str, Any]) -> None:
        """Continues from `state`. Raises InvalidInputError if it belongs to a population of another size or another space."""
        self._individuals = fitting(np.array(state["individuals"], dtype=np.int64), self._individuals)
        self._changed = np.array(state["changed"], dtype=np.bool_)
        answers = state["answers"]
        self._answers = None if answers is None else (load_floats(answers[0]), load_floats(answers[1]))
        self._generator = load_generator(state["generator"])


class RandomSearch(ReplacementOptimizer):
    """Replaces the least fit by points drawn uniformly from the grid, as many in every iteration; individuals are grid indices."""

    def __init__(self, start: Indices, n_values: Indices, *, renewed: int, generator: np.random.Generator) -> None:
        """`start`: grid indices of the first population, shape (n, n_searched). `renewed`: how many are replaced in each iteration."""
        super().__init__(start, generator)
        self._n_values = n_values
        self._renewed = renewed

    def _indices(self, individuals: Indices) -> Indices:
        return individuals.copy()

    def _newcomers(self, order: Indices) -> Indices:  # noqa: ARG002  who is fit does not matter here
        return self._generator.integers(0, self._n_values, size=(self._renewed, len(self._n_values)))
