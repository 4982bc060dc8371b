"""Predicted answers: a predictor's port, the calibration of its confidence, and the choice of a lot. Pure.

A prediction needs no guarantee of its own: `reduction.lots` bounds the released errors of every predictor. A better calibration only saves
more, because fewer lots are rejected and fewer right predictions are left out.
"""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt
from scipy.optimize import isotonic_regression

from drivecal.reduction.lots import SamplingPlan, best_plan

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Positions = npt.NDArray[np.int64]

SIZES = 48
"""Lot sizes that `choose_lot` compares."""
LEVELS = 40
"""Levels of confidence in a calibration, of equal weight."""
DOUBT = 5.0
"""Weight of the prior in each level: so many observations of the record's mean error."""


class Predictor(Protocol):
    """Predicts scores from features in 0..1, shape (n, k). Deterministic: the same bits for the same data in every process."""

    def fit(self, features: Floats, scores: Floats) -> None:
        """Learns from simulated scores, shape (n,), in a canonical order."""

    def predict(self, features: Floats) -> tuple[Floats, Floats]:
        """Returns predicted scores and raw confidences in 0..1, each of shape (n,)."""

    def known_errors(self) -> tuple[Floats, Bools]:
        """Returns raw confidences and whether the prediction was wrong, of training data left out of the fit, each of shape (n,)."""


@dataclass(slots=True)
class Calibration:
    """Error rates by raw confidence, from predictions of earlier batches whose cells were simulated.

    Predictions of a released lot are known by its sample alone: each sampled one stands for size / sample of them.
    """

    _confidence: list[Floats] = field(default_factory=list)
    _wrong: list[Bools] = field(default_factory=list)
    _weight: list[Floats] = field(default_factory=list)

    def add(self, confidence: Floats, wrong: Bools, weight: Floats | float = 1.0) -> None:
        """Adds known predictions, each of shape (n,)."""
        self._confidence.append(confidence)
        self._wrong.append(wrong)
        self._weight.append(np.broadcast_to(np.asarray(weight, dtype=np.float64), confidence.shape))

    def error_rates(self, confidence: Floats) -> Floats:
        """Returns expected error rates of raw confidences, shape (n,): non-increasing, 1 without a record.

        Levels of equal weight, shrunk towards the record's mean error, then made monotone by isotonic regression.
        """
        if not self._confidence:
            return np.ones(confidence.shape)
        known, wrong, weight = (np.concatenate(column) for column in (self._confidence, self._wrong, self._weight))
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


@dataclass(frozen=True, slots=True)
class Lot:
    """Accepted predictions, by position, and their inspection."""

    members: Positions
    plan: SamplingPlan


def choose_lot(error_rates: Floats, limit: float) -> Lot | None:
    """Returns the lot with the largest expected saving; None if no lot saves a simulation.

    A lot holds the predictions with the lowest `error_rates`, shape (n,); equal rates keep their order. `limit`: the largest expected
    share of released errors.
    """
    order = np.argsort(error_rates, kind="stable")
    expected = np.cumsum(error_rates[order]) / np.arange(1, len(order) + 1)
    sizes = sorted({int(size) for size in np.linspace(1, len(order), min(SIZES, len(order))).round()}) if len(order) else []
    best: tuple[float, Lot] | None = None
    for size in sizes:
        rate = float(expected[size - 1])
        plan = best_plan(size, limit, rate)
        saving = plan.expected_saving(rate)
        if saving >= 1.0 and (best is None or saving > best[0]):
            best = saving, Lot(order[:size], plan)
    return None if best is None else best[1]
