"""The comfort metrics' numba kernels, each one pass over a series."""

import math

import numpy as np

from drivecal.highway.compilation import compiled_with
from drivecal.plugins.ports import Floats


@compiled_with()
def peaks(signal: Floats, window: int, rate: float) -> tuple[float, float]:
    """Returns the largest absolute moving average of `signal`, and of its derivative, over `window` samples at `rate` Hz.

    The average of a derivative is the difference of the window's ends over the time between them. Jumps between single samples, as at the
    begin of a new plan, therefore count only as far as they change the acceleration permanently. A signal shorter than the window is
    averaged as a whole.
    """
    n = signal.shape[0]
    window = min(window, n)
    total = 0.0
    for i in range(window):
        total += signal[i]
    largest = abs(total)
    for i in range(window, n):
        total += signal[i] - signal[i - window]
        largest = max(largest, abs(total))
    reach = min(window, n - 1)
    steepest = 0.0
    for i in range(reach, n):
        steepest = max(steepest, abs(signal[i] - signal[i - reach]))
    return largest / window, steepest * rate / max(reach, 1)


@compiled_with()
def root_mean_square(signal: Floats) -> float:
    """Returns sqrt(<signal^2>), summed in the same order on every machine, which a BLAS does not guarantee."""
    total = 0.0
    for value in signal:
        total += value * value
    return math.sqrt(total / signal.shape[0])


@compiled_with()
def weighted_root_mean_square(first: Floats, second: Floats, sections: Floats) -> tuple[float, float]:
    """Returns the r.m.s. of two signals of equal length, filtered by second-order `sections`, shape (n, 6), a0 = 1, from rest.

    Uses the transposed direct form II. Each step of a filter depends on the one before, so that two interleaved filters take no longer
    than a single one.
    """
    n = sections.shape[0]
    memory = np.zeros((n, 4))
    first_total = second_total = 0.0
    for index in range(first.shape[0]):
        value, other = first[index], second[index]
        for k in range(n):
            out, other_out = sections[k, 0] * value + memory[k, 0], sections[k, 0] * other + memory[k, 2]
            memory[k, 0] = sections[k, 1] * value - sections[k, 4] * out + memory[k, 1]
            memory[k, 2] = sections[k, 1] * other - sections[k, 4] * other_out + memory[k, 3]
            memory[k, 1] = sections[k, 2] * value - sections[k, 5] * out
            memory[k, 3] = sections[k, 2] * other - sections[k, 5] * other_out
            value, other = out, other_out
        first_total += value * value
        second_total += other * other
    return math.sqrt(first_total / first.shape[0]), math.sqrt(second_total / first.shape[0])


@compiled_with()
def reversals(angle: Floats, gap: float) -> int:
    """Counts how often `angle` turns back by at least `gap` after moving by at least `gap` (zigzag count with hysteresis)."""
    count = 0
    direction = 0
    low = high = angle[0]
    for value in angle:
        if direction >= 0:
            high = max(high, value)
        if direction <= 0:
            low = min(low, value)
        if direction >= 0 and high - value >= gap:
            count += direction
            direction, low = -1, value
        elif direction <= 0 and value - low >= gap:
            count -= direction
            direction, high = 1, value
    return count


@compiled_with()
def overshoot(offset: Floats, noticeable: float, centred: float, settled: int) -> float:
    """Returns the largest overshoot (m) beyond the centre after an excursion.

    An excursion begins when |offset| reaches `noticeable`. Offsets on the other side count as overshoot until |offset| has stayed below
    `centred` for `settled` samples. An overshoot that reaches `noticeable` begins the next excursion.
    """
    largest = 0.0
    side = 0.0
    calm = 0
    for value in offset:
        calm = calm + 1 if abs(value) < centred else 0
        if calm >= settled:
            side = 0.0
        largest = max(largest, -side * value)
        if value >= noticeable:
            side = 1.0
        elif value <= -noticeable:
            side = -1.0
    return largest
