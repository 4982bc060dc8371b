"""Designs along the parameters' axes: many boxes of one parameter share the same base points.

An analysis of one parameter in one box needs two runs per effect that differ in that parameter alone. A radial design gives the effects
of all parameters; complexity reduction uses one of them. Here every base point has, for each parameter and box, two points inside the
box, with the base point's values of all others and with the step law of the radial design.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from drivecal.domain.parameters import Indices
from drivecal.sensitivity.effects import Design, DesignBuilder, Unordered
from drivecal.sensitivity.radial import COLUMNS, SHORTEST, SobolRows, auxiliary_points, snapped

BASE, PAIRS = 1, 2
"""Key of a design's sequence: base points, or the pairs of a box."""


def base_points(n_values: Indices, samples: int, *key: int) -> Indices:
    """Sobol' points over the full space, shape (samples, n_searched)."""
    unit = SobolRows(len(n_values), *key, BASE).upto(samples)[:samples]
    return snapped(unit, np.zeros_like(n_values), n_values - 1)


def pairs_inside(
    own: Indices, mine: npt.NDArray[np.bool_], lower: int, upper: int, *key: int, shortest: float = SHORTEST
) -> tuple[Indices, Indices]:
    """Two values of one parameter per base point, both of shape (samples,), inside [lower, upper], at least a step apart.

    `own`: the base points' values, which serve as the first where `mine` says that they lie in this box; shape (samples,).
    """
    rows = SobolRows(COLUMNS, *key, PAIRS)
    box = np.array([lower]), np.array([upper])
    first = np.where(mine, own, snapped(rows.upto(len(own))[: len(own), 0], *box))
    return first, auxiliary_points(rows, 1, first[:, np.newaxis], *box, shortest)[:, 0]


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
            shortest = _shortest(column, unordered)
            key = (seed, tag, column, interval)
            first, second = pairs_inside(base[:, column], mine, lower, upper, *key, shortest=shortest)
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
) -> Design:
    """Returns an analysis per (column, lower, upper) in `regions`, on shared base points: 2 r runs each; effects (n_regions, r).

    A base point inside a region is the first of the two, so that regions share these runs; what is asked twice is
    answered by the reference table. Equal regions have equal points, whatever else is in the list.
    """
    base = base_points(n_values, samples, seed, tag)
    builder = DesignBuilder(n_values, unordered)
    for column, lower, upper in regions:
        own = base[:, column]
        mine = (own >= lower) & (own <= upper)
        first, second = pairs_inside(own, mine, lower, upper, seed, tag, column, shortest=_shortest(column, unordered))
        rows = builder.add_points(_moved(base, column, first))
        builder.add_pairs(column, rows, builder.add_points(_moved(base, column, second)))
    return builder.design(len(regions))


def _shortest(column: int, unordered: Unordered | None) -> float:
    """Returns the shortest step of a parameter as a share of a box; between choices every change is as long."""
    return 0.0 if unordered is not None and unordered[column] else SHORTEST


def _moved(points: Indices, column: int, values: Indices) -> Indices:
    moved = points.copy()
    moved[:, column] = values
    return moved
