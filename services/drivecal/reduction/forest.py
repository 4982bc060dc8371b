"""The default predictors: forests of extremely randomised trees (Geurts, Ernst and Wehenkel 2006). The trees are scikit-learn's.

Its forests are not used: they check and convert the same data again for every tree, which takes several times as long as the trees do,
holds the interpreter's lock meanwhile, and delays the next batch of a campaign while all workers wait.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
import sklearn
from sklearn.tree import ExtraTreeRegressor

from drivecal.domain.parameters import Indices
from drivecal.domain.rounding import grain
from drivecal.domain.scales import Scale
from drivecal.reduction.prediction import Bools, Floats, Predictions, Predictor

SEED = 0
TREES = 50
MOST_CLASSES = 100
"""Largest number of scores of a scale that are classes."""
STEPS = 2.0**18
"""Whole numbers over the range of the scores that trees split by: their sums are exact, so that no unit or offset changes a split."""


class BaggedTrees:
    """Trees on bootstrap samples of scored parameter sets. They split by the variance of the scores."""

    def __init__(self, tolerance: float = 0.0) -> None:
        self._tolerance = tolerance
        self._alike = tolerance
        """Largest difference of agreeing scores: the tolerance, with room for rounding."""
        self._scores: Floats = np.empty(0)
        self._trees: list[ExtraTreeRegressor] = []
        self._drawn: Indices = np.empty((0, 0), dtype=np.int64)
        """Number of times that each tree's bootstrap sample holds each known answer, shape (n_trees, n_known)."""
        self._leaves: Indices = np.empty((0, 0), dtype=np.int64)
        """The leaf of each known answer in each tree, shape (n_trees, n_known)."""

    def _grow(self, features: Floats, scores: Floats) -> None:
        """Grows trees on features, shape (n, k), and scores, shape (n,)."""
        random = np.random.default_rng(SEED)
        points = np.ascontiguousarray(features, dtype=np.float32)
        self._alike = self._tolerance + grain(*scores[[scores.argmin(), scores.argmax()]].tolist(), span=float(np.ptp(scores)))
        steps = np.rint((scores - scores.min()) / (float(np.ptp(scores)) or 1.0) * STEPS)
        self._scores, self._trees, drawn, leaves = scores, [], [], []
        with sklearn.config_context(skip_parameter_validation=True):
            for _ in range(TREES):
                drawn.append(np.bincount(random.integers(len(points), size=len(points)), minlength=len(points)))
                tree = ExtraTreeRegressor(random_state=int(random.integers(2**31)))
                tree.fit(points, steps[:, None], sample_weight=drawn[-1].astype(np.float64), check_input=False)
                leaves.append(tree.tree_.apply(points))
                self._trees.append(tree)
        self._drawn, self._leaves = np.stack(drawn), np.stack(leaves)

    def _leaves_of(self, features: Floats) -> Indices:
        """Returns the leaf of each set in each tree, shape (n_trees, n)."""
        points = np.ascontiguousarray(features, dtype=np.float32)
        return np.stack([tree.tree_.apply(points) for tree in self._trees])

    def _votes(self, leaves: Indices) -> Floats:
        """Returns the score that each tree gives to sets in these leaves, shape (n_trees, n)."""
        votes = []
        for known, drawn, asked in zip(self._leaves, self._drawn, leaves, strict=True):
            sums, counts = np.bincount(known, drawn * (self._scores - self._scores[0])), np.bincount(known, drawn)
            votes.append(self._scores[0] + sums[asked] / counts[asked])
        return np.stack(votes)


