"""Radial one-at-a-time designs from Sobol' points on the grid (Campolongo, Saltelli and Cariboni 2011, the paper's [23]).

From each base point one step is made along each parameter, to the auxiliary point's value. Base and auxiliary points are the first and
the last columns of one Sobol' sequence; the auxiliary one lies four rows further, because early rows are equal in many columns. The
sequence is scrambled by the seed (Owen), so that seeds give independent designs.

The step law: a step is at least a quarter of the explored box, and never zero. A step that is shorter after snapping to the grid is drawn
again from later rows of its own column; the base point stays.
"""

from __future__ import annotations

import numpy as np

from drivecal.domain.parameters import Indices
from drivecal.sensitivity.effects import Design, DesignBuilder, Floats

SHIFT = 4
"""Rows between a base point and its auxiliary point."""
SHORTEST = 0.25
"""The shortest step as a share of the box: shorter ones inflate the effects of a discrete score."""


class SobolRows:
    """The rows of a scrambled Sobol' sequence, drawn as they are needed; the same for the same `key`."""

    def __init__(self, dimensions: int, *key: int) -> None:
        """`key`: non-negative numbers that name the sequence, the seed first."""
        from scipy.stats import qmc  # takes more than a second, which commands that only look things up need not pay

        self._engine = qmc.Sobol(dimensions, rng=np.random.Generator(np.random.PCG64(list(key))))
        self._rows: Floats = np.empty((0, dimensions))

    def upto(self, count: int) -> Floats:
        """At least the first `count` rows, shape (>= count, dimensions), in [0, 1)."""
        while len(self._rows) < count:  # by powers of two, as the sequence wants it
            more = self._engine.random(max(8, len(self._rows)))
            self._rows = np.concatenate([self._rows, more])
        return self._rows


def snapped(unit: Floats, lower: Indices, upper: Indices) -> Indices:
    """Grid indices from `lower` to `upper`, both included and all equally likely, for numbers in [0, 1)."""
    found: Indices = lower + np.floor(unit * (upper - lower + 1)).astype(np.int64)
    return found


def shortest_steps(lower: Indices, upper: Indices, shortest: float = SHORTEST) -> Indices:
    """The shortest step in grid steps, at least one."""
    found: Indices = np.maximum(1, np.ceil(shortest * (upper - lower)).astype(np.int64))
    return found


def auxiliary_points(
    rows: SobolRows, offset: int, base: Indices, lower: Indices, upper: Indices, shortest: float = SHORTEST
) -> Indices:
    """For each base point where its step along each parameter leads, shape (r, d), as `base`.

    Column c comes from column `offset` + c of `rows`. `lower`, `upper`: the box, shape (d,), at least one grid step wide everywhere.
    Raises ValueError where it is not.
    """
    if np.any(upper <= lower):
        raise ValueError("no step can be made in a box that holds one value of a parameter")
    samples, dimensions = base.shape
    limits = shortest_steps(lower, upper, shortest)
    drawn = rows.upto(samples + SHIFT)[SHIFT : SHIFT + samples, offset : offset + dimensions]
    points = snapped(drawn, lower, upper)
    for column in range(dimensions):
        row = samples + SHIFT
        for sample in np.flatnonzero(np.abs(points[:, column] - base[:, column]) < limits[column]):
            while abs(points[sample, column] - base[sample, column]) < limits[column]:
                unit = rows.upto(row + 1)[row, offset + column]
                points[sample, column] = snapped(unit, lower[column], upper[column])
                row += 1
    return points


def radial_points(
    rows: SobolRows, lower: Indices, upper: Indices, samples: int, shortest: float = SHORTEST
) -> tuple[Indices, Indices]:
    """Base and auxiliary points in a box, both of shape (samples, d), from `rows` of 2 d dimensions."""
    base = snapped(rows.upto(samples)[:samples, : len(lower)], lower, upper)
    return base, auxiliary_points(rows, len(lower), base, lower, upper, shortest)


def radial_design(
    n_values: Indices, rows: SobolRows, lower: Indices, upper: Indices, samples: int, shortest: float = SHORTEST
) -> Design:
    """r (n_p + 1) runs in the box from `lower` to `upper`, shape (n_p,); effects of shape (n_p, r)."""
    builder = DesignBuilder(n_values)
    for column, first, second in add_radial(builder, rows, lower, upper, samples, shortest):
        builder.add_pairs(column, first, second)
    return builder.design(len(n_values))


def add_radial(
    builder: DesignBuilder, rows: SobolRows, lower: Indices, upper: Indices, samples: int, shortest: float = SHORTEST
) -> list[tuple[int, Indices, Indices]]:
    """Adds the runs of a radial design; gives per parameter its column and the rows of its pairs, each of shape (samples,)."""
    base, auxiliary = radial_points(rows, lower, upper, samples, shortest)
    first = builder.add_points(base)
    found = []
    for column in range(base.shape[1]):
        stepped = base.copy()
        stepped[:, column] = auxiliary[:, column]
        found.append((column, first, builder.add_points(stepped)))
    return found
