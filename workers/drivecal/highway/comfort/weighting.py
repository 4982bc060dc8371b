"""Frequency weightings of ISO 2631-1 as digital filters.

The standard defines them as products of analogue second-order sections (Annex A; parameters also in ISO 8041-1, Table 3): band limits,
transition from acceleration to velocity, upward step. Each section becomes a digital one whose poles are the exact images of the
analogue poles, z = exp(s T). Its numerator matches the analogue magnitude at zero, at the section's own frequency and at half the sampling
rate (Vicanek, Matched Second Order Digital Filters, 2016). A bilinear transform would be 3 % off at 10 Hz already and could not represent
the band limit of 100 Hz.
"""

import math
from dataclasses import dataclass

import numpy as np

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
    w = 2.0 * math.pi * section.frequency / rate
    root = np.exp(w * (-0.5 / section.quality + np.emath.sqrt(0.25 / section.quality**2 - 1.0)))
    a1, a2 = float(-2.0 * root.real), float(abs(root) ** 2)
    if 2.0 * section.quality < 1.0:
        raise ValueError("sections with real poles are not supported; no weighting needs them")

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
