"""Radial designs from Sobol' points (Campolongo, Saltelli and Cariboni 2011, the paper's [23]), designs along axes.

From each base point one step is made along each parameter, to the auxiliary point's value. Base and auxiliary points are the first and
the last columns of one Sobol' sequence; the auxiliary one lies four rows further, because early rows are equal in many columns. The
sequence is scrambled by the seed (Owen), so that seeds give independent designs.

The step law: a step is at least a quarter of the explored box, and never zero. Where it is shorter after snapping to the grid, it is
drawn again among the values that are far enough, from further columns of the same sequence; the base point stays. So, given the base
point, every value that is far enough is equally likely. Later rows of the same column would not do: they are digital shifts of earlier
ones, so that what is drawn again would depend on what was rejected (and with it the mean step, by 6 %).

Along the parameters' axes, many boxes of one parameter share the same base points. An analysis of one parameter in one box needs two
runs per effect that differ in that parameter alone. A radial design gives the effects of all parameters; complexity reduction uses one
of them. Here every base point has, for each parameter and box, two points inside the box, with the base point's values of all others
and with the step law of the radial design.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from drivecal.domain.parameters import Indices
from drivecal.domain.regions import FeasibleRegion
from drivecal.domain.scales import COMFORT

Floats = npt.NDArray[np.float64]
Unordered = npt.NDArray[np.bool_]
"""Parameters that are choices, shape (n_searched,)."""


@dataclass(frozen=True)
class Design:
    """Points to run and which two of them make each elementary effect.

    `points`: grid indices, shape (n, n_searched). `first`, `second`: rows of `points`, and `steps`: the signed step from one to the
    other in units of the parameter's full range, never 0; all of one shape, whose last axis is the samples. Thresholds see `judged`: steps
    that are at least as long as the law says, where constraints shortened them: an effect is a slope. A change between choices, which
    have no order, is a step of the full range. Parameters with fewer intervals than others have NaN steps in the rest.
    """

    points: Indices
    first: Indices
    second: Indices
    steps: Floats
    judged: Floats

    @cached_property
    def samples(self) -> Indices:
        """The sample of each point, from 0, shape (n,): the two runs of an effect belong to one; 0 for points without an effect."""
        samples = np.zeros(len(self.points), dtype=np.int64)
        made = ~np.isnan(self.steps)
        numbers = np.broadcast_to(np.arange(self.first.shape[-1]), self.first.shape)[made]
        samples[self.first[made]] = samples[self.second[made]] = numbers
        return samples

    def effects(self, scores: Floats, span: float = COMFORT.span) -> Floats:
        """Elementary effects, shaped as `steps`, from the points' scores, shape (n,); NaN if one of the two runs failed.

        Changes of the score are divided by the `span` of its scale: an effect of 1 is the whole scale over the whole range.
        """
        changes: Floats = (scores[self.second] - scores[self.first]) / span
        return changes / self.steps


SHORTEST = 0.25
"""The shortest step as a share of the box: shorter ones inflate the effects of a discrete score."""


class DesignBuilder:
    """Collects the points and pairs of a design."""

    def __init__(self, n_values: Indices, unordered: Unordered | None = None, shortest: float = SHORTEST) -> None:
        """`n_values`: grid sizes of the searched parameters; `unordered`: which of them are choices; shape (n_searched,). `shortest`: the
        shortest step as a share of the box."""
        self._n_values = n_values
        self._unordered = np.zeros(len(n_values), dtype=np.bool_) if unordered is None else unordered
        self.shortest = np.where(self._unordered, 0.0, shortest)
        """Shortest step of each parameter: between choices every change is as long."""
        self._points: list[Indices] = []
        self._pairs: list[tuple[int, Indices, Indices, float]] = []
        self._count = 0

    def add_points(self, points: Indices) -> Indices:
        """Adds runs, shape (n, n_searched); gives their row numbers, shape (n,)."""
        rows = np.arange(self._count, self._count + len(points))
        self._points.append(points)
        self._count += len(points)
        return rows

    def add_pairs(self, column: int, first: Indices, second: Indices, judged: float = 0.0) -> None:
        """Adds one analysis of r effects of the parameter in `column`: pairs of rows, shape (r,), that differ only in that column."""
        self._pairs.append((column, first, second, judged))

    def add_gaps(self, column: int, samples: int, count: int) -> None:
        """Adds `count` analyses without effects, in place of intervals that the parameter in `column` does not have or reach."""
        nothing = np.zeros(samples, dtype=np.int64)
        self._pairs += [(column, nothing, nothing, 0.0)] * count

    def design(self, *shape: int) -> Design:
        """Returns the design, with its analyses in the order of their addition, shaped (*shape, r)."""
        if not self._count:
            self.add_points(np.zeros((1, len(self._n_values)), dtype=np.int64))  # gaps alone need a row to refer to
        points = np.concatenate(self._points)
        points.flags.writeable = False  # scenarios share them, and effects are computed from them later
        every, firsts, seconds, least = zip(*self._pairs, strict=True)
        first, second, columns = np.stack(firsts), np.stack(seconds), np.array(every)[:, np.newaxis]
        moves = points[second, columns] - points[first, columns]
        steps = np.where(self._unordered[columns], np.sign(moves), moves / (self._n_values[columns] - 1))
        steps[first == second] = np.nan
        judged = np.copysign(np.maximum(np.abs(steps), np.array(least)[:, np.newaxis]), steps)
        full = (*shape, first.shape[-1])
        return Design(points, *(each.reshape(full) for each in (first, second, steps, judged)))


SHIFT = 4
"""Rows between a base point and its auxiliary point."""
COLUMNS = 3
"""Columns per parameter: the base point's, the auxiliary point's, and those for drawing again."""


class SobolRows:
    """The rows of a scrambled Sobol' sequence, drawn as they are needed; the same for the same `key`."""

    def __init__(self, dimensions: int, *key: int) -> None:
        """`key`: non-negative numbers that name the sequence, the seed first."""
        from scipy.stats import qmc  # takes more than a second, which commands that only look things up need not pay

        self._engine = qmc.Sobol(dimensions, rng=np.random.Generator(np.random.PCG64(list(key))))
        self._rows: Floats = np.empty((0, dimensions))

    def upto(self, count: int) -> Floats:
        """Returns at least the first `count` rows, shape (>= count, dimensions), in [0, 1)."""
        while len(self._rows) < count:  # by powers of two, as the sequence wants it
            more = self._engine.random(max(8, len(self._rows)))
            self._rows = np.concatenate([self._rows, more])
        return self._rows


