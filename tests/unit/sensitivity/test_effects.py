"""Measures from effects: units, symmetries, and runs that failed."""

from dataclasses import replace
from math import isnan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.values import COST
from tests.unit.sensitivity.synthetic import Score, drive, space_of

from drivecal.contracts.specification import SensitivitySpecification
from drivecal.domain.parameters import Indices
from drivecal.domain.scales import Scale
from drivecal.sensitivity.analysis import SensitivityAnalysis
from drivecal.sensitivity.designs import COLUMNS, Design, Floats, SobolRows, radial_design
from drivecal.sensitivity.scenario import ScenarioInfluence, tells_nothing
from drivecal.sensitivity.thresholds import automatic, measures, smallest_nonzero

effect_lists = st.lists(st.floats(-100, 100), min_size=2, max_size=30).map(np.array)


@given(effect_lists, st.integers(1, 5))
def test_a_failed_run_costs_its_effect_and_nothing_else(effects: Floats, failed: int) -> None:
    with_failures = np.concatenate([np.full(failed, np.nan), effects])
    assert measures(with_failures) == measures(effects)


def test_fewer_than_two_effects_say_nothing() -> None:
    for effects in (np.array([]), np.array([1.0]), np.array([np.nan, 1.0, np.nan])):
        result = measures(effects)
        assert isnan(result.mu)
        assert isnan(result.sigma)
        assert isnan(result.s_rel)
        assert result.n_effects == int((~np.isnan(effects)).sum())


def test_effects_are_changes_over_the_whole_scale_per_full_range() -> None:
    design = Design(np.array([[0], [5], [10]]), np.array([0, 1]), np.array([1, 2]), *[np.array([0.5, 0.5])] * 2)
    assert design.effects(np.array([0.0, 7.0, 3.5])).tolist() == [2.0, -1.0]


def test_a_failed_base_point_costs_one_effect_of_each_parameter_a_failed_step_only_its_own() -> None:
    n_values = np.array([11, 11, 11])
    design = radial_design(n_values, SobolRows(3 * COLUMNS, 1), np.zeros_like(n_values), n_values - 1, samples=4)
    scores = np.ones(len(design.points))
    scores[design.first[0, 2]] = np.nan
    scores[design.second[1, 0]] = np.nan
    assert np.isnan(design.effects(scores)).tolist() == [
        [False, False, True, False],
        [True, False, True, False],
        [False, False, True, False],
    ]


def test_the_smallest_sensitivity_that_is_not_zero_is_found() -> None:
    result = [measures(np.array(effects)) for effects in ([0.0, 0.0], [1.0, 0.0], [0.1, 0.1], [np.nan])]
    assert smallest_nonzero(result) == pytest.approx(0.1)
    assert smallest_nonzero(result[:1]) is None


SPACE = space_of(101, 101, 101)


def analysed(score: Score, scale: Scale) -> ScenarioInfluence:
    settings = SensitivitySpecification(design="lines", intervals=10, samples=20, threshold="auto", seed=3)
    analysis = SensitivityAnalysis(SPACE, ["S1"], settings, scale)
    drive(analysis, {"S1": score})
    return analysis.result()["S1"]


def test_scores_far_beyond_the_comfort_scale_are_analysed() -> None:
    def cost(points: Indices) -> Floats:
        unit = points / (SPACE.n_values - 1)
        return np.asarray(60.0 * np.abs(unit[:, 0] - 0.3) + 0.01 * np.sin(9 * unit[:, 1]))

    auto = analysed(cost, COST)
    assert auto.parameters["P1"].influence.influential
    assert not auto.parameters["P2"].influence.influential, "a hundredth is far below the tolerance of 2"
    assert not auto.parameters["P3"].influence.influential
    exact = analysed(cost, replace(COST, tolerance=0.0))
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
