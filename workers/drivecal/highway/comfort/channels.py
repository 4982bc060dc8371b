"""Input of the learned evaluator: six channels of a run, resampled to a fixed length, in whole numbers."""

import numpy as np
import numpy.typing as npt

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
"""Factors that turn channels into those of the mirrored run, with left and right exchanged."""


def channels_of(dynamics: Floats, offset: Floats) -> npt.NDArray[np.int32]:
    """Returns the channels in the order of `UNITS`, shape (6, LENGTH), in 1/256 of their units, clipped at 8 units.

    `dynamics` (n, 5) and `offset` (m,) as in `ports.Series`. Raises ValueError if the run is too short or too long, or if a value is not
    finite.
    """
    rows = dynamics.shape[0]
    if not SHORTEST <= rows <= LONGEST or offset.shape[0] < 2:
        raise ValueError(
            f"the run lasts {rows / 100:g} s; the learned evaluator rates runs of {SHORTEST // 100} to {LONGEST // 100} s"
        )
    if not (np.isfinite(dynamics).all() and np.isfinite(offset).all()):
        raise ValueError("a value of the series is not finite; only finite series can be rated")
    channels = np.zeros((len(UNITS), LENGTH), dtype=np.int32)
    _fill(np.ascontiguousarray(dynamics), np.ascontiguousarray(offset), UNITS, channels)
    return channels