def snapped(unit: Floats, lower: Indices, upper: Indices) -> Indices:
    """Grid indices from `lower` to `upper`, both included and all equally likely, for numbers in [0, 1)."""
    indices: Indices = lower + np.floor(unit * (upper - lower + 1)).astype(np.int64)
    return indices


def auxiliary_points(
    rows: SobolRows, offset: int, base: Indices, lower: Indices, upper: Indices, shortest: float | Floats = SHORTEST
) -> Indices:
    """End points of each base point's step along each parameter, shape (r, d), as `base`.

    Parameter c takes column `offset` + c of `rows`, and if it is drawn again column `offset` + d + c. `lower`, `upper`: the box, shape
    (d,), at least one grid step wide everywhere. Raises ValueError if it is not.
    """
    if np.any(upper <= lower):
        raise ValueError("no step can be made in a box that holds one value of a parameter")
    samples, dimensions = base.shape
    limits: Indices = np.maximum(1, np.ceil(shortest * (upper - lower)).astype(np.int64))  # the shortest step in grid steps
    drawn = rows.upto(samples + SHIFT)[SHIFT : SHIFT + samples, offset : offset + 2 * dimensions]
    points = snapped(drawn[:, :dimensions], lower, upper)
    # values below the base point and above it that are far enough; at least one, the shortest step being half the box at most
    below = np.maximum(0, base - limits - lower + 1)
    above = np.maximum(0, upper - limits - base + 1)
    place = np.floor(drawn[:, dimensions:] * (below + above)).astype(np.int64)
    again = np.where(place < below, lower + place, upper + 1 - (below + above) + place)
    return np.where(np.abs(points - base) < limits, again, points)


