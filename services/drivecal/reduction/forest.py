"""The default predictor: a forest of extremely randomised trees (Geurts, Ernst and Wehenkel 2006), by scikit-learn."""

from typing import Any

import numpy as np
import numpy.typing as npt
from sklearn.ensemble import ExtraTreesClassifier

from drivecal.reduction.prediction import Bools, Floats, Predictions

TREES = 50
FEATURES = None
"""Features that each split considers: all of them, because few parameters matter in a scenario."""


class BaggedTrees:
    """Trees on bootstrap samples of scored parameter sets."""

    def __init__(self, tolerance: float, seed: int) -> None:
        self._tolerance, self._seed = tolerance, seed
        self._forest: Any = None
        self._scores: Floats = np.empty(0)
        self._features: Floats = np.empty((0, 0))

    def weights(self, features: Floats) -> Floats:
        """Returns the weight of each training cell in the prediction of one set, shape (n_known,), sum 1: its mean share of the
        bootstrap sample in the set's leaf, over the trees."""
        forest = self._fitted()
        shared = forest.apply(self._features) == forest.apply(features.reshape(1, -1))
        drawn = np.stack([np.bincount(sample, minlength=len(shared)) for sample in forest.estimators_samples_], axis=1)
        weights: Floats = shared * drawn
        return np.asarray((weights / weights.sum(axis=0)).mean(axis=1), dtype=np.float64)

    def _fitted(self) -> Any:
        if self._forest is None:
            raise RuntimeError("the forest has not learned yet")
        return self._forest


class Forest(BaggedTrees):
    """Votes of trees for discrete scores. The confidence of a score is the share of votes for scores within `tolerance` of it; the
    predicted score has the largest confidence, then the most votes, then is the lowest. The predicted rating is the mean rating of the
    known cells with that score in the leaves of the set."""

    def __init__(self, tolerance: float = 0.0, seed: int = 0) -> None:
        super().__init__(tolerance, seed)
        self._classes: Floats = np.empty(0)
        self._ratings: Floats = np.empty(0)

    def fit(self, features: Floats, scores: Floats, ratings: Floats) -> None:
        """Learns from at least one score. Trees are trained on bootstrap samples, so that `known_errors` costs no further fit."""
        self._classes, labels = np.unique(scores, return_inverse=True)
        self._features, self._scores, self._ratings = features, scores, ratings
        self._forest = ExtraTreesClassifier(
            TREES, max_features=FEATURES, bootstrap=True, oob_score=True, random_state=self._seed, n_jobs=1
        )
        self._forest.fit(features, labels)

    def predict(self, features: Floats) -> Predictions:
        """Predicts n sets. Raises RuntimeError before `fit`."""
        forest = self._fitted()
        votes = np.asarray(forest.predict_proba(features), dtype=np.float64)
        chosen, confidence = self._choose(votes)
        mean = votes @ self._classes
        variance = np.maximum(votes @ self._classes**2 - mean**2, 0.0)
        return Predictions(self._classes[chosen], self._leaf_ratings(forest, features, chosen), confidence, mean, variance)

    def known_errors(self) -> tuple[Floats, Bools]:
        """Returns confidences and errors of the training data by the trees that did not see them, each of shape (n,)."""
        votes: Floats = np.asarray(self._fitted().oob_decision_function_, dtype=np.float64).reshape(len(self._scores), -1)
        seen = ~np.isnan(votes).any(axis=1)
        chosen, confidence = self._choose(votes[seen])
        return confidence, np.abs(self._classes[chosen] - self._scores[seen]) > self._tolerance + 1e-9

    def _choose(self, votes: Floats) -> tuple[npt.NDArray[np.int64], Floats]:
        near = np.abs(self._classes[:, None] - self._classes[None, :]) <= self._tolerance + 1e-9
        confidence = votes @ near
        best = np.argmax(confidence + 1e-6 * votes, axis=1)
        return best, confidence[np.arange(len(best)), best]

    def _leaf_ratings(self, forest: ExtraTreesClassifier, features: Floats, chosen: npt.NDArray[np.int64]) -> Floats:
        """Mean rating, over all trees, of the known cells with the chosen score in the leaf of each set; else over all of that score."""
        kinds, labels = len(self._classes), np.searchsorted(self._classes, self._scores)
        totals, counts = np.zeros(len(features)), np.zeros(len(features))
        for known, asked in zip(forest.apply(self._features).T, forest.apply(features).T, strict=True):
            place, wanted = known * kinds + labels, asked * kinds + chosen
            size = int(max(place.max(), wanted.max())) + 1
            totals += np.bincount(place, self._ratings, size)[wanted]
            counts += np.bincount(place, minlength=size)[wanted]
        overall = np.bincount(labels, self._ratings, kinds) / np.bincount(labels, minlength=kinds)
        ratings: Floats = np.where(counts > 0, totals / np.maximum(counts, 1), overall[chosen])
        return ratings
