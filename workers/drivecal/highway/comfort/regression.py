"""Rating of a time series by MiniRocket features and a ridge regression."""

from collections.abc import Mapping
from math import floor

import numpy as np

from drivecal.domain.evaluations import Rating
from drivecal.highway.comfort import rocket
from drivecal.highway.comfort.channels import MIRROR, channels_of
from drivecal.highway.comfort.regression_arrays import Regression
from drivecal.highway.comfort.scale import BEST
from drivecal.highway.compilation import compiled_with
from drivecal.highway.manoeuvres import Manoeuvre
from drivecal.plugins.ports import Floats, Series


@compiled_with()
def _weighted(features: Floats, weights: Floats, intercept: float) -> float:
    """Sums in the same order on every machine."""
    total = 0.0
    for k in range(features.shape[0]):
        total += weights[k] * features[k]
    return total + intercept


def features_of(regression: Regression, channels: rocket.Integers) -> Floats:
    """Returns the MiniRocket features of a regression, shape (n,), averaged over the run and its mirror image.

    The comfort of a manoeuvre does not depend on its side.
    """
    dilations, per_dilation = regression.dilations, regression.per_dilation
    structure = (rocket.KERNELS, dilations, per_dilation, regression.n_channels, regression.channels, regression.biases)
    original: Floats = rocket.transform(channels, *structure)
    mirrored: Floats = rocket.transform(channels * MIRROR, *structure)
    return 0.5 * (original + mirrored)


class Rater:
    """Rates time series by one regression per class of manoeuvres."""

    def __init__(self, regressions: Mapping[Manoeuvre, Regression]) -> None:
        self._regressions = dict(regressions)

    def rate(self, manoeuvre: Manoeuvre, series: Series) -> Rating:
        """Returns the rating, clipped to 0..7, and its rounding (half up). Raises ValueError if the series cannot be rated."""
        return self.rate_channels(manoeuvre, channels_of(series.dynamics, series.offset))

    def rate_channels(self, manoeuvre: Manoeuvre, channels: rocket.Integers) -> Rating:
        """Rates the result of `channels_of`."""
        regression = self._regressions[manoeuvre]
        features = features_of(regression, channels)
        rating = float(np.clip(_weighted(features, regression.weights, regression.intercept.item()), 0.0, BEST))
        return Rating(rating=rating, score=floor(rating + 0.5))
