"""Radial one-at-a-time designs from Sobol' points on the grid (Campolongo, Saltelli and Cariboni 2011, the paper's [23]).

From each base point one step is made along each parameter, to the auxiliary point's value. Base and auxiliary points are the first and
the last columns of one Sobol' sequence; the auxiliary one lies four rows further, because early rows are equal in many columns. The
sequence is scrambled by the seed (Owen), so that seeds give independent designs.

The step law: a step is at least a quarter of the explored box, and never zero. Where it is shorter after snapping to the grid, it is drawn
again among the values that are far enough, from further columns of the same sequence; the base point stays. So, given the base point,
every value that is far enough is equally likely. Later rows of the same column would not do: they are digital shifts of earlier ones, so
that what is drawn again would depend on what was rejected (and with it the mean step, by 6 %).
"""

from collections.abc import Sequence

import numpy as np

from drivecal.domain.parameters import Indices
from drivecal.sensitivity.effects import Design, DesignBuilder, Floats, Unordered

SHIFT = 4
"""Rows between a base point and its auxiliary point."""
SHORTEST = 0.25
"""The shortest step as a share of the box: shorter ones inflate the effects of a discrete score."""


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


def shortest_shares(unordered: Unordered | None, shortest: float = SHORTEST) -> float | Floats:
    """Returns the shortest step as a share of the box; by parameter if there are choices, between which every change is as long."""
    return shortest if unordered is None else np.where(unordered, 0.0, shortest)


def shortest_steps(lower: Indices, upper: Indices, shortest: float | Floats = SHORTEST) -> Indices:
    """The shortest step in grid steps, at least one."""
    steps: Indices = np.maximum(1, np.ceil(shortest * (upper - lower)).astype(np.int64))
    return steps


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
    limits = shortest_steps(lower, upper, shortest)
    drawn = rows.upto(samples + SHIFT)[SHIFT : SHIFT + samples, offset : offset + 2 * dimensions]
    points = snapped(drawn[:, :dimensions], lower, upper)
    # values below the base point and above it that are far enough; at least one, the shortest step being half the box at most
    below = np.maximum(0, base - limits - lower + 1)
    above = np.maximum(0, upper - limits - base + 1)
    place = np.floor(drawn[:, dimensions:] * (below + above)).astype(np.int64)
    again = np.where(place < below, lower + place, upper + 1 - (below + above) + place)
    return np.where(np.abs(points - base) < limits, again, points)


def radial_points(
    rows: SobolRows, lower: Indices, upper: Indices, samples: int, shortest: float | Floats = SHORTEST
) -> tuple[Indices, Indices]:
    """Base and auxiliary points in a box, both of shape (samples, d), from `rows` of `COLUMNS` d dimensions."""
    base = snapped(rows.upto(samples)[:samples, : len(lower)], lower, upper)
    return base, auxiliary_points(rows, len(lower), base, lower, upper, shortest)


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
    builder = DesignBuilder(n_values, unordered)
    for column, first, second in add_radial(builder, rows, lower, upper, samples, shortest_shares(unordered, shortest)):
        builder.add_pairs(column, first, second)
    return builder.design(len(n_values))


def add_radial(
    builder: DesignBuilder,
    rows: SobolRows,
    lower: Indices,
    upper: Indices,
    samples: int,
    shortest: float | Floats = SHORTEST,
) -> list[tuple[int, Indices, Indices]]:
    """Adds the runs of a radial design; gives per parameter its column and the rows of its pairs, each of shape (samples,)."""
    base, auxiliary = radial_points(rows, lower, upper, samples, shortest)
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
            pairs = add_radial(builder, rows, lower, upper, samples, shortest_shares(unordered))
            builder.add_pairs(*pairs[column])
        builder.add_gaps(column, samples, most - len(marks) + 1)
    return builder.design(len(n_values), most)
