"""The default predictor: a forest of extremely randomised trees (Geurts, Ernst and Wehenkel 2006), by scikit-learn."""

import numpy as np
import numpy.typing as npt
from sklearn.ensemble import ExtraTreesClassifier

from drivecal.reduction.prediction import Bools, Floats

TREES = 100


class Forest:
    """Votes of trees for discrete scores. The confidence of a score is the share of votes for scores within `tolerance` of it; the
    predicted score has the largest confidence, then the most votes, then is the lowest."""

    def __init__(self, tolerance: float = 0.0, seed: int = 0) -> None:
        self._tolerance = tolerance
        self._seed = seed
        self._classes: Floats = np.empty(0)
        self._forest: ExtraTreesClassifier | None = None
        self._scores: Floats = np.empty(0)

    def fit(self, features: Floats, scores: Floats) -> None:
        """Learns from at least one score. Trees are trained on bootstrap samples, so that `known_errors` costs no further fit."""
        self._classes, labels = np.unique(scores, return_inverse=True)
        self._scores = scores
        self._forest = ExtraTreesClassifier(TREES, bootstrap=True, oob_score=True, random_state=self._seed, n_jobs=1)
        self._forest.fit(features, labels)

    def predict(self, features: Floats) -> tuple[Floats, Floats]:
        """Returns predicted scores and confidences, each of shape (n,). Raises RuntimeError before `fit`."""
        if self._forest is None:
            raise RuntimeError("the forest has not learned yet")
        return self._chosen(np.asarray(self._forest.predict_proba(features), dtype=np.float64))

    def known_errors(self) -> tuple[Floats, Bools]:
        """Returns confidences and errors of the training data by the trees that did not see them, each of shape (n,)."""
        if self._forest is None:
            raise RuntimeError("the forest has not learned yet")
        votes: npt.NDArray[np.float64] = np.asarray(self._forest.oob_decision_function_, dtype=np.float64).reshape(
            len(self._scores), -1
        )
        seen = ~np.isnan(votes).any(axis=1)
        answers, confidence = self._chosen(votes[seen])
        return confidence, np.abs(answers - self._scores[seen]) > self._tolerance + 1e-9

    def _chosen(self, votes: Floats) -> tuple[Floats, Floats]:
        near = np.abs(self._classes[:, None] - self._classes[None, :]) <= self._tolerance + 1e-9
        confidence = votes @ near
        best = np.argmax(confidence + 1e-6 * votes, axis=1)
        return self._classes[best], confidence[np.arange(len(best)), best]
