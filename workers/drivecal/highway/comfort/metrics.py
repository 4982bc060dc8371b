"""Metrics measured and stored for every run, for the reference scale and for user-defined evaluators.

Frequency weightings follow ISO 2631-1, which defines them as products of analogue second-order sections (Annex A; parameters also in ISO
8041-1, Table 3): band limits, transition from acceleration to velocity, upward step. Each section becomes a digital one whose poles are the
exact images of the analogue poles, z = exp(s T). Its numerator matches the analogue magnitude at zero, at the section's own frequency and
at half the sampling rate (Vicanek, Matched Second Order Digital Filters, 2016). A bilinear transform would be 3 % off at 10 Hz already and
could not represent the band limit of 100 Hz.
"""

import math
from dataclasses import dataclass

import numpy as np

from drivecal.highway.compilation import compiled_with
from drivecal.plugins.ports import Floats


@dataclass(frozen=True, slots=True)
class Section:
    """(b0 + b1 s + b2 s^2) / (1 + s / (Q w) + s^2 / w^2) with w = 2 pi `frequency` (Hz) and Q = `quality`, ascending powers of s."""

    numerator: tuple[float, float, float]
    frequency: float
    quality: float

    def gain(self, frequency: float) -> float:
        """Returns the magnitude at `frequency` (Hz)."""
        s = 2j * math.pi * frequency
        w = 2.0 * math.pi * self.frequency
        b0, b1, b2 = self.numerator
        return abs((b0 + b1 * s + b2 * s * s) / (1.0 + s / (self.quality * w) + s * s / (w * w)))


def high_pass(frequency: float) -> Section:
    """Returns a Butterworth high-pass of order 2."""
    return Section((0.0, 0.0, (2.0 * math.pi * frequency) ** -2), frequency, math.sqrt(0.5))


def low_pass(frequency: float, quality: float = math.sqrt(0.5)) -> Section:
    """Returns a low-pass of order 2, by default a Butterworth filter."""
    return Section((1.0, 0.0, 0.0), frequency, quality)


def transition(zero: float, pole: float, quality: float) -> Section:
    """Returns the acceleration-velocity transition: a zero at `zero` Hz, a pair of poles at `pole` Hz.

    It is proportional to acceleration at lower and to velocity at higher frequencies.
    """
    return Section((1.0, 1.0 / (2.0 * math.pi * zero), 0.0), pole, quality)


def upward_step(zeros: float, zeros_quality: float, poles: float, poles_quality: float) -> Section:
    """Returns an upward step of about 6 dB per octave between `zeros` and `poles` (Hz), with gain 1 at high frequency."""
    w = 2.0 * math.pi * zeros
    scale = (zeros / poles) ** 2
    return Section((scale, scale / (zeros_quality * w), scale / (w * w)), poles, poles_quality)


WD = (high_pass(0.4), low_pass(100.0), transition(2.0, 2.0, 0.63))
"""Weighting of horizontal acceleration for seated persons."""
WF = (high_pass(0.08), low_pass(0.63), low_pass(0.25, 0.86), upward_step(0.0625, 0.80, 0.1, 0.80))
"""Weighting of motion sickness; its transition has no zero."""


def _digital(section: Section, rate: float) -> tuple[float, ...]:
    """Returns a row of `digital`. The poles must be complex, as in all weightings here."""
    w = 2.0 * math.pi * section.frequency / rate
    root = np.exp(w * (-0.5 / section.quality + np.emath.sqrt(0.25 / section.quality**2 - 1.0)))
    a1, a2 = float(-2.0 * root.real), float(abs(root) ** 2)

    def squared(frequency: float) -> float:
        """Returns the required |numerator|^2 at `frequency`."""
        z = np.exp(-2j * math.pi * frequency / rate)
        return float((section.gain(frequency) * abs(1.0 + a1 * z + a2 * z * z)) ** 2)

    # |b0 + b1/z + b2/z^2|^2 = B0 cos^2(w/2) + B1 sin^2(w/2) + B2 sin^2(w), fitted at three frequencies.
    match = min(section.frequency, 0.25 * rate)
    sine = math.sin(math.pi * match / rate) ** 2
    zero, half = squared(0.0), squared(0.5 * rate)
    middle = (squared(match) - zero * (1.0 - sine) - half * sine) / (4.0 * sine * (1.0 - sine))
    mean = 0.5 * (math.sqrt(zero) + math.sqrt(half))
    b0 = 0.5 * (mean + math.sqrt(max(0.0, mean * mean + middle)))
    return b0, 0.5 * (math.sqrt(zero) - math.sqrt(half)), -0.25 * middle / b0, 1.0, a1, a2


