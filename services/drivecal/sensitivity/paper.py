"""The paper's own design of the interval analyses (Section II-A, Equation 3)."""

from collections.abc import Sequence

import numpy as np

from drivecal.domain.parameters import Indices
from drivecal.sensitivity.effects import Design, DesignBuilder, Unordered
from drivecal.sensitivity.radial import COLUMNS, SobolRows, add_radial, shortest_shares


def paper_design(
    n_values: Indices, edges: Sequence[Indices], samples: int, seed: int, tag: int, unordered: Unordered | None = None
) -> Design:
    """For each parameter and interval, a whole radial design with the parameter confined to the interval, the others over their range.

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
