"""Checks shared by all optimizers: the grid to search, the answers, and a saved state."""

from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.parameters import Indices
from drivecal.plugins.ports import Floats, Proposal

Individuals = TypeVar("Individuals", bound=npt.NDArray[Any])


def searchable(n_values: Indices) -> Indices:
    """Grid sizes, shape (n_searched,). Raises InvalidInputError if there is nothing to search."""
    if n_values.size == 0:
        raise InvalidInputError(Problem("fixed", "every parameter is fixed", "leave at least one to be searched"))
    if n_values.min() < 2:
        raise InvalidInputError(Problem("parameters", "a searched parameter has fewer than two values", "name it in `fixed`"))
    return n_values.astype(np.int64)


def checked_answers(objectives: Floats, tie_breakers: Floats, count: int) -> tuple[Floats, Floats]:
    """Copies of both. Raises ValueError if there is no finite number or NaN for each of `count` individuals."""
    for name, values in (("objectives", objectives), ("tie_breakers", tie_breakers)):
        if values.shape != (count,) or np.isinf(values).any():
            raise ValueError(f"{name} must be {count} numbers, finite or NaN")
    return objectives.astype(np.float64), tie_breakers.astype(np.float64)


def checked_vectors(objectives: Floats, violations: Floats, count: int) -> tuple[Floats, Floats]:
    """Copies of both. Raises ValueError if there is no row of finite numbers or NaN, and no violation, for each of `count` individuals."""
    for name, values in (("objectives", objectives), ("violations", violations)):
        if values.shape[:1] != (count,) or np.isinf(values).any():
            raise ValueError(f"{name} must be of {count} individuals, finite or NaN")
    return objectives.astype(np.float64), violations.astype(np.float64)


def checked_proposal(name: str, proposal: Proposal, count: int, n_values: Indices, before: Indices | None) -> Proposal:
    """Returns a proposal of the optimizer `name`. Raises InvalidInputError unless it has `count` individuals of the space, and those
    that are not `changed` are what they were `before`."""
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
