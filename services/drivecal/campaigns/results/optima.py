"""The sets that share a campaign's best objective: their regions, and the distance to the next worse set."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile

import numpy as np
import numpy.typing as npt

from drivecal.analysis.optima import Optimum, regions, to_nearest
from drivecal.analysis.solutions import EvaluatedSet
from drivecal.domain.parameters import ParameterSpace
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
    """The sets that share the best objective, by rank, and the next worse sets, as points of the unit cube."""

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
    alike = (each.equals(ranking[0]) for each in ranking)
    equal = sum(1 for _ in takewhile(bool, alike))
    best, worse = ranking[: min(equal, MOST_BEST)], ranking[equal : equal + MOST_WORSE]
    sets = database.query(parameter_sets.load, [solution.parameter_set for solution in (*best, *worse)])
    places = FeatureSpace(space)([sets[solution.parameter_set] for solution in (*best, *worse)])
    return Alternatives(places[: len(best)], places[len(best) :], regions(places[: len(best)]))
