"""Abilities of optimizers, checks of what they are given and propose, and constraints kept by repair.

An infeasible individual is replaced by a feasible one near it. The replacement is a pure function of the individual and the space, so
that a resumed campaign repairs as before, and an individual that is carried over is not requested again. The optimizer is told the
replacement's result.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel

from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.parameters import Indices, Kind
from drivecal.plugins.ports import UNDECLARED, Ability, DeclaringOptimizerPlugin, Floats, Optimizer, OptimizerPlugin, Proposal


def supported(plugin: OptimizerPlugin) -> frozenset[Ability]:
    """Returns the abilities of a plug-in; one that declares none has `UNDECLARED`."""
    return plugin.supports if isinstance(plugin, DeclaringOptimizerPlugin) else UNDECLARED


def lacking(plugin: OptimizerPlugin, wanted: Collection[Ability]) -> list[Ability]:
    """Returns the wanted abilities that a plug-in does not have."""
    return sorted(set(wanted) - supported(plugin))


def create_optimizer(
    plugin: OptimizerPlugin, settings: BaseModel, n_values: Indices, kinds: Sequence[Kind], start: Indices | None = None
) -> Optimizer:
    """Creates an optimizer; see `drivecal.plugins.ports.OptimizerPlugin`."""
    if isinstance(plugin, DeclaringOptimizerPlugin):
        return plugin.create(settings, n_values, start, kinds)
    return plugin.create(settings, n_values, start)


def restore_optimizer(
    plugin: OptimizerPlugin, settings: BaseModel, n_values: Indices, kinds: Sequence[Kind], state: Mapping[str, Any]
) -> Optimizer:
    """Restores an optimizer; see `drivecal.plugins.ports.OptimizerPlugin`."""
    if isinstance(plugin, DeclaringOptimizerPlugin):
        return plugin.restore(settings, n_values, state, kinds)
    return plugin.restore(settings, n_values, state)


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


Feasible = Callable[[Indices], npt.NDArray[np.bool_]]
"""Returns which rows of grid indices, shape (n, n_searched), keep the constraints, shape (n,)."""

NEIGHBOURS = 16
"""Points that are tried around an individual in each of SCALES, shares of the ranges."""
SCALES = (1 / 256, 1 / 64, 1 / 16, 1 / 4)
SEED = 20261121
CELLS = 2_000_000
"""Grid indices that are in memory at a time."""


class Repair:
    """Replaces infeasible rows of grid indices, shape (n, n_searched); feasible rows stay as they are.

    Candidates are the first feasible point on the line to the nearest anchor, the first on the way that moves one parameter alone, and
    points around the row. The nearest candidate is taken, in shares of the ranges; another choice is as far as a whole range.
    """

    def __init__(self, n_values: Indices, kinds: Sequence[Kind], feasible: Feasible, anchors: Indices) -> None:
        """`anchors`: feasible rows, shape (n_anchors, n_searched), at least one."""
        if not len(anchors):
            raise ValueError("nothing is feasible: there is no anchor")
        self._last = n_values - 1
        self._unordered = np.array([kind == "choice" for kind in kinds], dtype=np.bool_)
        self._halvings = int(self._last.max(initial=0)).bit_length() + 1
        """Steps of a bisection, the same for every row: a row's replacement must not depend on the rows beside it."""
        self._feasible = feasible
        self._anchors = anchors
        drawing = np.random.Generator(np.random.PCG64(SEED))
        self._steps: Floats = np.concatenate([scale * drawing.uniform(-1, 1, (NEIGHBOURS, len(n_values))) for scale in SCALES])

    def __call__(self, population: Indices) -> Indices:
        """Returns the population with feasible rows only."""
        broken = np.flatnonzero(~self._feasible(population))
        repaired = population.copy()
        at_once = max(1, CELLS // max(1, population.shape[1]))
        for start in range(0, len(broken), at_once):
            rows = broken[start : start + at_once]
            repaired[rows] = self._replaced(population[rows])
        return repaired

    def _replaced(self, rows: Indices) -> Indices:
        """Returns a feasible row for each infeasible one."""
        best, away = rows.copy(), np.full(len(rows), np.inf)
        for candidates in self._candidates(rows):
            distance = np.where(self._feasible(candidates), self._distances(rows, candidates), np.inf)
            nearer = distance < away
            best[nearer], away[nearer] = candidates[nearer], distance[nearer]
        return best

    def _candidates(self, rows: Indices) -> Iterator[Indices]:
        """Yields a candidate for each row at a time; the first is feasible."""
        anchors = self._nearest_anchors(rows)
        yield self._first_feasible(rows, anchors)
        for column in range(rows.shape[1]):
            target = rows.copy()
            target[:, column] = anchors[:, column]
            reached = self._feasible(target)
            if reached.any():
                candidates = target.copy()
                candidates[reached] = self._first_feasible(rows[reached], target[reached])
                yield candidates
        for step in self._steps:
            moved = rows + np.rint(step * self._last).astype(np.int64)
            yield np.clip(moved, 0, self._last)

    def _nearest_anchors(self, rows: Indices) -> Indices:
        chosen, away = np.zeros(len(rows), dtype=np.int64), np.full(len(rows), np.inf)
        for number, anchor in enumerate(self._anchors):
            distance = self._distances(rows, anchor[np.newaxis])
            nearer = distance < away
            chosen[nearer], away[nearer] = number, distance[nearer]
        return self._anchors[chosen]

    def _first_feasible(self, rows: Indices, targets: Indices) -> Indices:
        """Returns feasible points on the lines from rows to feasible targets, by bisection; the first ones if each line crosses the border
        once."""
        near, far = np.zeros(len(rows)), np.ones(len(rows))
        for _ in range(self._halvings):
            middle = (near + far) / 2
            allowed = self._feasible(self._between(rows, targets, middle))
            far, near = np.where(allowed, middle, far), np.where(allowed, near, middle)
        return self._between(rows, targets, far)

    def _between(self, rows: Indices, targets: Indices, shares: Floats) -> Indices:
        """Returns points at `shares` of the way, shape (n,). A choice changes at the half."""
        way = shares[:, np.newaxis]
        moved = rows + np.rint((targets - rows) * way).astype(np.int64)
        return np.where(self._unordered, np.where(way < 0.5, rows, targets), moved)

    def _distances(self, rows: Indices, others: Indices) -> Floats:
        shares = (others - rows) / self._last
        differs: Floats = np.where(self._unordered, (shares != 0).astype(np.float64), shares)
        total: Floats = np.zeros(len(differs))
        for column in differs.T:  # one column after the other: the same bits whatever the number of rows
            total += column * column
        return total


class RepairingOptimizer:
    """An optimizer whose proposals are repaired. Its state is the optimizer's own."""

    def __init__(self, optimizer: Optimizer, repair: Callable[[Indices], Indices]) -> None:
        self._optimizer = optimizer
        self._repair = repair

    def ask(self) -> Proposal:
        """Returns the next population with feasible individuals only. Unchanged individuals have unchanged replacements."""
        proposal = self._optimizer.ask()
        return Proposal(self._repair(proposal.population), proposal.changed)

    def tell(self, objectives: Floats, tie_breakers: Floats) -> None:
        self._optimizer.tell(objectives, tie_breakers)

    def state(self) -> dict[str, Any]:
        return self._optimizer.state()
