"""Analyses of scores on other scales than comfort."""

from dataclasses import replace

import numpy as np
import pytest
from tests.support.scales import COST
from tests.unit.sensitivity.synthetic import Score, drive, space_of

from drivecal.contracts.specification import SensitivitySpecification
from drivecal.domain.parameters import Indices
from drivecal.domain.scales import Scale
from drivecal.sensitivity.analysis import SensitivityAnalysis
from drivecal.sensitivity.designs import Floats
from drivecal.sensitivity.scenario import ScenarioInfluence, tells_nothing
from drivecal.sensitivity.thresholds import Threshold, automatic

SPACE = space_of(101, 101, 101)


def settings(threshold: Threshold, *, sequential: bool = True) -> SensitivitySpecification:
    return SensitivitySpecification(
        design="lines", intervals=10, samples=20, threshold=threshold, seed=3, sequential=sequential
    )


def analysed(score: Score, threshold: Threshold, scale: Scale, *, sequential: bool = True) -> ScenarioInfluence:
    analysis = SensitivityAnalysis(SPACE, ["S1"], settings(threshold, sequential=sequential), scale)
    drive(analysis, {"S1": score})
    return analysis.result()["S1"]


def test_scores_far_beyond_the_comfort_scale_are_analysed() -> None:
    def cost(points: Indices) -> Floats:
        unit = points / (SPACE.n_values - 1)
        return np.asarray(60.0 * np.abs(unit[:, 0] - 0.3) + 0.01 * np.sin(9 * unit[:, 1]))

    auto = analysed(cost, "auto", COST)
    assert auto.parameters["P1"].influence.influential
    assert not auto.parameters["P2"].influence.influential, "a hundredth is far below the tolerance of 2"
    assert not auto.parameters["P3"].influence.influential
    exact = analysed(cost, "auto", replace(COST, tolerance=0.0))
    assert exact.parameters["P2"].influence.influential, "without a tolerance any change is influence"
    assert not exact.parameters["P3"].influence.influential


def test_only_failures_tell_nothing() -> None:
    assert tells_nothing(np.array([0.0, np.nan]))
    assert not tells_nothing(np.array([0.0, 100.0]))
    assert tells_nothing(np.array([100.0, np.nan]), COST)
    assert not tells_nothing(np.array([0.0, 100.0]), COST)


def test_auto_tolerates_changes_in_units_of_the_tolerance() -> None:
    steps = np.full(20, 0.1)
    assert automatic(steps, COST) == pytest.approx(automatic(steps) * (2 / 100) / (1 / 7))
