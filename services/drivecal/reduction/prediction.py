"""Predicted answers: a predictor's port, the calibration of its confidence, and the choice of a lot. Pure.

A prediction needs no guarantee of its own: `reduction.lots` bounds the released errors of every predictor. A better calibration only saves
more, because fewer lots are rejected and fewer right predictions are left out.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from drivecal.domain.parameters import Indices, ParameterSet, ParameterSpace
from drivecal.domain.rounding import grains
from drivecal.domain.values import billionths
from drivecal.reduction.lots import SamplingPlan, best_plan

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

RECENT = 6
"""Batches that a calibration remembers."""
LEFT_OUT = 0.5
"""Weight of a left-out error of the training data; a prediction's own error has the weight 1."""
FINENESS = 32
"""Lot sizes between a number and its double: so few that most plans are known from earlier lots, because finding one takes a while."""
LEVELS = 40
"""Levels of confidence in a calibration, of equal weight."""
REFIT = 1.1
"""Growth of the known answers after which a predictor is trained again: training takes most of its time."""
FEWEST_KNOWN, MOST_KNOWN = 100, 10_000
"""Known answers before the first prediction, and the newest answers that a predictor is trained on."""
DOUBT = 2.0
"""Weight of the prior in each level, as a number of observations of the record's mean error."""


ROOM = 1.25
"""Largest mean expected error of a lot, as a multiple of the limit. The plan keeps the limit whatever the errors are; much worse lots would
pass at times, but most would be simulated."""


@dataclass(frozen=True, slots=True)
class Predictions:
    """Predicted scores, continuous ratings and raw confidences in 0..1, and mean and variance of believed scores; all of shape (n,)."""

    scores: Floats
    ratings: Floats
    confidence: Floats
    mean: Floats
    variance: Floats


class Predictor(Protocol):
    """Predicts scores from features in 0..1, shape (n, k). Deterministic: the same bits for the same data in every process."""

    def fit(self, features: Floats, scores: Floats, ratings: Floats) -> None:
        """Learns from simulated scores and ratings, each of shape (n,), in a canonical order."""

    def predict(self, features: Floats) -> Predictions:
        """Predicts n sets."""

    def known_errors(self) -> tuple[Floats, Bools]:
        """Returns raw confidences and whether the prediction was wrong, of training data left out of the fit, each of shape (n,)."""


class FeatureSpace:
    """Positions of parameter sets in the searched ranges; fixed parameters keep their values. A choice is its position in the list."""

    def __init__(self, space: ParameterSpace, names: Sequence[str] | None = None) -> None:
        """`names`: the columns, by default the searched parameters."""
        self._names = tuple(names or (each.name for each in space.searched))
        lowest = {parameter.name: billionths(parameter.lower) for parameter in space.searched}
        spans = {parameter.name: billionths(parameter.upper) - lowest[parameter.name] for parameter in space.searched}
        # A fixed choice is the same in every set, and a constant feature decides nothing.
        self._choices = {parameter.name: parameter for parameter in space.parameters if parameter.choices}
        self._lowest = np.array([lowest.get(name, 0) for name in self._names], dtype=np.float64)
        self._spans = np.array([spans.get(name, 10**9) for name in self._names], dtype=np.float64)

    def __call__(self, sets: Sequence[ParameterSet]) -> Floats:
        """Returns features of n sets, shape (n, n_p)."""
        rows = [
            each.billionths
            if each.names == self._names
            else [dict(zip(each.names, each.billionths, strict=True))[name] for name in self._names]
            for each in sets
        ]
        numbers = rows if not self._choices else [list(map(self._number, self._names, row)) for row in rows]
        values = np.array(numbers, dtype=np.float64).reshape(len(rows), len(self._names))
        features: Floats = (values - self._lowest) / self._spans
        return features

    def holds(self, parameters: ParameterSet) -> bool:
        """Returns whether a set has these parameters, with values of their kinds: the problem may have changed since its simulation."""
        if set(parameters.names) != set(self._names):
            return False
        values = zip(parameters.names, parameters.billionths, strict=True)
        return all(
            value in self._choices[name].choices if name in self._choices else not isinstance(value, str)
            for name, value in values
        )

    def _number(self, name: str, stored: int | str) -> int | str:
        return self._choices[name].number(stored) if name in self._choices else stored


@dataclass(slots=True)
class ConfidenceRecord:
    """Error rates by raw confidence, from the last batches of predictions whose cells were simulated.

    Predictions of a released lot are known by its sample alone: each sampled one stands for size / sample of them. Left-out errors of the
    training data fill the gaps of the record, at less weight: an optimizer leaves the region that they come from.
    """

    _record: deque[tuple[Floats, Bools, Floats]] = field(default_factory=lambda: deque(maxlen=RECENT))

    def add(self, confidence: Floats, wrong: Bools, weight: Floats | float = 1.0) -> None:
        """Adds the known predictions of a batch, each of shape (n,)."""
        self._record.append((confidence, wrong, np.broadcast_to(np.asarray(weight, dtype=np.float64), confidence.shape)))

    def error_rates(self, confidence: Floats, left_out: tuple[Floats, Bools] | None = None) -> Floats:
        """Returns expected error rates of raw confidences, shape (n,): non-increasing, 1 without any known prediction. `left_out`: as from
        `Predictor.known_errors`.

        Levels of equal weight, shrunk towards the record's mean error, then made monotone by isotonic regression.
        """
        from scipy.optimize import isotonic_regression  # takes a while, which processes that predict nothing need not pay

        batches = [batch for batch in self._record if len(batch[0])]
        if left_out is not None and len(left_out[0]):
            batches.append((*left_out, np.full(len(left_out[0]), LEFT_OUT)))
        if not batches:
            return np.ones(confidence.shape)
        known, wrong, weight = (np.concatenate(column) for column in zip(*batches, strict=True))
        order = np.lexsort((wrong, known))
        known, wrong, weight = known[order], wrong[order].astype(np.float64), weight[order]
        level = np.minimum((np.cumsum(weight) - weight) / weight.sum() * LEVELS, LEVELS - 1).astype(np.int64)
        level = level[np.searchsorted(known, known)]  # equal confidences share a level
        starts = np.flatnonzero(np.diff(level, prepend=-1))
        mass, errors = np.add.reduceat(weight, starts), np.add.reduceat(weight * wrong, starts)
        mean = float(np.average(wrong, weights=weight))
        shrunk = (errors + DOUBT * mean) / (mass + DOUBT)
        fitted = isotonic_regression(shrunk, weights=mass + DOUBT, increasing=False).x
        place = np.searchsorted(known[starts], confidence, side="right") - 1
        rates: Floats = np.where(place >= 0, fitted[np.maximum(place, 0)], 1.0)
        return rates


