"""Ratings of time series by MiniRocket features (Dempster, Schmidt and Webb, 2021) and ridge regressions, in whole numbers.

A run becomes six channels of a fixed length. 84 kernels of length 9 (weights -1, three of them 2) are combined with several dilations, each
over a subset of the channels. A feature is the share of time during which the convolution exceeds a bias. Series and biases are integers
here, so that sums are exact in any order and width: features have the same bits on every machine and in other
implementations with the same integers.
"""

from itertools import combinations
from math import floor

import numpy as np
import numpy.typing as npt

from drivecal.domain.evaluations import Rating
from drivecal.highway.comfort.reference import BEST
from drivecal.highway.comfort.regressions import Regression
from drivecal.highway.compilation import compiled_with
from drivecal.plugins.ports import Floats

LENGTH = 160
"""Samples per channel, spread over the whole run."""
WINDOW = 50
"""Rows of `dynamics` (0.01 s each) over which accelerations, jerks and yaw rate are averaged, like the peaks of the reference scale."""
SHORTEST, LONGEST = 1000, 3000
"""Rows of the shortest and the longest run that can be rated: 10 and 30 s."""
UNITS: Floats = np.array([1.0, 1.0, 1.0, 1.0, 0.04, 0.25])
"""Units of longitudinal and lateral acceleration (m/s^2), longitudinal and lateral jerk (m/s^3), yaw rate (rad/s) and offset (m)."""
RESOLUTION, LARGEST = 256, 2047
"""Steps per unit and largest value, 8 units. Convolutions over all channels stay below 2^18, exact in 32 bits."""


@compiled_with()
def _sample(signal: Floats, position: float) -> float:
    """Interpolates linearly between samples; clips `position` to the signal."""
    last = signal.shape[0] - 1
    position = min(max(position, 0.0), float(last))
    row = min(int(position), last - 1)
    return signal[row] + (position - row) * (signal[row + 1] - signal[row])


@compiled_with()
def _fill(dynamics: Floats, offset: Floats, units: Floats, out: npt.NDArray[np.int32]) -> None:
    n, length = dynamics.shape[0], out.shape[1]
    averages, slopes = n - WINDOW + 1, n - WINDOW
    averaged = np.zeros((3, averages))
    for k in range(3):
        column = 1 + k
        total = 0.0
        for i in range(n):
            total += dynamics[i, column]
            if i >= WINDOW:
                total -= dynamics[i - WINDOW, column]
            if i >= WINDOW - 1:
                averaged[k, i - WINDOW + 1] = total / WINDOW
    steep = np.zeros((2, slopes))
    for k in range(2):
        for i in range(slopes):
            steep[k, i] = (dynamics[i + WINDOW, 1 + k] - dynamics[i, 1 + k]) * (100.0 / WINDOW)
    for t in range(length):
        share = t / (length - 1.0)
        out[0, t] = _whole(_sample(averaged[0], share * (averages - 1)) / units[0])
        out[1, t] = _whole(_sample(averaged[1], share * (averages - 1)) / units[1])
        out[2, t] = _whole(_sample(steep[0], share * (slopes - 1)) / units[2])
        out[3, t] = _whole(_sample(steep[1], share * (slopes - 1)) / units[3])
        out[4, t] = _whole(_sample(averaged[2], share * (averages - 1)) / units[4])
        out[5, t] = _whole(_sample(offset, share * (offset.shape[0] - 1)) / units[5])


@compiled_with()
def _whole(value: float) -> int:
    return int(min(max(np.floor(value * RESOLUTION + 0.5), -LARGEST), LARGEST))


MIRROR: npt.NDArray[np.int32] = np.array([[1], [-1], [1], [-1], [-1], [-1]], dtype=np.int32)
"""Factors that mirror channels: left and right exchanged."""


def channels_of(dynamics: Floats, offset: Floats) -> npt.NDArray[np.int32]:
    """Returns the channels in the order of `UNITS`, shape (6, LENGTH), in 1/256 of their units, clipped at 8 units.

    `dynamics` (n, 5) and `offset` (m,) as in `ports.Series`. Raises ValueError if the run is too short or too long, or if a value is not
    finite.
    """
    rows = dynamics.shape[0]
    if not SHORTEST <= rows <= LONGEST or offset.shape[0] < 2:
        raise ValueError(f"the run lasts {rows / 100:g} s; the learned evaluator rates {SHORTEST // 100} to {LONGEST // 100} s")
    if not (np.isfinite(dynamics).all() and np.isfinite(offset).all()):
        raise ValueError("a value of the series is not finite; only finite series can be rated")
    channels = np.zeros((len(UNITS), LENGTH), dtype=np.int32)
    _fill(np.ascontiguousarray(dynamics), np.ascontiguousarray(offset), UNITS, channels)
    return channels


