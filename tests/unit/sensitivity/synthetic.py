"""Scenarios with known influential boxes, for tests of the whole analysis."""

from collections.abc import Callable, Mapping
from decimal import Decimal

import numpy as np

from drivecal.domain.influence import Influence
from drivecal.domain.parameters import Indices, Parameter, ParameterSpace
from drivecal.sensitivity.analysis import SensitivityAnalysis
from drivecal.sensitivity.designs import Floats

Score = Callable[[Indices], Floats]
Box = Mapping[int, tuple[float, float]]
"""Columns that matter, each from and to a share of its range."""


def space_of(*n_values: int) -> ParameterSpace:
    """P1, P2, ... from 0 with step 0.1."""
    tenth = Decimal("0.1")
    parameters = (
        Parameter.from_step(f"P{number}", Decimal(0), (n - 1) * tenth, tenth) for number, n in enumerate(n_values, start=1)
    )
    return ParameterSpace(tuple(parameters))


def staircase(space: ParameterSpace, box: Box, steps: int = 8) -> Score:
    """Returns scores 1..7 that go up and down in `steps` while a parameter of `box` crosses its interval, and do not change outside.

    All parameters add up before the fold: the others shift the places where a parameter changes the score, and never prevent it.
    """

    def score(points: Indices) -> Floats:
        unit = points / (space.n_values - 1)
        climbed = np.zeros(len(points))
        for column, (lower, upper) in box.items():
            climbed += steps * np.clip((unit[:, column] - lower) / (upper - lower), 0, 1)
        fold = np.mod(climbed, 12)
        return np.asarray(1 + np.floor(np.where(fold < 6, fold, 12 - fold)))

    return score


def influence_map(analysis: SensitivityAnalysis) -> dict[str, dict[str, Influence]]:
    return {key: {name: each.influence for name, each in found.parameters.items()} for key, found in analysis.result().items()}


def drive(analysis: SensitivityAnalysis, scores: Mapping[str, Score]) -> list[tuple[str, dict[str, int]]]:
    """Runs an analysis to its end; gives the names of its phases and their numbers of runs by scenario."""
    told: list[tuple[str, dict[str, int]]] = []
    while (phase := analysis.ask()) is not None:
        analysis.tell({scenario: scores[scenario](points) for scenario, points in phase.points.items()})
        told.append((phase.name, {scenario: len(points) for scenario, points in phase.points.items()}))
    return told