class ScenarioLearner:
    """Learns a scenario's answers batch by batch, and predicts the next batch with calibrated error rates."""

    def __init__(self, predictor: Callable[[], Predictor], tolerance: float) -> None:
        """`predictor` creates an untrained predictor; errors up to `tolerance` count as none."""
        self._predictor = predictor
        self._tolerance = tolerance
        self._record = ConfidenceRecord()
        self._known: deque[tuple[Floats, Floats, Floats]] = deque()
        self.known = 0
        """Number of known answers."""
        self.trained_on = 0
        """Number of them when the predictor is, or was, trained: known by the batches alone, so that it is the same after a crash."""
        self._training: list[tuple[Floats, Floats, Floats]] = []
        self._trained: Predictor | None = None
        self._left_out: tuple[Floats, Bools] | None = None
        """Its `known_errors`."""

    def newest(self) -> tuple[float, float]:
        """Returns mean and variance of the scores of the newest batch; zeros without one."""
        if not self._known:
            return 0.0, 0.0
        scores = self._known[-1][1]
        return float(scores.mean()), float(scores.var())

    def learn(self, features: Floats, scores: Floats, ratings: Floats) -> None:
        """Adds simulated answers: features of shape (n, k), scores and ratings of shape (n,)."""
        if len(scores):
            self._known.append((features, scores, ratings))
            self.known += len(scores)
            while sum(len(batch[1]) for batch in self._known) - len(self._known[0][1]) >= MOST_KNOWN:
                self._known.popleft()
        if self.known >= max(FEWEST_KNOWN, REFIT * self.trained_on):
            self._training, self.trained_on = list(self._known), self.known
            self._trained = None

    def observe(self, predicted: Floats, confidence: Floats, scores: Floats, weight: Floats | float = 1.0) -> None:
        """Compares predicted scores with simulated ones, each of shape (n,); a prediction stands for `weight` ones."""
        self._record.add(confidence, self.is_wrong(predicted, scores), weight)

    def is_wrong(self, predicted: Floats, scores: Floats) -> Bools:
        """Returns the predicted scores with an error above the tolerance, as a mask."""
        wrong: Bools = np.abs(predicted - scores) > self._tolerance + grains(predicted, scores)
        return wrong

    def predict(self, features: Floats) -> tuple[Predictions, Floats] | None:
        """Returns the predictions of n sets with their expected error rates, shape (n,); None with too few known answers. The predictor is
        trained on the newest of the first `trained_on` answers when it is first asked."""
        if not self._training:
            return None
        if self._trained is None:
            known = (np.concatenate(column)[-MOST_KNOWN:] for column in zip(*self._training, strict=True))
            self._trained = self._predictor()
            self._trained.fit(*known)
            self._left_out = self._trained.known_errors()
        predictions = self._trained.predict(features)
        return predictions, self._record.error_rates(predictions.confidence, self._left_out)


@dataclass(frozen=True, slots=True)
class Lot:
    """Accepted predictions, by position, and their inspection."""

    members: Indices
    plan: SamplingPlan


def choose_lot(error_rates: Floats, limit: float) -> Lot | None:
    """Returns the lot with the largest expected saving; None if no lot saves a simulation.

    A lot holds the predictions with the lowest `error_rates`, shape (n,); equal rates keep their order. Its mean expected error is at most
    `ROOM` times `limit`, the largest expected share of released errors.
    """
    order = np.argsort(error_rates, kind="stable")
    expected = np.cumsum(error_rates[order]) / np.arange(1, len(order) + 1)
    within = int(np.searchsorted(expected, ROOM * limit, side="right"))
    best: tuple[float, SamplingPlan] | None = None
    for size in reversed(lot_sizes(within)):
        if best is not None and size <= best[0]:
            break
        rate = float(expected[size - 1])
        plan = best_plan(size, limit, rate)
        saving = plan.expected_saving(rate)
        if saving >= 1.0 and (best is None or saving > best[0]):
            best = saving, plan
    return None if best is None else Lot(order[: best[1].size], best[1])


def lot_sizes(most: int) -> list[int]:
    """Returns the sizes up to `most` that lots may have, ascending: steps of at most a 32nd, the same in every batch."""
    sizes, size = [], 1
    while size <= most:
        sizes.append(size)
        size += max(1, (1 << size.bit_length() - 1) // FINENESS)
    return sizes
