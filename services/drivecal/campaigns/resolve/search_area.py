"""The part of its space that a campaign searches. It depends only on specification and influence map, so a campaign can resume."""

from __future__ import annotations

import numpy as np

from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.domain.influence import InfluenceMap
from drivecal.domain.parameters import Indices
from drivecal.reduction.narrowing import SearchArea, common_area, full_area


def search_area(problem: CalibrationProblem, influence_map: InfluenceMap | None) -> SearchArea:
    """The common area if `reduction.narrow` requests it, widened to hold the start sets; else the whole space."""
    if influence_map is None or not problem.specification.reduction.narrow:
        return full_area(problem.space)
    return common_area(problem.space, influence_map, problem.scenarios, given_indices(problem))


def given_indices(problem: CalibrationProblem) -> Indices:
    """Grid indices of the start sets, shape (n, n_searched)."""
    rows = [problem.space.indices(parameter_set.values) for parameter_set in problem.start_sets]
    return np.array(rows, dtype=np.int64).reshape(len(rows), len(problem.space.searched))
