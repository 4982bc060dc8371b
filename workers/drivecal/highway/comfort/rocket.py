"""MiniRocket features of a multivariate series (Dempster, Schmidt and Webb, 2021), in whole numbers.

84 kernels of length 9 (weights -1, three of them 2) are combined with several dilations, each over a subset of the channels. A feature is
the share of time during which the convolution exceeds a bias. Series and biases are integers here, so that sums are exact in any order and
width: features have the same bits on every machine, and equal those of other implementations for the same integers.
"""

from itertools import combinations

import numpy as np
import numpy.typing as npt

from drivecal.highway.compilation import compiled_with
from drivecal.plugins.ports import Floats

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
def convolution_of(series: Integers, taps: Integers, dilation: int, channels: Integers) -> Integers:
    """Returns one convolution of `series`, shape (n,), from which biases are drawn."""
    count, n = series.shape
    margin = 4 * dilation
    padded = np.zeros((count, n + 2 * margin), dtype=np.int32)
    padded[:, margin : margin + n] = series
    sums, out = np.zeros((count, n), dtype=np.int32), np.zeros(n, dtype=np.int32)
    for channel in range(count):
        for tap in range(-4, 5):
            for t in range(n):
                sums[channel, t] += padded[channel, margin + tap * dilation + t]
    _convolve(padded, sums, channels, taps, dilation, margin, out)
    return out
