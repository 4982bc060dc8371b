"""The default predictor of scores without steps: a forest of extremely randomised regression trees (Geurts, Ernst and Wehenkel 2006)."""

from collections.abc import Callable
from functools import partial

import numpy as np
from sklearn.ensemble import ExtraTreesRegressor

from drivecal.domain.scales import Scale
from drivecal.reduction.forest import FEATURES, TREES, BaggedTrees, Forest
from drivecal.reduction.prediction import ROUNDING, Bools, Floats, Predictions, Predictor

MOST_CLASSES = 100
"""Largest number of scores of a scale that are classes."""


def predictor_on(scale: Scale, tolerance: float) -> Callable[[], Predictor]:
    """Returns what creates the default predictor of a scale's scores: classes for few steps, else regression."""
    few = scale.step is not None and scale.span / scale.step <= MOST_CLASSES
    return partial(Forest if few else RegressionForest, tolerance)


class RegressionForest(BaggedTrees):
    """Votes of trees for continuous scores. The predicted score is the median vote, which a few trees beyond a cliff (failed runs) do not
    move; the confidence is the share of votes within `tolerance` of it. Continuous scores are their own ratings."""

    def __init__(self, tolerance: float = 0.0, seed: int = 0) -> None:
        super().__init__(tolerance + ROUNDING, seed)

    def fit(self, features: Floats, scores: Floats, ratings: Floats) -> None:
        """Learns from at least one score. Trees are trained on bootstrap samples, so that `known_errors` costs no further fit."""
        del ratings
        self._features, self._scores = features, scores
        self._forest = ExtraTreesRegressor(TREES, max_features=FEATURES, bootstrap=True, random_state=self._seed, n_jobs=1)
        self._forest.fit(features, scores)

    def predict(self, features: Floats) -> Predictions:
        """Predicts n sets. Raises RuntimeError before `fit`."""
        votes = _votes(self._fitted(), features)
        scores, confidence = self._choose(votes)
        return Predictions(scores, scores.copy(), confidence, votes.mean(axis=1), votes.var(axis=1))

    def known_errors(self) -> tuple[Floats, Bools]:
        """Returns confidences and errors of the training data by the trees that did not see them, each of shape (n,)."""
        forest = self._fitted()
        votes = _votes(forest, self._features)
        for column, sample in enumerate(forest.estimators_samples_):
            votes[sample, column] = np.nan
        left_out = ~np.isnan(votes).all(axis=1)
        scores, confidence = self._choose(votes[left_out])
        return confidence, np.abs(scores - self._scores[left_out]) > self._tolerance

    def _choose(self, votes: Floats) -> tuple[Floats, Floats]:
        """Predicted scores and confidences for votes of shape (n, n_trees), NaN for trees without a vote."""
        scores: Floats = np.nanmedian(votes, axis=1)
        agreeing = np.abs(votes - scores[:, None]) <= self._tolerance  # a comparison with NaN is false
        return scores, agreeing.sum(axis=1) / (~np.isnan(votes)).sum(axis=1)


def _votes(forest: ExtraTreesRegressor, features: Floats) -> Floats:
    """Predictions of every tree, shape (n, n_trees)."""
    return np.stack([np.asarray(tree.predict(features), dtype=np.float64) for tree in forest.estimators_], axis=1)
