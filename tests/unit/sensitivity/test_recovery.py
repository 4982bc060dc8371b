"""Both designs find influential boxes that are known, within one interval."""

from typing import Literal

import numpy as np
import pytest
from tests.unit.sensitivity.synthetic import Box, drive, influence_map, space_of, staircase

from drivecal.contracts.specification import SensitivitySpecification
from drivecal.domain.influence import Influence
from drivecal.domain.parameters import ParameterSpace
from drivecal.sensitivity.analysis import SensitivityAnalysis
from drivecal.sensitivity.thresholds import Threshold

SPACE = space_of(59, 201, 201, 2001, 1501, 101, 201, 2001, 101, 201, 201)
"""Grids as in Table 6."""
INTERVALS = 10
BOXES: dict[str, Box] = {
    "S1": {0: (0.3, 0.8), 1: (0, 1), 4: (0, 0.45), 9: (0.55, 1)},
    "S2": {2: (0.4, 0.7), 3: (0.2, 1), 10: (0, 0.6)},
    "S3": {0: (0.65, 1), 5: (0.1, 0.35), 6: (0, 1), 7: (0, 0.2), 8: (0.5, 0.9)},
}
"""Influential intervals by scenario and parameter; all other parameters have no influence."""


def misses(found: dict[str, dict[str, Influence]], space: ParameterSpace) -> list[str]:
    """Pairs whose bounds are off by more than an interval (and the snapping of its edge), or that are wrongly found or left out."""
    missed = []
    for scenario, box in BOXES.items():
        for column, parameter in enumerate(space.searched):
            influence = found[scenario][parameter.name]
            last = parameter.n_values - 1
            reach = 1 / INTERVALS + 0.5 / last
            bounds = (
                0.0 if influence.lower is None else parameter.index(influence.lower) / last,
                1.0 if influence.upper is None else parameter.index(influence.upper) / last,
            )
            right = influence.influential == (column in box)
            if right and column in box:
                right = bool(np.abs(np.subtract(bounds, box[column])).max() <= reach)
            if not right:
                missed.append(f"{scenario} {parameter.name}: {influence}, not {box.get(column)}")
    return missed


@pytest.mark.faults("1", "2")
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("threshold", [0.02, "auto"])
@pytest.mark.parametrize("design", ["lines", "paper"])
def test_boxes_of_eleven_parameters_are_found(design: Literal["lines", "paper"], threshold: Threshold, seed: int) -> None:
    analysis = SensitivityAnalysis(
        SPACE,
        list(BOXES),
        SensitivitySpecification(design=design, intervals=INTERVALS, samples=20, threshold=threshold, seed=seed),
    )
    drive(analysis, {scenario: staircase(SPACE, box) for scenario, box in BOXES.items()})
    result = influence_map(analysis)
    assert misses({scenario: dict(listed) for scenario, listed in result.items()}, SPACE) == []
