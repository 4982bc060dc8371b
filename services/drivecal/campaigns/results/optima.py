"""The sets that share a campaign's best objective: their regions, and the distance to the next worse set."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile

import numpy as np
import numpy.typing as npt

from drivecal.analysis.optima import Optimum, regions, to_nearest
from drivecal.analysis.solutions import EvaluatedSet
from drivecal.domain.parameters import ParameterSet, ParameterSpace
from drivecal.plugins.ports import Floats
from drivecal.reduction.prediction import FeatureSpace
from drivecal.storage.engine.database import Database
from drivecal.storage.references import parameter_sets

MOST_BEST = 10_000
"""Largest number of best sets to compare, best rated first: the work grows with its square."""
MOST_WORSE = 20_000
"""Sets of a worse objective to search for the nearest."""


@dataclass(frozen=True, slots=True)
class Alternatives:
    """The sets that share the best objective, by rank, and the next worse sets, as points: see `beside`."""

    best: Floats
    worse: Floats
    regions: npt.NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.best)

    def shown(self, start: int, stop: int) -> list[Optimum]:
        """The optima of a slice. Distances take most of the time and are computed for the slice alone."""
        away = to_nearest(self.best[start:stop], self.worse)
        return [Optimum(int(region), distance) for region, distance in zip(self.regions[start:stop], away, strict=True)]


def alternatives(database: Database, ranking: Sequence[EvaluatedSet], space: ParameterSpace) -> Alternatives:
    """The first sets of a `ranking`, best first, that share the best objective: at most MOST_BEST."""
    alike = (each.choice.equals(ranking[0].choice) for each in ranking)
    equal = sum(1 for _ in takewhile(bool, alike))
    best, worse = ranking[: min(equal, MOST_BEST)], ranking[equal : equal + MOST_WORSE]
    sets = database.query(parameter_sets.load, [solution.parameter_set for solution in (*best, *worse)])
    return beside(space, *([sets[solution.parameter_set] for solution in some] for some in (best, worse)))


def beside(space: ParameterSpace, best: Sequence[ParameterSet], worse: Sequence[ParameterSet]) -> Alternatives:
    """Returns sets as points: root mean squares of differences are shares of the ranges, and another choice is a whole range away."""
    columns = FeatureSpace(space)([*best, *worse]).T
    parts = [
        np.sqrt(0.5) * (column == np.unique(column)[:, np.newaxis]) if parameter.choices else column[np.newaxis]
        for parameter, column in zip(space.searched, columns, strict=True)
    ]
    points = np.concatenate(parts).T
    points *= np.sqrt(points.shape[1] / len(columns))  # distances are means over columns
    return Alternatives(points[: len(best)], points[len(best) :], regions(points[: len(best)]))
