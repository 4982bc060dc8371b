"""The forest behind predictions of scores without steps."""

from dataclasses import replace

import numpy as np
from tests.support.values import COST

from drivecal.domain.scales import COMFORT
from drivecal.reduction.forest import Forest, RegressionForest, predictor_on
from drivecal.reduction.prediction import Floats

SETS = np.random.default_rng(3).random((600, 4))
COSTS: Floats = 10.0 + 40.0 * np.abs(SETS[:, 0] - 0.4) + 20.0 * SETS[:, 1] ** 2


def test_the_scale_chooses_the_predictor() -> None:
    assert isinstance(predictor_on(COMFORT, 0.0)(), Forest)
    assert isinstance(predictor_on(COST, 2.0)(), RegressionForest)
    assert isinstance(predictor_on(replace(COST, step=0.01), 2.0)(), RegressionForest)


def test_it_is_right_more_often_than_the_mean_and_knows_when() -> None:
    forest = RegressionForest(COST.tolerance)
    forest.fit(SETS[:400], COSTS[:400], COSTS[:400])
    told = forest.predict(SETS[400:])
    wrong = np.abs(told.scores - COSTS[400:]) > COST.tolerance
    assert wrong.mean() < (np.abs(COSTS[:400].mean() - COSTS[400:]) > COST.tolerance).mean() / 2
    certain = told.confidence > np.median(told.confidence)
    assert wrong[certain].mean() < wrong[~certain].mean()
    assert told.ratings.tolist() == told.scores.tolist()


def test_failures_beyond_a_cliff_move_no_prediction_before_it() -> None:
    costs = np.where(SETS[:, 0] > 0.5, COST.failed, 20.0)
    forest = RegressionForest(COST.tolerance)
    forest.fit(SETS[:400], costs[:400], costs[:400])
    told = forest.predict(SETS[400:])
    assert set(told.scores.tolist()) <= {20.0, 60.0, COST.failed}
    assert (told.scores == costs[400:]).mean() > 0.97


def test_a_few_known_scores_are_enough() -> None:
    forest = RegressionForest()
    forest.fit(SETS[:1], np.array([3.25]), np.array([3.25]))
    told = forest.predict(SETS[5:9])
    assert (told.scores.tolist(), told.confidence.tolist()) == ([3.25] * 4, [1.0] * 4)
    assert [part.shape for part in forest.known_errors()] == [(0,), (0,)]
