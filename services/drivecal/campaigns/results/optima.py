"""The regions of the sets that share a campaign's best objective."""

from collections.abc import Sequence
from itertools import takewhile

import numpy as np
import numpy.typing as npt

from drivecal.analysis.optima import regions
from drivecal.analysis.solutions import EvaluatedSet
from drivecal.domain.parameters import ParameterSet, ParameterSpace
from drivecal.reduction.prediction import FeatureSpace
from drivecal.storage.engine.database import Database
from drivecal.storage.references import parameter_sets

MOST_BEST = 10_000
"""Largest number of best sets to compare, best rated first: the work grows with its square."""


def best_regions(database: Database, ranking: Sequence[EvaluatedSet], space: ParameterSpace) -> npt.NDArray[np.int64]:
    """Returns the regions of the first sets of a `ranking`, best first, that share the best objective: at most MOST_BEST."""
    best = takewhile(lambda each: each.choice.equals(ranking[0].choice), ranking[:MOST_BEST])
    numbers = [each.parameter_set for each in best]
    sets = database.query(parameter_sets.load, numbers)
    return regions_of(space, [sets[number] for number in numbers])


def regions_of(space: ParameterSpace, sets: Sequence[ParameterSet]) -> npt.NDArray[np.int64]:
    """Returns the region of each set: root mean squares of differences are shares of the ranges, and another choice is a whole range
    away."""
    columns = FeatureSpace(space)(sets).T
    parts = [
        np.sqrt(0.5) * (column == np.unique(column)[:, np.newaxis]) if parameter.choices else column[np.newaxis]
        for parameter, column in zip(space.searched, columns, strict=True)
    ]
    points = np.concatenate(parts).T
    return regions(points * np.sqrt(points.shape[1] / len(columns)))  # distances are means over columns