def digital(sections: tuple[Section, ...], rate: float) -> Floats:
    """Returns a weighting as second-order sections for signals sampled at `rate` Hz, shape (n, 6), as in `scipy.signal.sosfilt`."""
    return np.array([_digital(section, rate) for section in sections])


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


RATE = 100
"""Rows of `dynamics` per second."""
WINDOW = RATE // 2
"""Rows in 0.5 s, the averaging window of peaks, which UN R79 prescribes for the lateral jerk of lane change systems."""
REVERSAL_GAP = 0.001
"""Front wheel angle (rad) of a steering reversal: one degree at a steering wheel with a ratio of 17 to 1."""
NOTICEABLE, CENTRED, SETTLED = 0.1, 0.05, 1.0
"""Excursions begin at an offset of 0.1 m and end after 1 s below 0.05 m."""

_HORIZONTAL = digital(WD, RATE)
_SICKNESS = digital(WF, RATE)


def comfort_metrics(dynamics: Floats, offset: Floats, step: float = 0.1) -> dict[str, float]:
    """Returns the metrics of a run by name; names carry units.

    `dynamics`: one row per 0.01 s: speed, longitudinal acceleration, lateral acceleration, yaw rate, steering angle of the front wheels
    (SI), shape (n, 5). `offset`: signed distance (m) from the centre of the target lane every `step` (s), shape (m,).

    Peaks are the largest absolute moving averages over 0.5 s, also of jerk. `iso2631_*_rms` are weighted by Wd with k = 1 (ISO
    2631-1, Section 8.2: comfort of seated persons, on the seat). `iso2631_*_msdv` are motion sickness dose values in m/s^1.5 (Annex D)
    weighted by Wf. The standard defines them for vertical motion; here they are applied to horizontal motion, as is usual for cars.
    Raises ValueError if a series is empty.
    """
    if dynamics.shape[0] == 0 or offset.shape[0] == 0:
        raise ValueError("a series is empty; comfort metrics need at least one row of dynamics and one offset")
    longitudinal, lateral, yaw_rate, steering = np.ascontiguousarray(dynamics.T[1:5])
    offset = np.ascontiguousarray(offset)
    seconds = dynamics.shape[0] / RATE
    lateral_peak, lateral_jerk = peaks(lateral, WINDOW, RATE)
    longitudinal_peak, longitudinal_jerk = peaks(longitudinal, WINDOW, RATE)
    weighted_lateral, weighted_longitudinal = weighted_root_mean_square(lateral, longitudinal, _HORIZONTAL)
    sickening_lateral, sickening_longitudinal = weighted_root_mean_square(lateral, longitudinal, _SICKNESS)
    return {
        "peak_lateral_acceleration_mps2": lateral_peak,
        "peak_lateral_jerk_mps3": lateral_jerk,
        "peak_longitudinal_acceleration_mps2": longitudinal_peak,
        "peak_longitudinal_jerk_mps3": longitudinal_jerk,
        "lateral_acceleration_rms_mps2": root_mean_square(lateral),
        "longitudinal_acceleration_rms_mps2": root_mean_square(longitudinal),
        "peak_yaw_rate_radps": float(np.abs(yaw_rate).max()),
        "offset_rms_m": root_mean_square(offset),
        "offset_peak_m": float(np.abs(offset).max()),
        "offset_overshoot_m": overshoot(offset, NOTICEABLE, CENTRED, max(1, round(SETTLED / step))),
        "steering_reversals_per_minute": reversals(steering, REVERSAL_GAP) * 60.0 / seconds,
        "iso2631_lateral_rms_mps2": weighted_lateral,
        "iso2631_longitudinal_rms_mps2": weighted_longitudinal,
        "iso2631_horizontal_rms_mps2": math.hypot(weighted_lateral, weighted_longitudinal),
        "iso2631_lateral_msdv_mps15": sickening_lateral * math.sqrt(seconds),
        "iso2631_longitudinal_msdv_mps15": sickening_longitudinal * math.sqrt(seconds),
    }
