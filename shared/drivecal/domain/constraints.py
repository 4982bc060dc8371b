"""Constraints of a search space: combinations of values that must not be simulated."""

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.parameters import BILLION, Indices, ParameterSet, ParameterSpace, billionths
from drivecal.domain.regions import ANCHORS, FeasibleRegion, HalfSpace, Polytope

Columns = Mapping[str, npt.NDArray[Any]]
"""Values of n sets by parameter, shape (n,): floats, or the texts of choices."""
Constraint = Callable[[Columns], npt.NDArray[np.bool_]]
"""Returns which of n sets it allows, shape (n,)."""

DRAWN = 2**16
"""Points among which feasible ones are searched."""
MOST_OPERATIONS = 2**25
"""Operations of a search for feasible points: up to five seconds of a core. Constraints of more than 512 words and signs together get fewer
points: 100 constraints of 2,000 characters would take a quarter of an hour."""
MOST_TERMS = 1_000
"""Inequalities that repair uses; the others are constraints like any."""
_OPERATION = re.compile(r"\w+|[^\w\s]")
"""A word or sign of a constraint's text, which counts as an operation per point."""


@dataclass(frozen=True, slots=True)
class Inequality:
    """The sum of `coefficients` times parameters is at most `bound`, or below it if it `is_strict`."""

    coefficients: Mapping[str, float]
    bound: float
    is_strict: bool = False


@runtime_checkable
class LinearConstraint(Protocol):
    """Optional protocol of a constraint that implies linear inequalities: repair sorts or projects."""

    @property
    def inequalities(self) -> Sequence[Inequality]:
        """Inequalities that hold in all sets that the constraint allows."""


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

    @cached_property
    def whole_region(self) -> FeasibleRegion:
        """The feasible part of the space. Raises InvalidInputError as `region` does."""
        return self.region(np.zeros_like(self.space.n_values), self.space.n_values - 1)

    def region(self, lower: Indices, upper: Indices) -> FeasibleRegion:
        """Returns the feasible part of the box from `lower` to `upper`, shape (n_searched,).

        Raises InvalidInputError naming the constraints that leave nothing.
        """
        held = np.zeros(len(self.listed), dtype=np.bool_)

        def feasible(population: Indices) -> npt.NDArray[np.bool_]:
            allowed, columns = np.ones(len(population), dtype=np.bool_), self._columns(population)
            for number, constraint in enumerate(self.listed.values()):
                each = _allowed(constraint, columns)
                held[number] |= each.any()
                allowed &= each
            return allowed

        searched = self.space.searched
        origins, steps = self._numbers
        region = FeasibleRegion(
            Polytope(origins, steps, lower, upper, list(self._half_spaces())),
            feasible,
            read=np.flatnonzero([parameter.name in self.names for parameter in searched]),
            unordered=np.array([bool(parameter.choices) for parameter in searched], dtype=np.bool_),
            drawn=self.drawn,
        )
        if region.is_empty:
            raise self._nothing_left([text for text, ever in zip(self.listed, held, strict=True) if not ever])
        return region

    @property
    def _numbers(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """The first values and the steps of the searched parameters, in billionths, which are exact in floats."""
        bounds = [(billionths(parameter.lower), billionths(parameter.upper)) for parameter in self.space.searched]
        low, high = np.array(bounds, dtype=np.float64).reshape(-1, 2).T
        return low, (high - low) / (self.space.n_values - 1)

    def _half_spaces(self) -> Iterator[HalfSpace]:
        """Yields the inequalities between searched parameters, at most MOST_TERMS."""
        origins, steps = self._numbers
        places = {parameter.name: column for column, parameter in enumerate(self.space.searched) if not parameter.choices}
        constraints: Collection[object] = self.listed.values()
        listed = {
            (tuple(sorted(each.coefficients.items())), each.bound, each.is_strict): each
            for constraint in constraints
            if isinstance(constraint, LinearConstraint)
            for each in constraint.inequalities
        }
        for each in list(listed.values())[:MOST_TERMS]:
            fixed = {name: value for name, value in self.space.fixed.items() if name in each.coefficients}
            if not each.coefficients.keys() <= places.keys() | fixed.keys() or any(isinstance(v, str) for v in fixed.values()):
                continue
            bound = BILLION * (each.bound - sum(each.coefficients[name] * float(value) for name, value in fixed.items()))
            factors = {places[name]: factor for name, factor in each.coefficients.items() if name in places}
            if factors:
                columns = np.array(list(factors), dtype=np.int64)
                row = HalfSpace(columns, np.array(list(factors.values())), bound)
                yield _whole(row, origins[columns], steps[columns], is_strict=each.is_strict)

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


def _whole(row: HalfSpace, origins: npt.NDArray[np.float64], steps: npt.NDArray[np.float64], *, is_strict: bool) -> HalfSpace:
    """Returns a row whose bound sets on the grid can meet. A strict one excludes its bound by the smallest step of a parameter."""
    smallest = np.abs(row.factors * steps).min()
    ratios = np.abs(row.factors * steps) / smallest
    offset = float((row.factors * origins).sum())
    room = (row.bound - offset) / smallest
    if np.abs(ratios - np.rint(ratios)).max() < 1e-9:
        room = np.ceil(room - 1e-6) - 1 if is_strict else np.floor(room + 1e-6)
    elif is_strict:
        room -= 1
    return replace(row, bound=float(offset + room * smallest))


def _allowed(constraint: Constraint, columns: Columns) -> npt.NDArray[np.bool_]:
    """Returns what a constraint allows; a set for which it has no value, e.g. by a division by zero, is not allowed."""
    with np.errstate(all="ignore"):
        allowed: npt.NDArray[np.bool_] = np.asarray(constraint(columns), dtype=np.bool_)
    return allowed
