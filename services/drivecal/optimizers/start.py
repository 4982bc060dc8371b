"""Start designs on the grid (Section II-B): Latin hypercube or Halton points, with expert sets among them."""

from typing import Literal

import numpy as np

from drivecal.domain.parameters import Indices

Design = Literal["lhs", "halton"]


def start_population(
    design: Design, size: int, n_values: Indices, generator: np.random.Generator, given: Indices | None = None
) -> Indices:
    """The first population, shape (size, n_searched): the rows of `given`, then points of the design.

    The design has `size` points, and its first ones are taken, so that a search with other given sets begins with the same points, whose
    results are stored. `lhs` draws from `generator`: each parameter's range is cut into `size` equal strata, each with its point.
    `halton` is the plain sequence without its first point, the corner of the space; it is the same for every seed (Section IV-B starts
    both optimizers from one such population per size). Raises ValueError if `given` has more rows than fit.
    """
    from scipy.stats import qmc  # takes more than a second, which commands that only look things up need not pay

    expert = np.empty((0, len(n_values)), dtype=np.int64) if given is None else given
    if len(expert) > size:
        raise ValueError(f"{len(expert)} given sets do not fit into a population of {size}")
    if design == "lhs":
        points = qmc.LatinHypercube(len(n_values), rng=generator).random(size)
    else:
        points = qmc.Halton(len(n_values), scramble=False).fast_forward(1).random(size)
    return np.concatenate([expert, np.floor(points[: size - len(expert)] * n_values).astype(np.int64)])
