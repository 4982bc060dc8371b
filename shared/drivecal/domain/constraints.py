"""Constraints of a search space: combinations of values that must not be simulated."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.parameters import Indices, ParameterSet, ParameterSpace
from drivecal.domain.regions import ANCHORS, FeasibleRegion, HalfSpace, Polytope
from drivecal.domain.values import BILLION, billionths

Columns = Mapping[str, npt.NDArray[Any]]
"""Values of n sets by parameter, shape (n,): floats, or the texts of choices."""
Constraint = Callable[[Columns], npt.NDArray[np.bool_]]
"""Returns which of n sets it allows, shape (n,). `inequalities`, if it has them, hold in all of them: repair sorts or projects."""

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


@dataclass(frozen=True)
class ChangeFrom:
    """How far sets are from a reference: the number of parameters that differ, or the largest or summed difference in shares of the ranges.

    A choice that differs counts as the whole range.
    """

    kind: Literal["changes", "largest", "sum"]
    reference: Mapping[str, int | str]
    """Values of the searched parameters as `ParameterSet` stores them."""
    ranges: Mapping[str, int]
    """Widths of their ranges, in billionths."""

    @classmethod
    def between(
        cls, kind: Literal["changes", "largest", "sum"], space: ParameterSpace, reference: ParameterSet
    ) -> "ChangeFrom":
        """Creates the comparison of a space's sets with one of them."""
        values = dict(zip(reference.names, reference.billionths, strict=True))
        ranges = {each.name: billionths(each.upper) - billionths(each.lower) for each in space.searched}
        return cls(kind, {name: values[name] for name in ranges}, ranges)

    def shares(self, entries: Columns) -> npt.NDArray[np.float64]:
        """Returns the differences of n sets, shape (n, n_searched), in shares of the ranges."""
        columns = [
            (entries[name] != value) * 1.0 if isinstance(value, str) else np.abs(entries[name] - value) / self.ranges[name]
            for name, value in self.reference.items()
        ]
        return np.stack(columns, axis=1)

    def __call__(self, entries: Columns) -> npt.NDArray[np.float64]:
        """Returns the change of n sets, shape (n,), from their stored values by parameter."""
        shares = self.shares(entries)
        changes: npt.NDArray[np.float64] = (
            (shares > 0).sum(axis=1).astype(np.float64)
            if self.kind == "changes"
            else shares.max(axis=1)
            if self.kind == "largest"
            else shares.sum(axis=1)
        )
        return changes

    def of(self, parameters: ParameterSet) -> float:
        """Returns the change of a set."""
        values = zip(parameters.names, parameters.billionths, strict=True)
        return float(self({name: np.array([value]) for name, value in values})[0])

    def row(self, space: ParameterSpace) -> Indices:
        """Returns the grid indices of the reference, shape (n_searched,)."""
        values = ((each, self.reference[each.name]) for each in space.searched)
        return np.array([each.first_from(v) if isinstance(v, int) else each.choices.index(v) for each, v in values])


@dataclass(frozen=True, slots=True)
class ChangeLimit:
    """Largest change from a reference, which keeps all constraints."""

    change: ChangeFrom
    at_most: float

    @property
    def text(self) -> str:
        """The limit in words."""
        return f"{'changes' if self.change.kind == 'changes' else 'distance'} <= {self.at_most:g}"

    def allows(self, entries: Columns) -> npt.NDArray[np.bool_]:
        """Returns which sets keep it, shape (n,)."""
        allowed: npt.NDArray[np.bool_] = self.change(entries) <= self.at_most + 1e-12
        return allowed

    def limited(self, moves: Indices, last: Indices, unordered: npt.NDArray[np.bool_], order: Indices, share: float) -> Indices:
        """Returns moves from the reference that are short enough, shape (n, n_searched).

        Args:
            moves: differences of grid indices.
            last: largest grid indices.
            unordered: which parameters are choices.
            order: for each row the ranks of its parameters; of too many moves the first ones stay.
            share: part of the limit to use, at most 1.
        """
        most = self.at_most * share
        if self.change.kind == "changes":
            return np.where(order < np.floor(most), moves, 0)
        moves = np.where(unordered & (most < 1), 0, moves)
        if self.change.kind == "largest":
            steps = np.where(unordered, last, np.floor(most * last + 1e-9)).astype(np.int64)
            return np.clip(moves, -steps, steps)
        total = np.where(unordered, moves != 0, np.abs(moves) / last).sum(axis=1, keepdims=True)
        moves = np.where(unordered & (total > most), 0, moves)
        total = (np.abs(moves) / last).sum(axis=1, keepdims=True)
        shorter: Indices = np.trunc(moves * np.minimum(1.0, most / np.maximum(total, 1e-300))).astype(np.int64)
        return shorter


