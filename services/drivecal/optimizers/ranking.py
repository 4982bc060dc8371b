"""Order of individuals by fitness."""

import numpy as np

from drivecal.domain.parameters import Indices
from drivecal.plugins.ports import Floats

EQUAL_DECIMALS = 9
"""Objectives that agree in so many decimals are equal: what is left of them is the order in which weights were summed."""


def ranking(objectives: Floats, tie_breakers: Floats) -> Indices:
    """Positions from the fittest to the least fit, shape (n,): by objective, equal ones by tie breaker, then by position.

    NaN, an individual without a result, comes last.
    """
    first, second = fitness(objectives, tie_breakers).T
    order: Indices = np.lexsort((-second, -first)).astype(np.int64)  # stable: equal keys stay in order of position
    return order


def fitness(objectives: Floats, tie_breakers: Floats) -> Floats:
    """Returns sort keys, the first column before the second, higher is fitter; shape (n, 2). NaN is lowest."""
    first = np.where(np.isnan(objectives), -np.inf, np.round(objectives, EQUAL_DECIMALS))
    second = np.where(np.isnan(tie_breakers), -np.inf, tie_breakers)
    return np.column_stack([first, second])
