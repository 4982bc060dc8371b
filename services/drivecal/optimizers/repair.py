"""Checks of what optimizers are given and propose, and constraints kept by repair.

An infeasible individual is replaced by a feasible one near it, see `drivecal.domain.regions`. An individual that is carried over is not
requested again. The optimizer is told the replacement's result.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from drivecal.contracts.campaign import Repaired
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.parameters import Indices
from drivecal.plugins.ports import Floats, Optimizer, Proposal

Individuals = TypeVar("Individuals", bound=npt.NDArray[Any])


def searchable(n_values: Indices) -> Indices:
    """Grid sizes, shape (n_searched,). Raises InvalidInputError if there is nothing to search."""
    if n_values.size == 0:
        raise InvalidInputError(Problem("fixed", "every parameter is fixed", "leave at least one to be searched"))
    if n_values.min() < 2:
        raise InvalidInputError(Problem("parameters", "a searched parameter has fewer than two values", "name it in `fixed`"))
    return n_values.astype(np.int64)


def checked_answers(objectives: Floats, tie_breakers: Floats, count: int, *, told: bool) -> tuple[Floats, Floats]:
    """Copies of both. Raises RuntimeError if answers were `told` already, ValueError without a finite number or NaN for each of `count`."""
    if told:
        raise RuntimeError("the objectives of this population are known already; ask for the next one")
    for name, values in (("objectives", objectives), ("tie_breakers", tie_breakers)):
        if values.shape != (count,) or np.isinf(values).any():
            raise ValueError(f"{name} must be {count} numbers, finite or NaN")
    return objectives.astype(np.float64), tie_breakers.astype(np.float64)


def checked_proposal(name: str, proposal: Proposal, count: int, n_values: Indices, before: Indices | None) -> Proposal:
    """Returns a proposal of the optimizer `name`. Raises InvalidInputError unless it has `count` individuals of the space, and its
    individuals that are not `changed` equal those in `before`."""
    population, changed = proposal.population, proposal.changed
    message = ""
    if population.shape != (count, len(n_values)) or population.dtype.kind not in "iu":
        message = f"its population is {population.dtype} of shape {population.shape}, not whole numbers of shape {(count, len(n_values))}"
    elif changed.shape != (count,) or changed.dtype != np.bool_:
        message = f"`changed` is {changed.dtype} of shape {changed.shape}, not a truth value for each of {count} individuals"
    elif ((population < 0) | (population >= n_values)).any():
        message = "it proposes indices beyond the grid"
    elif not (changed.all() if before is None else np.array_equal(population[~changed], before[~changed])):
        message = "it changes individuals that it does not call changed"
    if message:
        raise InvalidInputError(Problem(f"optimizer {name}", message, "correct the plug-in"))
    return proposal


def fitting(saved: Individuals, own: npt.NDArray[Any]) -> Individuals:
    """`saved` individuals. Raises InvalidInputError if they are of a population of another size or of another space than `own`."""
    if saved.shape != own.shape:
        remedy = "resume with the settings and the parameters it was saved with"
        raise InvalidInputError(Problem("optimizer", f"the saved population is {saved.shape}, not {own.shape}", remedy))
    return saved


class RepairingOptimizer:
    """An optimizer whose proposals are repaired. Its state is the optimizer's own."""

    def __init__(self, optimizer: Optimizer, repair: Callable[[Indices], Indices]) -> None:
        self._optimizer = optimizer
        self._repair = repair
        self.known: set[tuple[int, ...]] = set()
        """Sets that were asked for before."""
        self.repaired = Repaired()
        """Counts of the last population."""
        self.again: list[int] = []
        """Individuals of the last population that repair made equal to an earlier set, or to one before them."""

    def ask(self) -> Proposal:
        """Returns the next population with feasible individuals only. Unchanged individuals have unchanged replacements."""
        proposal = self._optimizer.ask()
        population = self._repair(proposal.population)
        broken = proposal.changed & (proposal.population != population).any(axis=1)
        sets = list(map(tuple, population.tolist()))
        self.known.update(sets[place] for place in np.flatnonzero(~broken))
        before, self.again = len(self.known), []
        for place in np.flatnonzero(broken).tolist():
            if sets[place] in self.known:
                self.again.append(place)
            self.known.add(sets[place])
        proposed = len(np.unique(proposal.population[broken], axis=0))
        self.repaired = Repaired(proposed=proposed, distinct=len(self.known) - before)
        return Proposal(population, proposal.changed)

    def tell(self, objectives: Floats, tie_breakers: Floats) -> None:
        self._optimizer.tell(objectives, tie_breakers)

    def state(self) -> dict[str, Any]:
        return self._optimizer.state()
