"""The default predictor of scores without steps: a forest of extremely randomised regression trees (Geurts, Ernst and Wehenkel 2006)."""

from collections.abc import Callable
from functools import partial

import numpy as np

from drivecal.domain.scales import Scale
from drivecal.reduction.forest import BaggedTrees, Forest
from drivecal.reduction.prediction import Bools, Floats, Predictions, Predictor

MOST_CLASSES = 100
"""Largest number of scores of a scale that are classes."""


def predictor_on(scale: Scale, tolerance: float) -> Callable[[], Predictor]:
    """Returns what creates the default predictor of a scale's scores: classes for few steps, else regression."""
    few = scale.step is not None and scale.span / scale.step <= MOST_CLASSES
    return partial(Forest if few else RegressionForest, tolerance)


class RegressionForest(BaggedTrees):
    """Votes of trees for continuous scores. The predicted score is the median vote, which a few trees beyond a cliff (failed runs) do not
    move; the confidence is the share of votes within `tolerance` of it. Continuous scores are their own ratings."""

    def fit(self, features: Floats, scores: Floats, ratings: Floats) -> None:
        """Learns from at least one score."""
        del ratings
        self._grow(features, scores)

    def predict(self, features: Floats) -> Predictions:
        """Predicts n sets. Raises RuntimeError before `fit`."""
        votes = self._votes(self._leaves_of(features))
        scores, confidence = self._choose(votes)
        return Predictions(scores, scores.copy(), confidence, votes.mean(axis=0), votes.var(axis=0))

    def known_errors(self) -> tuple[Floats, Bools]:
        """Returns confidences and errors of the training data by the trees that did not see them, each of shape (n,)."""
        votes = np.where(self._drawn == 0, self._votes(self._leaves), np.nan)
        left_out = ~np.isnan(votes).all(axis=0)
        scores, confidence = self._choose(votes[:, left_out])
        return confidence, np.abs(scores - self._scores[left_out]) > self._agreeing

    def _choose(self, votes: Floats) -> tuple[Floats, Floats]:
        """Predicted scores and confidences for votes of shape (n_trees, n), NaN for trees without a vote."""
        scores: Floats = np.nanmedian(votes, axis=0)
        agreeing = np.abs(votes - scores) <= self._agreeing  # a comparison with NaN is false
        return scores, agreeing.sum(axis=0) / (~np.isnan(votes)).sum(axis=0)