Integers = npt.NDArray[np.int32]

TAPS = 9
KERNELS: Integers = np.array(list(combinations(range(TAPS), 3)), dtype=np.int32)
"""Positions of the three weights of 2 among the nine, shape (84, 3)."""


@compiled_with()
def _convolve(
    padded: Integers, sums: Integers, channels: Integers, taps: Integers, dilation: int, margin: int, out: Integers
) -> None:
    """Writes to `out`, shape (n,), three times the sum of the `taps` minus the sum of all nine samples, over the channels.

    Samples beyond the ends are zero.
    """
    out[:] = 0
    n = out.shape[0]
    first = margin + (taps[0] - 4) * dilation
    second = margin + (taps[1] - 4) * dilation
    third = margin + (taps[2] - 4) * dilation
    for channel in channels:
        row, total = padded[channel], sums[channel]
        for t in range(n):
            out[t] += 3 * (row[first + t] + row[second + t] + row[third + t]) - total[t]


@compiled_with()
def transform(
    series: Integers,
    kernels: Integers,
    dilations: Integers,
    per_dilation: Integers,
    n_channels: Integers,
    channels: Integers,
    biases: Integers,
) -> Floats:
    """Returns the features of `series`, shape (channels, n), in the order of dilation, kernel, bias.

    `per_dilation`: biases per kernel, by dilation. `n_channels`: number of consecutive `channels`, by (dilation, kernel). As in the
    original, every other combination leaves out the ends, at which the kernel extends beyond the series.
    """
    count, n = series.shape
    margin = 4 * int(dilations.max())
    padded = np.zeros((count, n + 2 * margin), dtype=np.int32)
    padded[:, margin : margin + n] = series
    sums, convolution = np.zeros((count, n), dtype=np.int32), np.zeros(n, dtype=np.int32)
    features = np.zeros(biases.shape[0])
    feature = combination = place = 0
    for d in range(dilations.shape[0]):
        dilation = int(dilations[d])
        sums[:] = 0
        for channel in range(count):
            for tap in range(-4, 5):
                begin = margin + tap * dilation
                for t in range(n):
                    sums[channel, t] += padded[channel, begin + t]
        for k in range(kernels.shape[0]):
            used = channels[place : place + n_channels[combination]]
            place += n_channels[combination]
            combination += 1
            _convolve(padded, sums, used, kernels[k], dilation, margin, convolution)
            cut = 4 * dilation if (d + k) % 2 == 1 else 0
            for _ in range(per_dilation[d]):
                above = 0
                bias = biases[feature]
                for t in range(cut, n - cut):
                    above += convolution[t] > bias
                features[feature] = above / (n - 2 * cut)
                feature += 1
    return features


@compiled_with()
def _weighted(features: Floats, weights: Floats, intercept: float) -> float:
    """Sums in the same order on every machine."""
    total = 0.0
    for k in range(features.shape[0]):
        total += weights[k] * features[k]
    return total + intercept


def features_of(regression: Regression, channels: Integers) -> Floats:
    """Returns the MiniRocket features of a regression, shape (n,), averaged over the run and its mirror image.

    The comfort of a manoeuvre does not depend on its side.
    """
    dilations, per_dilation = regression.dilations, regression.per_dilation
    structure = (KERNELS, dilations, per_dilation, regression.n_channels, regression.channels, regression.biases)
    original: Floats = transform(channels, *structure)
    mirrored: Floats = transform(channels * MIRROR, *structure)
    return 0.5 * (original + mirrored)


def rating_of(regression: Regression, channels: Integers) -> Rating:
    """Returns the rating of a run's `channels`, clipped to 0..7, and its rounding (half up)."""
    features = features_of(regression, channels)
    rating = float(np.clip(_weighted(features, regression.weights, regression.intercept.item()), 0.0, BEST))
    return Rating(rating=rating, score=floor(rating + 0.5))
