"""Which part of its space a campaign searches: a function of its specification and its influence map alone, so that it can be resumed."""

from __future__ import annotations

import numpy as np

from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.domain.influence import InfluenceMap
from drivecal.domain.parameters import Indices
from drivecal.reduction.narrowing import SearchArea, common_area, full_area


def search_area(problem: CalibrationProblem, influence_map: InfluenceMap | None) -> SearchArea:
    """The common area where `reduction.narrow` asks for it, widened to hold the start sets; else the whole space."""
    if influence_map is None or not problem.specification.reduction.narrow:
        return full_area(problem.space)
    return common_area(problem.space, influence_map, problem.scenarios, given_indices(problem))


def given_indices(problem: CalibrationProblem) -> Indices:
    """Grid indices of the start sets, shape (n, n_searched)."""
    rows = [problem.space.indices(parameter_set.values) for parameter_set in problem.start_sets]
    return np.array(rows, dtype=np.int64).reshape(len(rows), len(problem.space.searched))
