"""Permutation importance of parameters."""

import numpy as np
import pytest
from tests.support.values import present

from drivecal.analysis import importance
from drivecal.analysis.importance import LEAST_SETS, Importances, importances, mean_of


def test_parameters_are_ordered_by_what_they_explain_and_others_explain_nothing() -> None:
    features = np.random.default_rng(1).uniform(size=(400, 4))
    values = 4 * features[:, 2] + features[:, 0] ** 2
    result = present(importances(features, values))
    assert list(np.argsort(-result.mean)[:2]) == [2, 0]
    assert result.r2 > 0.9
    assert result.mean[2] == pytest.approx(0.94, abs=0.1), "the share of 4 x in the variance"
    assert np.abs(result.mean[[1, 3]]).max() < 0.02 < result.mean[0]
    assert (result.sets, result.held_out) == (400, 133)
    assert result.spread == pytest.approx(0.8, abs=0.05), "they are drawn evenly"


def test_too_few_sets_and_equal_values_have_no_importance() -> None:
    features = np.random.default_rng(3).uniform(size=(LEAST_SETS, 2))
    assert importances(features[1:], features[1:, 0]) is None
    assert importances(features, np.ones(LEAST_SETS)) is None


def test_an_interval_leaves_out_samples_in_which_no_value_differs() -> None:
    features = np.random.default_rng(4).uniform(size=(60, 2))
    values = np.zeros(60)
    values[:6] = 1.0
    result = present(importances(features, values))
    assert result.lower.min() > -10
    assert result.upper.max() <= 1


def test_a_mean_of_importances_takes_their_errors_for_alike() -> None:
    mean, lower, upper = np.array([[[0.5, 0.1], [0.1, 0.9]], [[0.2, 0.1], [0.1, 0.5]], [[0.9, 0.1], [0.1, 1.2]]])
    first = Importances(mean[0], lower[0], upper[0], r2=0.9, sets=90, held_out=30, spread=np.array([0.8, 0.2]))
    second = Importances(mean[1], lower[1], upper[1], r2=0.5, sets=60, held_out=20, spread=np.array([0.4, 0.2]))
    result = mean_of([(3.0, first), (1.0, second)])
    assert result.mean == pytest.approx([0.4, 0.3])
    assert result.spread == pytest.approx([0.7, 0.2])
    assert result.lower == pytest.approx([0.175, 0.2])
    assert result.upper == pytest.approx([0.7, 0.375])
    assert result.r2 == pytest.approx(0.8)
    assert (result.sets, result.held_out) == (90, 30)


def test_of_many_sets_an_even_sample_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importance, "MOST_SETS", 90)
    features = np.linspace(0, 1, 400)[:, np.newaxis]
    result = present(importances(features, features[:, 0]))
    assert (result.sets, result.held_out) == (90, 30)


def test_an_effect_that_the_forest_does_not_see_is_not_excluded() -> None:
    generator = np.random.default_rng(5)
    features = generator.uniform(size=(150, 8))
    result = present(importances(features, generator.normal(size=150)))
    assert result.r2 < 0.3
    assert result.upper.min() > 0.08