def radial_design(
    n_values: Indices,
    rows: SobolRows,
    lower: Indices,
    upper: Indices,
    samples: int,
    shortest: float = SHORTEST,
    unordered: Unordered | None = None,
) -> Design:
    """r (n_p + 1) runs in the box from `lower` to `upper`, shape (n_p,); effects of shape (n_p, r)."""
    builder = DesignBuilder(n_values, unordered, shortest)
    for column, first, second in add_radial(builder, rows, lower, upper, samples):
        builder.add_pairs(column, first, second)
    return builder.design(len(n_values))


def add_radial(
    builder: DesignBuilder, rows: SobolRows, lower: Indices, upper: Indices, samples: int
) -> list[tuple[int, Indices, Indices]]:
    """Adds the runs of a radial design; gives per parameter its column and the rows of its pairs, each of shape (samples,)."""
    base = snapped(rows.upto(samples)[:samples, : len(lower)], lower, upper)
    auxiliary = auxiliary_points(rows, len(lower), base, lower, upper, builder.shortest)
    first = builder.add_points(base)
    blocks = []
    for column in range(base.shape[1]):
        stepped = base.copy()
        stepped[:, column] = auxiliary[:, column]
        blocks.append((column, first, builder.add_points(stepped)))
    return blocks


def paper_design(
    n_values: Indices, edges: Sequence[Indices], samples: int, seed: int, tag: int, unordered: Unordered | None = None
) -> Design:
    """The paper's own design of the interval analyses (Section II-A, Equation 3): for each parameter and interval, a whole radial design
    with the parameter confined to the interval, the others over their range.

    n_p n_Int r (n_p + 1) runs. Each analysis has Sobol' points of its own. Of each, the effects of the confined parameter count,
    shape (n_p, n_Int, r); the others' runs feed the reference table only, as in the paper.
    """
    builder, most = DesignBuilder(n_values, unordered), max(map(len, edges)) - 1
    for column, marks in enumerate(edges):
        for interval in range(len(marks) - 1):
            lower, upper = np.zeros_like(n_values), n_values - 1
            lower[column], upper[column] = marks[interval], marks[interval + 1]
            rows = SobolRows(COLUMNS * len(n_values), seed, tag, column, interval + 1)
            builder.add_pairs(*add_radial(builder, rows, lower, upper, samples)[column])
        builder.add_gaps(column, samples, most - len(marks) + 1)
    return builder.design(len(n_values), most)


BASE, PAIRS = 1, 2
"""Key of a design's sequence: base points, or the pairs of a box."""
POOL = 8
"""Feasible points for each sample; those with room for a step serve."""


def base_points(n_values: Indices, samples: int, *key: int) -> Indices:
    """Sobol' points over the full space, shape (samples, n_searched)."""
    unit = SobolRows(len(n_values), *key, BASE).upto(samples)[:samples]
    return snapped(unit, np.zeros_like(n_values), n_values - 1)


def pairs_inside(
    own: Indices, mine: npt.NDArray[np.bool_], lower: Indices, upper: Indices, *key: int, shortest: float
) -> tuple[Indices, Indices]:
    """Two values of one parameter per base point, both of shape (samples,), inside [lower, upper], at least a step apart.

    `own`: the base points' values, which serve as the first where `mine` says that they lie in the box; shape (samples,). `lower`,
    `upper`: one box, shape (1,), or one for each of them.
    """
    rows = SobolRows(COLUMNS, *key, PAIRS)
    first = np.where(mine, own, snapped(rows.upto(len(own))[: len(own), 0], lower, upper))
    return first, auxiliary_points(rows, 1, first[:, np.newaxis], lower[:, np.newaxis], upper[:, np.newaxis], shortest)[:, 0]


