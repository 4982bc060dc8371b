"""The learned evaluator at work: from a series to features to a rating."""

from __future__ import annotations

from collections.abc import Mapping
from math import floor

import numpy as np
from numba import njit

from drivecal.comfort import rocket
from drivecal.comfort.channels import MIRROR, channels_of
from drivecal.comfort.regression_arrays import Regression
from drivecal.comfort.scale import BEST
from drivecal.domain.evaluations import Rating
from drivecal.domain.scenarios import Manoeuvre
from drivecal.plugins.ports import Floats, Series


@njit(cache=True)
def _weighted(features: Floats, weights: Floats, intercept: float) -> float:
    """In one order of summation on every machine."""
    total = 0.0
    for k in range(features.shape[0]):
        total += weights[k] * features[k]
    return total + intercept


def features_of(regression: Regression, channels: rocket.Integers) -> Floats:
    """The MiniRocket features that a class of manoeuvres is rated by, shape (n,).

    Their mean over the run and its mirror image: how comfortable a manoeuvre is does not depend on its side.
    """
    one = regression
    parts = (rocket.KERNELS, one.dilations, one.per_dilation, one.n_channels, one.channels, one.biases)
    seen: Floats = rocket.transform(channels, *parts)
    mirrored: Floats = rocket.transform(channels * MIRROR, *parts)
    return 0.5 * (seen + mirrored)


class Rater:
    """Rates series by one regression for each class."""

    def __init__(self, regressions: Mapping[Manoeuvre, Regression]) -> None:
        self._regressions = dict(regressions)

    def rate(self, manoeuvre: Manoeuvre, series: Series) -> Rating:
        """The rating, cut to 0..7, and its rounding (half up). Raises ValueError where the series cannot be rated."""
        return self.rate_channels(manoeuvre, channels_of(series.dynamics, series.offset))

    def rate_channels(self, manoeuvre: Manoeuvre, channels: rocket.Integers) -> Rating:
        """The same from `channels_of` a series."""
        regression = self._regressions[manoeuvre]
        features = features_of(regression, channels)
        rating = float(np.clip(_weighted(features, regression.weights, regression.intercept.item()), 0.0, BEST))
        return Rating(rating=rating, score=floor(rating + 0.5))
