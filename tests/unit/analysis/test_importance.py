"""Permutation importance of parameters."""

import numpy as np
import pytest
from tests.support.values import present

from drivecal.analysis import importance
from drivecal.analysis.importance import LEAST_SETS, importances


def test_parameters_are_ordered_by_what_they_explain_and_others_explain_nothing() -> None:
    features = np.random.default_rng(1).uniform(size=(400, 4))
    values = 4 * features[:, 2] + features[:, 0] ** 2
    result = present(importances(features, values))
    assert list(np.argsort(-result.mean)[:2]) == [2, 0]
    assert result.r2 > 0.9
    assert np.abs(result.mean[[1, 3]]).max() < 0.02 < result.mean[0]
    assert (result.sets, result.held_out) == (400, 133)


def test_too_few_sets_and_equal_values_have_no_importance() -> None:
    features = np.random.default_rng(3).uniform(size=(LEAST_SETS, 2))
    assert importances(features[1:], features[1:, 0]) is None
    assert importances(features, np.ones(LEAST_SETS)) is None


def test_of_many_sets_an_even_sample_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importance, "MOST_SETS", 90)
    features = np.linspace(0, 1, 400)[:, np.newaxis]
    result = present(importances(features, features[:, 0]))
    assert (result.sets, result.held_out) == (90, 30)
