"""The feasible part of a box of grid indices: repair of infeasible sets, and feasible samples.

Chains `a <= b <= c` are sorted and linear inequalities projected. What breaks another constraint moves along a segment to a feasible set.
A replacement is a pure function of its row and the region, so that a resumed campaign repairs as before.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

Indices = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float64]
Feasible = Callable[[Indices], npt.NDArray[np.bool_]]
"""Returns which rows of grid indices, shape (n, n_searched), keep the constraints, shape (n,)."""

ANCHORS = 64
"""Feasible sets to which infeasible ones are moved."""
NEAREST = 4
"""Anchors that are tried for an infeasible set."""
BATCH = 4096
"""Sets that are handled at a time."""
MOVED = 128
"""Sets of a search that are moved by chains and inequalities; the others are drawn."""
HALVINGS = 20
"""Steps of a bisection. A set on the way to an anchor is the anchor itself or differs by more than the rounding of a continuous value."""
SWEEPS = 200
MOST_TERMS = 20_000
"""Terms that a projection visits: with more than 100 terms of inequalities it makes fewer than SWEEPS sweeps."""
CONVERGED = 1e-12
"""Largest step at the end of a projection, in shares of the ranges."""
ROUNDS = 16
"""Latin hypercubes that a sample draws to select feasible sets; also passes that narrow a box."""
WALKS = 16
"""Steps of the random walk of a repaired set into the region."""
TOGETHER = 2
"""Steps of these that lead towards another set."""
SEED = 20261121


@dataclass(frozen=True, slots=True)
class HalfSpace:
    """A half-space: the sum of `factors` times the numbers in `columns` is at most `bound`."""

    columns: Indices
    factors: Floats
    bound: float


class Polytope:
    """Chains and linear inequalities in a box of grid indices.

    The number at an index is `origins + steps * index`, in billionths, so that exact decimals are whole. Sums add one column after the
    other: a row has the same bits in any population.
    """

    def __init__(
        self, origins: Floats, steps: Floats, lower: Indices, upper: Indices, half_spaces: Sequence[HalfSpace]
    ) -> None:
        """`lower` and `upper`: the first and the last indices of the box; all shapes are (n_searched,)."""
        self._origins, self._steps = origins, steps
        self.lower, self.upper = self._narrowed(lower, upper, half_spaces)
        self._chains = _chains(half_spaces)
        self._scale = steps * np.maximum(upper - lower, 1)
        self._rows: list[tuple[list[tuple[int, float]], float, float]] = []
        """Factors of shares of the ranges by column, of length 1, with their bound and the most that rounding to the grid adds."""
        for half_space in half_spaces:
            columns, factors = half_space.columns, half_space.factors
            shares = factors * self._scale[columns]
            length = float(np.sqrt((shares**2).sum()))
            bound = half_space.bound - float((factors * origins[columns]).sum())
            rounding = float(np.abs(factors * steps[columns]).sum()) / 2
            pairs = list(zip(columns.tolist(), (shares / length).tolist(), strict=True))
            self._rows.append((pairs, bound / length, rounding / length))
        self._sweeps = max(1, min(SWEEPS, MOST_TERMS // max(1, sum(len(half_space.columns) for half_space in half_spaces))))

    def __bool__(self) -> bool:
        return bool(self._rows)

    def _narrowed(self, lower: Indices, upper: Indices, half_spaces: Sequence[HalfSpace]) -> tuple[Indices, Indices]:
        """Returns a smaller box that holds all of the polytope; the given one if nothing is left."""
        low, high = self._origins + self._steps * lower, self._origins + self._steps * upper
        for sweep in range(ROUNDS):
            before = np.concatenate([low, high])
            for half_space in half_spaces[:: -1 if sweep % 2 else 1]:
                columns, factors = half_space.columns, half_space.factors
                least = np.minimum(factors * low[columns], factors * high[columns])
                limits = (half_space.bound - least.sum() + least) / factors
                high[columns] = np.where(factors > 0, np.minimum(high[columns], limits), high[columns])
                low[columns] = np.where(factors > 0, low[columns], np.maximum(low[columns], limits))
            if np.array_equal(before, np.concatenate([low, high])):
                break
        low, high = (
            np.maximum((low - self._origins) / self._steps, lower),
            np.minimum((high - self._origins) / self._steps, upper),
        )
        first: Indices = np.ceil(low - 1e-6 - 1e-14 * np.abs(low)).astype(np.int64)
        last: Indices = np.floor(high + 1e-6 + 1e-14 * np.abs(high)).astype(np.int64)
        return (first, last) if (first <= last).all() else (lower, upper)

    def ordered(self, rows: Indices) -> Indices:
        """Returns rows whose chains are in order, with the values that they had as far as the grids have them."""
        ordered = rows.copy()
        for columns, offsets in self._chains:
            origins, steps = self._origins[columns], self._steps[columns]
            numbers = origins + steps * np.clip(rows[:, columns], self.lower[columns], self.upper[columns])
            numbers = np.sort(numbers - offsets, axis=1) + offsets
            indices = np.rint((numbers - origins) / steps)
            for place in range(1, len(columns) if np.ptp(steps) else 0):  # unlike grids: rounding may break the order
                least = origins[place - 1] + steps[place - 1] * indices[:, place - 1] + offsets[place] - offsets[place - 1]
                indices[:, place] = np.maximum(indices[:, place], np.ceil((least - origins[place]) / steps[place] - 1e-6))
            ordered[:, columns] = np.clip(indices.astype(np.int64), self.lower[columns], self.upper[columns])
        return ordered

    def projected(self, rows: Indices, inset: float) -> Indices:
        """Returns the grid points next to the nearest points of the polytope, in shares of the ranges.

        With an `inset` of 1 the inequalities are stricter by what rounding to the grid may add. Hildreth's coordinate ascent on the
        multipliers, with Dykstra's correction for the box (Boyle and Dykstra 1986).
        """
        unit = self._steps / self._scale
        points, low, high = rows * unit, (self.lower * unit)[:, np.newaxis], (self.upper * unit)[:, np.newaxis]
        moved, corrections = points.T.copy(), np.zeros_like(points.T)
        multipliers, going = np.zeros((len(self._rows), len(rows))), np.arange(len(rows))
        for _ in range(self._sweeps):
            largest = np.zeros(len(going))
            for (pairs, bound, rounding), multiplier in zip(self._rows, multipliers, strict=True):
                excess = np.full(len(going), inset * rounding - bound)
                for column, factor in pairs:
                    excess += factor * moved[column]
                step = np.maximum(excess, -multiplier)
                if step.any():
                    multiplier += step
                    np.maximum(largest, np.abs(step), out=largest)
                    for column, factor in pairs:
                        moved[column] -= factor * step
            moved += corrections
            clipped = np.clip(moved, low, high)
            np.maximum(largest, np.abs(moved - clipped - corrections).max(axis=0), out=largest)
            corrections, moved = moved - clipped, clipped
            goes_on = largest > CONVERGED
            if not goes_on.all():
                points[going[~goes_on]] = moved.T[~goes_on]
                moved, corrections, multipliers = moved[:, goes_on], corrections[:, goes_on], multipliers[:, goes_on]
                going = going[goes_on]
            if not len(going):
                break
        points[going] = moved.T
        nearest: Indices = np.clip(np.rint(points / unit).astype(np.int64), self.lower, self.upper)
        return nearest


def _chains(half_spaces: Sequence[HalfSpace]) -> list[tuple[Indices, Floats]]:
    """Returns chains of columns, the smallest first, with the offsets that make each an order; no column is in two chains."""
    following: dict[int, tuple[int, float]] = {}
    preceding: set[int] = set()
    for half_space in sorted(half_spaces, key=lambda half_space: half_space.bound):
        if len(half_space.columns) != 2 or half_space.factors[0] != -half_space.factors[1] or half_space.bound > 0:
            continue
        smaller, larger = half_space.columns.tolist() if half_space.factors[0] > 0 else half_space.columns[::-1].tolist()
        end = larger
        while end in following:
            end, _ = following[end]
        if smaller not in following and larger not in preceding and end != smaller:
            following[smaller] = larger, half_space.bound / abs(float(half_space.factors[0]))
            preceding.add(larger)
    chains: list[tuple[Indices, Floats]] = []
    for first in sorted(following.keys() - preceding):
        columns, offsets = [first], [0.0]
        while columns[-1] in following:
            column, gap = following[columns[-1]]
            columns.append(column)
            offsets.append(offsets[-1] - gap)
        chains.append((np.array(columns), np.array(offsets)))
    return chains


class FeasibleRegion:
    """The feasible sets of a box of grid indices. Rows have the shape (n, n_searched)."""

    def __init__(
        self, polytope: Polytope, feasible: Feasible, *, read: Indices, unordered: npt.NDArray[np.bool_], drawn: int
    ) -> None:
        """Searches feasible sets, see `is_empty`.

        Args:
            polytope: the box, with chains and inequalities that all feasible sets keep.
            feasible: the constraints.
            read: columns that the constraints read; repair changes no others.
            unordered: which columns have values without an order, shape (n_searched,).
            drawn: number of sets that the search tries.
        """
        self.feasible = feasible
        self._polytope, self._read, self._unordered = polytope, read, unordered
        self._width = np.maximum(polytope.upper - polytope.lower, 1)
        self._found = self._search(drawn)

    @property
    def is_empty(self) -> bool:
        """True if no feasible set was found."""
        return not len(self._found)

    def _search(self, drawn: int) -> Indices:
        """Returns at most ANCHORS feasible sets: of the middle, two corners, sets that are moved and sets that are drawn."""
        drawing = np.random.Generator(np.random.PCG64(SEED))
        lower, upper = self._polytope.lower, self._polytope.upper
        rows = np.stack([(lower + upper) // 2, lower, upper])
        kept = rows[self.feasible(rows)]
        if self._polytope:
            count = min(MOVED, drawn // 4)  # each is looked at up to four times
            moved, broken = self._moved(drawing.integers(lower, upper + 1, size=(count, len(lower))))
            kept, drawn = np.concatenate([kept, np.delete(moved, broken, axis=0)]), drawn - 4 * count
        while drawn and len(kept) < ANCHORS:
            size = min(BATCH, drawn)
            rows = self._polytope.ordered(drawing.integers(lower, upper + 1, size=(size, len(lower))))
            kept, drawn = np.concatenate([kept, rows[self.feasible(rows)]]), drawn - size
        return kept[:ANCHORS]

    @cached_property
    def _anchors(self) -> Indices:
        """ANCHORS feasible sets: the sets of the search, and walks from them if they are fewer."""
        if self.is_empty:
            raise ValueError("nothing is feasible")
        if len(self._found) == ANCHORS:
            return self._found
        drawing = np.random.Generator(np.random.PCG64([SEED, 1]))
        return np.concatenate([self._found, self._walked(np.resize(self._found, (ANCHORS, len(self._width))), drawing)])

    def repair(self, population: Indices) -> Indices:
        """Returns the population with a feasible row near each infeasible one; feasible rows stay as they are."""
        repaired = population.copy()
        for start in range(0, len(population), BATCH):
            moved, broken = self._moved(population[start : start + BATCH])
            if len(broken):
                moved[broken] = self._nearest_on_segments(moved[broken])
            repaired[start : start + BATCH] = moved
        return repaired

    def sample(self, n: int, generator: np.random.Generator) -> Indices:
        """Returns n feasible rows, spread over the region: points of Latin hypercubes, then random walks into the region.

        Rows are equal only in regions of few sets.
        """
        kept = np.empty((0, len(self._width)), dtype=np.int64)
        for _ in range(ROUNDS):
            rows = self._polytope.ordered(self._hypercube(n, generator))
            kept = np.concatenate([kept, rows[self.feasible(rows)]])
            if len(kept) >= n:
                return kept[:n]
        return np.concatenate([kept, self._walked(self.repair(self._hypercube(n - len(kept), generator)), generator)])

    def room(self, rows: Indices, column: int) -> tuple[Indices, Indices]:
        """Returns the first and last index of a column that feasible rows can reach, shape (n,) each; of a choice all."""
        own, direction = rows[:, column], np.zeros(rows.shape)
        if self._unordered[column]:
            return 0 * own + self._polytope.lower[column], 0 * own + self._polytope.upper[column]
        direction[:, column] = 1.0
        return own - np.rint(self._reach(rows, -direction)).astype(int), own + np.rint(self._reach(rows, direction)).astype(int)

    def _hypercube(self, n: int, generator: np.random.Generator) -> Indices:
        shape = (n, len(self._width))
        strata = generator.permuted(np.tile(np.arange(n)[:, np.newaxis], (1, shape[1])), axis=0)
        counts = self._polytope.upper - self._polytope.lower + 1
        offsets = np.floor((strata + generator.random(shape)) / n * counts).astype(np.int64)
        rows: Indices = self._polytope.lower + np.minimum(offsets, counts - 1)
        return rows

    def _moved(self, rows: Indices) -> tuple[Indices, Indices]:
        """Returns rows with chains in order and inequalities kept where they were infeasible, and which are infeasible still."""
        moved, broken = rows.copy(), np.flatnonzero(~self.feasible(rows))
        if self._polytope and len(broken):
            moved[broken] = self._polytope.ordered(moved[broken])
            broken = broken[~self.feasible(moved[broken])]
        if self._polytope and len(broken):
            moved[broken] = self._polytope.projected(moved[broken], 0.0)
            broken = broken[~self.feasible(moved[broken])]
        if self._polytope and len(broken):
            inside = self._polytope.projected(moved[broken], 1.0)
            allowed = self.feasible(inside)
            moved[broken[allowed]] = inside[allowed]
            broken = broken[~allowed]
        return moved, broken

    def _nearest_on_segments(self, rows: Indices) -> Indices:
        """Returns the nearest of the first feasible points on the ways to near anchors, with each value of its row that it may keep."""
        order = np.argsort(np.stack([self._distances(rows, anchor) for anchor in self._anchors]), axis=0, kind="stable")
        best, away = rows.copy(), np.full(len(rows), np.inf)
        for nearest in order[:NEAREST]:
            targets = self._anchors[nearest]
            reached = self._between(rows, targets, self._first_feasible(rows, targets))
            distance = self._distances(rows, reached)
            nearer = distance < away
            best[nearer], away[nearer] = reached[nearer], distance[nearer]
        for column in self._read.tolist():
            restored = best.copy()
            restored[:, column] = rows[:, column]
            allowed = self.feasible(restored)
            best[allowed] = restored[allowed]
        return best

    def _first_feasible(self, rows: Indices, targets: Indices) -> Floats:
        """Returns the shares of the ways to feasible targets from which on rows are feasible, by bisection."""
        near, far = np.zeros(len(rows)), np.ones(len(rows))
        for _ in range(HALVINGS):
            middle = (near + far) / 2
            allowed = self.feasible(self._between(rows, targets, middle))
            far, near = np.where(allowed, middle, far), np.where(allowed, near, middle)
        return far

    def _between(self, rows: Indices, targets: Indices, shares: Floats) -> Indices:
        """Returns points at `shares` of the way, shape (n,), in the columns that constraints read. Unordered values change at half."""
        way, between = shares[:, np.newaxis], rows.copy()
        steps = np.rint((targets - rows) * way).astype(np.int64)
        moved = np.where(self._unordered, np.where(way < 0.5, rows, targets), rows + steps)
        between[:, self._read] = moved[:, self._read]
        return between

    def _distances(self, rows: Indices, others: Indices) -> Floats:
        """Returns squares of distances in shares of the ranges, shape (n,), in the columns that constraints read."""
        total = np.zeros(len(rows))
        for column in self._read.tolist():
            share = (others[..., column] - rows[:, column]) / self._width[column]
            total += share != 0 if self._unordered[column] else share * share
        return total

    def _walked(self, rows: Indices, generator: np.random.Generator) -> Indices:
        """Returns feasible rows after random walks from feasible rows.

        First steps lead towards other rows, away from the region's corners, where most directions leave it at once. The others are
        hit-and-run (Smith 1984), with new draws of values without an order.
        """
        lower, upper = self._polytope.lower, self._polytope.upper
        moves = np.zeros(len(lower), dtype=np.bool_)
        moves[self._read] = (~self._unordered & (lower < upper))[self._read]
        for step in range(WALKS):
            if step < TOGETHER:
                direction = np.where(moves, rows[generator.permutation(len(rows))] - rows, 0.0)
                shares = generator.random(len(rows))
            else:
                chosen = self._unordered & (generator.random(rows.shape) < 0.5)
                drawn = np.where(chosen, generator.integers(lower, upper + 1, size=rows.shape), rows)
                rows = np.where(self.feasible(drawn)[:, np.newaxis], drawn, rows)
                direction = np.where(moves, generator.standard_normal(rows.shape) * self._width, 0.0)
                back, forth = self._reach(rows, -direction), self._reach(rows, direction)
                shares = (back + forth) * generator.random(len(rows)) - back
            drawn = rows + np.rint(shares[:, np.newaxis] * direction).astype(np.int64)
            rows = np.where(self.feasible(drawn)[:, np.newaxis], drawn, rows)
        return rows

    def _reach(self, rows: Indices, direction: Floats) -> Floats:
        """Returns how many times of a direction feasible rows can go, shape (n,)."""
        lower, upper = self._polytope.lower, self._polytope.upper
        moving = direction != 0
        room = np.where(direction > 0, upper - rows, rows - lower)
        limits = np.divide(room, np.abs(direction), out=np.full(rows.shape, np.inf), where=moving).min(axis=1)
        limits = np.where(np.isfinite(limits), limits, 0.0)
        ends = rows + np.trunc(limits[:, np.newaxis] * direction).astype(np.int64)
        return limits * (1 - self._first_feasible(ends, rows))
