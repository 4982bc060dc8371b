"""Constraints of a search space: combinations of values that must not be simulated."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.parameters import BILLION, Indices, ParameterSet, ParameterSpace

Columns = Mapping[str, npt.NDArray[Any]]
"""Values of n sets by parameter, shape (n,): floats, or the texts of choices."""
Constraint = Callable[[Columns], npt.NDArray[np.bool_]]
"""Returns which of n sets it allows, shape (n,)."""

DRAWN = 2**16
"""Points among which feasible ones are searched."""
BATCH = 2**12
MOST_OPERATIONS = 2**25
"""Operations of a search for feasible points: up to five seconds of a core. Constraints of more than 512 words and signs together get fewer
points: 100 constraints of 2,000 characters would take a quarter of an hour."""
ANCHORS = 32
"""Feasible points to which infeasible ones are moved: the nearest is chosen."""
SEED = 20261121
_OPERATION = re.compile(r"\w+|[^\w\s]")
"""A word or sign of a constraint's text, which counts as an operation per point."""


@dataclass(frozen=True)
class Constraints:
    """Constraints over all parameters of a space, fixed ones included, by their text."""

    space: ParameterSpace
    listed: Mapping[str, Constraint] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.listed)

    @cached_property
    def names(self) -> frozenset[str]:
        """The parameters whose values the constraints read, fixed ones included."""
        last = self.space.n_values - 1
        columns = _ReadColumns(self._columns(np.stack([last // 2, 0 * last, last])))
        for constraint in self.listed.values():
            _allowed(constraint, columns)
        return frozenset(columns.names)

    def feasible(self, population: Indices) -> npt.NDArray[np.bool_]:
        """Returns which rows of grid indices, shape (n, n_searched), keep all constraints, shape (n,)."""
        allowed = np.ones(len(population), dtype=np.bool_)
        if not self or not len(population):
            return allowed
        columns = self._columns(population)
        for constraint in self.listed.values():
            allowed &= _allowed(constraint, columns)
        return allowed

    @cached_property
    def drawn(self) -> int:
        """Number of points that a search for feasible points draws: DRAWN, or fewer if the constraints are long."""
        operations = sum(len(_OPERATION.findall(text)) for text in self.listed)
        return min(DRAWN, max(ANCHORS, MOST_OPERATIONS // max(operations, 1)))

    def anchors(self, lower: Indices, upper: Indices) -> Indices:
        """Returns feasible rows of grid indices in the box from `lower` to `upper`, shape (n, n_searched), at most ANCHORS: the middle, the
        corners and `drawn` points with a fixed seed. Raises InvalidInputError naming the constraints that leave nothing.
        """
        drawing, allowed = np.random.Generator(np.random.PCG64(SEED)), np.zeros(len(self.listed), dtype=np.int64)
        kept = np.empty((0, len(lower)), dtype=np.int64)
        batch = np.stack([(lower + upper) // 2, lower, upper])
        left = self.drawn
        while True:
            columns = self._columns(batch)
            rows = np.stack([_allowed(constraint, columns) for constraint in self.listed.values()])
            allowed += rows.sum(axis=1)
            kept = np.concatenate([kept, batch[rows.all(axis=0)]])
            if len(kept) >= ANCHORS or not left:
                break
            size = min(BATCH, left)
            batch, left = drawing.integers(lower, upper + 1, size=(size, len(lower))), left - size
        if not len(kept):
            raise self._nothing_left([text for text, count in zip(self.listed, allowed, strict=True) if count == 0])
        return kept[:ANCHORS]

    def allow_any(self, lower: Indices, upper: Indices) -> bool:
        """Returns whether feasible points are found in a box, see `anchors`."""
        try:
            return not self or len(self.anchors(lower, upper)) > 0
        except InvalidInputError:
            return False

    def check(self, parameters: ParameterSet, field_name: str) -> None:
        """Raises InvalidInputError naming the constraints that a set breaks."""
        columns = {name: np.array([value]) for name, value in parameters.floats.items()}
        broken = [text for text, constraint in self.listed.items() if not _allowed(constraint, columns)[0]]
        if broken:
            values = ", ".join(f"{name} = {value}" for name, value in parameters.floats.items())
            raise InvalidInputError(
                *(Problem(field_name, f"{text} does not hold for {values}", "change it") for text in broken)
            )

    def _nothing_left(self, never: Sequence[str]) -> InvalidInputError:
        together = "no set keeps" if never or len(self.listed) == 1 else "no set keeps all of"
        named = ", ".join(never or self.listed)
        remedy = "widen the bounds, or change the constraints"
        return InvalidInputError(
            Problem(
                "constraints",
                f"{together} {named}: tried were the middle, two corners and {self.drawn:,} sets drawn within the bounds",
                remedy,
            )
        )

    def _columns(self, population: Indices) -> dict[str, npt.NDArray[Any]]:
        columns: dict[str, npt.NDArray[Any]] = {}
        for name, value in self.space.fixed.items():
            columns[name] = np.full(len(population), value if isinstance(value, str) else float(value))
        for parameter, indices in zip(self.space.searched, population.T, strict=True):
            choices = np.array(parameter.choices)
            columns[parameter.name] = choices[indices] if parameter.choices else parameter.billionths_at(indices) / BILLION
        return columns


class _ReadColumns(Mapping[str, npt.NDArray[Any]]):
    """Columns that remember which of them are read: a plug-in's constraint is a function, which declares no names."""

    def __init__(self, columns: Columns) -> None:
        self._columns = columns
        self.names: set[str] = set()

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        values = self._columns[name]
        self.names.add(name)
        return values

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)


def _allowed(constraint: Constraint, columns: Columns) -> npt.NDArray[np.bool_]:
    """Returns what a constraint allows; a set for which it has no value, e.g. by a division by zero, is not allowed."""
    with np.errstate(all="ignore"):
        allowed: npt.NDArray[np.bool_] = np.asarray(constraint(columns), dtype=np.bool_)
    return allowed