@dataclass(frozen=True)
class Constraints:
    """Constraints over all parameters of a space, fixed ones included, by their text."""

    space: ParameterSpace
    listed: Mapping[str, Constraint] = field(default_factory=dict)
    limits: tuple[ChangeLimit, ...] = ()
    """Limits of changes, all from one reference."""

    def __bool__(self) -> bool:
        return bool(self.listed or self.limits)

    @cached_property
    def read(self) -> Mapping[str, frozenset[str]]:
        """The parameters whose values each constraint reads, fixed ones included."""
        last = self.space.n_values - 1
        columns = self._columns(np.stack([last // 2, 0 * last, last]))
        read = {text: _ReadColumns(columns) for text in self.listed}
        for text, constraint in self.listed.items():
            _allowed(constraint, read[text])
        return {text: frozenset(each.names) for text, each in read.items()}

    def feasible(self, population: Indices) -> npt.NDArray[np.bool_]:
        """Returns which rows of grid indices, shape (n, n_searched), keep all constraints, shape (n,)."""
        allowed = np.ones(len(population), dtype=np.bool_)
        if not self or not len(population):
            return allowed
        columns = self._columns(population)
        for constraint in self.listed.values():
            allowed &= _allowed(constraint, columns)
        entries = self.entries(population) if self.limits else {}
        for limit in self.limits:
            allowed &= limit.allows(entries)
        return allowed

    def entries(self, population: Indices) -> dict[str, npt.NDArray[Any]]:
        """Returns the stored values of the searched parameters at rows of grid indices, shape (n,) each."""
        columns = zip(self.space.searched, population.T, strict=True)
        return {
            each.name: np.array(each.choices)[indices] if each.choices else each.billionths_at(indices)
            for each, indices in columns
        }

    @cached_property
    def drawn(self) -> int:
        """Number of points that a search for feasible points draws: DRAWN, or fewer if the constraints are long."""
        operations = sum(len(_OPERATION.findall(text)) for text in self.listed)
        return min(DRAWN, max(ANCHORS, MOST_OPERATIONS // max(operations, 1)))

    @cached_property
    def whole_region(self) -> "FeasibleRegion | Vicinity":
        """The feasible part of the space. Raises InvalidInputError as `region` does."""
        region = self.region(np.zeros_like(self.space.n_values), self.space.n_values - 1)
        return Vicinity(self, region) if self.limits else region

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
            read=np.flatnonzero([any(parameter.name in names for names in self.read.values()) for parameter in searched]),
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
        implied: Iterator[Sequence[Inequality]] = (
            getattr(constraint, "inequalities", ()) for constraint in self.listed.values()
        )
        listed = {
            (tuple(sorted(each.coefficients.items())), each.bound, each.is_strict): each for some in implied for each in some
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
        broken += [limit.text for limit in self.limits if limit.change.of(parameters) > limit.at_most + 1e-12]
        if broken:
            values = ", ".join(f"{name} = {value}" for name, value in parameters.floats.items())
            raise InvalidInputError(*(Problem(field_name, f"{text} fails for {values}", "change it") for text in broken))

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
        """Returns the values of all parameters at rows of grid indices, shape (n,) each: floats, or texts of choices."""
        fixed = {name: value if isinstance(value, str) else float(value) for name, value in self.space.fixed.items()}
        columns = {name: np.full(len(population), value) for name, value in fixed.items()}
        entries = self.entries(population).items()
        return columns | {name: stored / BILLION if stored.dtype.kind == "i" else stored for name, stored in entries}


class Vicinity:
    """The feasible sets near a reference. Rows of grid indices have the shape (n, n_searched)."""

    def __init__(self, constraints: Constraints, region: FeasibleRegion) -> None:
        """`region`: the feasible sets without limits of changes."""
        self._constraints, self._region = constraints, region
        space = constraints.space
        self._reference = constraints.limits[0].change.row(space)
        self._last = space.n_values - 1
        self._unordered = np.array([bool(each.choices) for each in space.searched], dtype=np.bool_)

    def repair(self, population: Indices) -> Indices:
        """Returns the population with a feasible row near each infeasible one: its largest moves from the reference, or shorter ones."""
        rows = self._region.repair(population)
        moved = np.where(self._unordered, rows != self._reference, np.abs(rows - self._reference) / self._last)
        return self._near(rows, np.argsort(np.argsort(-moved, axis=1, kind="stable"), axis=1))

    def sample(self, n: int, generator: np.random.Generator) -> Indices:
        """Returns n feasible rows, spread over the vicinity."""
        rows = self._region.sample(n, generator)
        for limit in self._constraints.limits:
            if limit.change.kind != "changes" and limit.at_most < 1:  # else clipping would put most rows on its border
                rows = self._reference + np.trunc((rows - self._reference) * limit.at_most).astype(np.int64)
        return self._near(rows, np.argsort(generator.random(rows.shape), axis=1))

    def _near(self, rows: Indices, order: Indices) -> Indices:
        """Returns feasible rows as near as possible to others; the reference itself is feasible."""
        near, broken = rows.copy(), np.flatnonzero(~self._constraints.feasible(rows))
        for share in (1.0, 0.75, 0.5, 0.25, 0.0):
            moves = rows[broken] - self._reference
            for limit in self._constraints.limits:
                moves = limit.limited(moves, self._last, self._unordered, order[broken], share)
            near[broken] = self._reference + moves
            broken = broken[~self._constraints.feasible(near[broken])]
        return near


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