class Forest(BaggedTrees):
    """Votes of trees for discrete scores. The confidence of a score is the share of votes for scores within `tolerance` of it; the
    predicted score has the largest confidence, then the most votes, then is the lowest. The predicted rating is the mean rating of the
    known cells with that score in the leaves of the set."""

    def __init__(self, tolerance: float = 0.0) -> None:
        super().__init__(tolerance)
        self._classes: Floats = np.empty(0)
        self._labels: Indices = np.empty(0, dtype=np.int64)
        self._ratings: Floats = np.empty(0)

    def fit(self, features: Floats, scores: Floats, ratings: Floats) -> None:
        """Learns from at least one score."""
        self._classes, self._labels = np.unique(scores, return_inverse=True)
        self._ratings = ratings
        self._grow(features, scores)

    def predict(self, features: Floats) -> Predictions:
        """Predicts n sets, after `fit`."""
        leaves = self._leaves_of(features)
        votes = self._shares(leaves)
        chosen, confidence = self._choose(votes)
        above = self._classes - (least := self._classes[0])  # squares of large scores would lose their differences
        mean = votes @ above
        variance = np.maximum(votes @ above**2 - mean**2, 0.0)
        return Predictions(self._classes[chosen], self._leaf_ratings(leaves, chosen), confidence, mean + least, variance)

    def known_errors(self) -> tuple[Floats, Bools]:
        """Returns confidences and errors of the training data by the trees that did not see them, each of shape (n,)."""
        unseen = self._drawn == 0
        known = unseen.any(axis=0)
        chosen, confidence = self._choose(self._shares(self._leaves[:, known], unseen[:, known]))
        return confidence, np.abs(self._classes[chosen] - self._scores[known]) > self._alike

    def _shares(self, leaves: Indices, asked: Bools | None = None) -> Floats:
        """Returns the share of votes for each class of n sets in these leaves, shape (n, n_classes). `asked`: which tree has a vote."""
        between = (self._classes[1:] + self._classes[:-1]) / 2
        votes = np.arange(leaves.shape[1]) * len(self._classes) + np.searchsorted(between, self._votes(leaves))
        counts = np.bincount((votes if asked is None else votes[asked]).ravel(), minlength=leaves.shape[1] * len(self._classes))
        shares: Floats = counts.reshape(-1, len(self._classes)) / (TREES if asked is None else asked.sum(axis=0)[:, None])
        return shares

    def _choose(self, votes: Floats) -> tuple[Indices, Floats]:
        near = np.abs(self._classes[:, None] - self._classes[None, :]) <= self._alike
        confidence = votes @ near
        best = np.argmax(confidence + 1e-6 * votes, axis=1)
        return best, confidence[np.arange(len(best)), best]

    def _leaf_ratings(self, leaves: Indices, chosen: Indices) -> Floats:
        """Mean rating, over all trees, of the known cells with the chosen score in the leaf of each set; else over all of that score."""
        kinds, labels = len(self._classes), self._labels
        totals, counts = np.zeros(len(chosen)), np.zeros(len(chosen))
        for tree, known, asked in zip(self._trees, self._leaves, leaves, strict=True):
            place, wanted, size = known * kinds + labels, asked * kinds + chosen, tree.tree_.node_count * kinds
            totals += np.bincount(place, self._ratings, size)[wanted]
            counts += np.bincount(place, minlength=size)[wanted]
        overall = np.bincount(labels, self._ratings, kinds) / np.bincount(labels, minlength=kinds)
        ratings: Floats = np.where(counts > 0, totals / np.maximum(counts, 1), overall[chosen])
        return ratings


class RegressionForest(BaggedTrees):
    """Votes of trees for continuous scores. The predicted score is the median vote, which a few trees beyond a cliff (failed runs) do not
    move; the confidence is the share of votes within `tolerance` of it. Continuous scores are their own ratings."""

    def fit(self, features: Floats, scores: Floats, ratings: Floats) -> None:
        """Learns from at least one score."""
        del ratings
        self._grow(features, scores)

    def predict(self, features: Floats) -> Predictions:
        """Predicts n sets, after `fit`."""
        votes = self._votes(self._leaves_of(features))
        scores, confidence = self._choose(votes)
        return Predictions(scores, scores.copy(), confidence, votes.mean(axis=0), votes.var(axis=0))

    def known_errors(self) -> tuple[Floats, Bools]:
        """Returns confidences and errors of the training data by the trees that did not see them, each of shape (n,)."""
        votes = np.where(self._drawn == 0, self._votes(self._leaves), np.nan)
        left_out = ~np.isnan(votes).all(axis=0)
        scores, confidence = self._choose(votes[:, left_out])
        return confidence, np.abs(scores - self._scores[left_out]) > self._alike

    def _choose(self, votes: Floats) -> tuple[Floats, Floats]:
        """Predicted scores and confidences for votes of shape (n_trees, n), NaN for trees without a vote."""
        scores: Floats = np.nanmedian(votes, axis=0)
        agreeing = np.abs(votes - scores) <= self._alike  # a comparison with NaN is false
        return scores, agreeing.sum(axis=0) / (~np.isnan(votes)).sum(axis=0)


def predictor_on(scale: Scale, tolerance: float) -> Callable[[], Predictor]:
    """Returns what creates the default predictor of a scale's scores: classes for few steps, else regression."""
    few = scale.step is not None and scale.span / scale.step <= MOST_CLASSES
    return partial(Forest if few else RegressionForest, tolerance)