def lines_design(
    n_values: Indices, edges: Sequence[Indices], samples: int, seed: int, tag: int, unordered: Unordered | None = None
) -> Design:
    """The intervals between `edges` of every parameter on shared base points: r (1 + n_p (2 n_Int - 1)) runs.

    Effects have shape (n_p, n_Int, r); parameters may have fewer intervals than others. In the interval where a base point lies, it is
    one of the two; on a shared edge it belongs to the upper interval.
    """
    base = base_points(n_values, samples, seed, tag)
    builder, most = DesignBuilder(n_values, unordered), max(map(len, edges)) - 1
    base_rows = builder.add_points(base)
    for column, marks in enumerate(edges):
        home = np.minimum(np.searchsorted(marks, base[:, column], side="right") - 1, len(marks) - 2)
        for interval, (lower, upper) in enumerate(pairwise(marks.tolist())):
            mine = home == interval
            key = (seed, tag, column, interval)
            box, shortest = (np.array([lower]), np.array([upper])), float(builder.shortest[column])
            first, second = pairs_inside(base[:, column], mine, *box, *key, shortest=shortest)
            first_rows = base_rows.copy()
            first_rows[~mine] = builder.add_points(_moved(base[~mine], column, first[~mine]))
            builder.add_pairs(column, first_rows, builder.add_points(_moved(base, column, second)))
        builder.add_gaps(column, samples, most - len(marks) + 1)
    return builder.design(len(n_values), most)


def regions_design(
    n_values: Indices,
    regions: Sequence[tuple[int, int, int]],
    samples: int,
    seed: int,
    tag: int,
    unordered: Unordered | None = None,
    inside: FeasibleRegion | None = None,
    shape: tuple[int, ...] = (),
) -> Design:
    """Returns an analysis per (column, lower, upper) in `regions`, on shared base points: 2 r runs each; effects (n_regions, r).

    `inside`: an analysis has feasible base points, from which the parameter can cross half of the region, or the most; there its box ends
    where the parameter leaves the feasible region. Regions without two steps are gaps. `shape`: that of the effects, less samples.
    A base point inside a region is the first of the two, so that regions share these runs; what is asked twice is answered by
    the reference table. Equal regions have equal points, whatever else is in the list.
    """
    drawing = np.random.Generator(np.random.PCG64([seed, tag, BASE]))
    base = pool = base_points(n_values, samples, seed, tag) if inside is None else inside.sample(POOL * samples, drawing)
    builder, columns = DesignBuilder(n_values, unordered), {column for column, _, _ in regions}
    rooms = {} if inside is None else {column: inside.room(pool, column) for column in columns}
    for column, least, most in regions:
        lower, upper = np.array([least]), np.array([most])
        if rooms:
            start, end = rooms[column]
            room = np.minimum(np.minimum(end, most) - np.maximum(start, least), (most - least + 1) // 2)
            if np.count_nonzero(room > 0) < 2:
                builder.add_gaps(column, samples, 1)
                continue
            chosen = np.argsort(-room, kind="stable")[:samples]
            base, lower = pool[chosen], np.clip(start[chosen], least, most - 1)
            upper = np.clip(end[chosen], lower + 1, most)
        own, key, shortest = base[:, column], (seed, tag, column), float(builder.shortest[column])
        first, second = pairs_inside(own, (own >= lower) & (own <= upper), lower, upper, *key, shortest=shortest)
        judged = shortest * (most - least) / (n_values[column] - 1) if rooms else 0.0
        rows = builder.add_points(_moved(base, column, first))
        builder.add_pairs(column, rows, builder.add_points(_moved(base, column, second)), judged)
    return builder.design(*(shape or (len(regions),)))


def _moved(points: Indices, column: int, values: Indices) -> Indices:
    moved = points.copy()
    moved[:, column] = values
    return moved
