"""Sets among which a search chooses: spread over the space, and children of good sets."""

from collections.abc import Sequence

import numpy as np

from drivecal.domain.parameters import Indices, Kind

CROSSED = 0.3
"""Share of the children that have two parents."""
SHORTEST, LONGEST = 0.005, 0.3
"""Deviations of steps, in ranges; each child has its own, on a logarithmic scale."""


def children(parents: Indices, count: int, n_values: Indices, kinds: Sequence[Kind], generator: np.random.Generator) -> Indices:
    """Returns rows near parents, shape (count, n_searched); the first parents have the most. Each child differs in one parameter or more,
    on grids by a step at least; the values of choices have no order."""
    last, width = n_values - 1, len(n_values)
    first = parents[np.minimum((generator.random(count) ** 2 * len(parents)).astype(np.int64), len(parents) - 1)]
    second = parents[generator.integers(len(parents), size=count)]
    crossed = (generator.random((count, 1)) < CROSSED) & (generator.random((count, width)) < 0.5)
    rows = np.where(crossed, second, first)
    share = np.exp(generator.uniform(np.log(1.0 / width), 0.0, size=(count, 1)))
    moved = generator.random((count, width)) < share
    moved[np.arange(count), generator.integers(width, size=count)] = True
    deviation = np.exp(generator.uniform(np.log(SHORTEST), np.log(LONGEST), size=(count, 1)))
    steps = np.rint(generator.normal(size=(count, width)) * deviation * last).astype(np.int64)
    steps = np.where(steps == 0, 2 * generator.integers(0, 2, size=(count, width)) - 1, steps)
    stepped = np.abs(rows + steps)
    stepped = np.clip(np.where(stepped > last, 2 * last - stepped, stepped), 0, last)
    anywhere = generator.integers(0, n_values, size=(count, width))
    unordered = np.array([kind == "choice" for kind in kinds])
    return np.where(moved, np.where(unordered, anywhere, stepped), rows)
