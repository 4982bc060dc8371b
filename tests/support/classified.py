"""Reducible spaces from the class of every grid value."""

from collections.abc import Sequence

import numpy as np

from drivecal.analysis.validation import ReducibleSpace
from drivecal.domain.parameters import Indices


def classified(classes: Sequence[Indices]) -> ReducibleSpace:
    """Returns a space whose regions are the values of one class. `classes` has an array of shape (n_values,) for each parameter."""
    regions = [[tuple(np.flatnonzero(listed == number).tolist()) for number in np.unique(listed)] for listed in classes]
    return ReducibleSpace(np.array([len(listed) for listed in classes]), regions)
