"""The frequency weightings of ISO 2631-1 against the standard's table, its transfer functions, and scipy."""

import math

import numpy as np
import pytest
from scipy import signal

from drivecal.highway.comfort import metrics
from drivecal.highway.comfort.metrics import WD, WF, Section, digital

RATE = 100.0

# ISO 2631-1:1997, Table 3, factors x 1000 at the nominal one-third-octave frequencies (Hz), as transcribed alike in several public
# programs. The printed 212 for Wd at 10 Hz is left out: the transfer function of the standard's Annex A gives 202, as do its neighbours.
TABLE_WD = {
    0.1: 62.4, 0.125: 97.3, 0.16: 158, 0.2: 243, 0.25: 365, 0.315: 530, 0.4: 713, 0.5: 853, 0.63: 944, 0.8: 992, 1.0: 1011,
    1.25: 1008, 1.6: 968, 2.0: 890, 2.5: 776, 3.15: 642, 4.0: 512, 5.0: 409, 6.3: 323, 8.0: 253, 12.5: 161, 16.0: 125, 20.0: 100,
    25.0: 80.0, 31.5: 63.2,
}  # fmt: skip
TABLE_WF = {
    0.02: 24.2, 0.025: 37.7, 0.0315: 59.7, 0.04: 97.1, 0.05: 157, 0.063: 267, 0.08: 461, 0.1: 695, 0.125: 895, 0.16: 1006,
    0.2: 992, 0.25: 854, 0.315: 619, 0.4: 384, 0.5: 224, 0.63: 116, 0.8: 53.0, 1.0: 23.5,
}  # fmt: skip
POINTS = [(WD, f, factor) for f, factor in TABLE_WD.items()] + [(WF, f, factor) for f, factor in TABLE_WF.items()]
Weighting = tuple[Section, ...]


def analogue_gain(weighting: Weighting, frequency: float) -> float:
    """Returns the magnitude at `frequency` (Hz) as defined by the standard."""
    return math.prod(section.gain(frequency) for section in weighting)


def digital_gain(weighting: Weighting, frequency: float) -> float:
    _, response = signal.sosfreqz(digital(weighting, RATE), worN=[frequency], fs=RATE)
    return float(abs(response[0]))


@pytest.mark.parametrize(("weighting", "frequency", "factor"), POINTS)
def test_the_digital_weighting_has_the_standards_values(weighting: Weighting, frequency: float, factor: float) -> None:
    """Within 1 % up to 8 Hz, where a car's motion ends, and within the 1 dB that the standard allows at all frequencies of its table."""
    within = 0.01 if frequency <= 8.0 else 1.0 - 10.0 ** (-1.0 / 20.0)
    assert 1000.0 * digital_gain(weighting, frequency) == pytest.approx(factor, rel=within)


@pytest.mark.parametrize(("weighting", "most"), [(WD, 1.05), (WF, 2.2)], ids=["Wd", "Wf"])
def test_digital_weighting_is_within_tolerance_but_near_half_the_rate(weighting: Weighting, most: float) -> None:
    """Wd by 0.04 dB from 34.5 to 40.6 Hz; Wf far above 0.63 Hz, where it ends."""
    frequencies = np.geomspace(0.02, 0.499 * RATE, 500)
    ratios = [digital_gain(weighting, f) / analogue_gain(weighting, f) for f in frequencies]
    away = np.abs(20.0 * np.log10(ratios))
    assert away.max() <= most
    assert away[frequencies < 31.0].max() <= 1.0


@pytest.mark.parametrize(
    ("weighting", "corners", "q4"),
    [(WD, (0.4, 100.0, 2.0, 2.0, 1.0, 1.0), 0.63), (WF, (0.08, 0.63, math.inf, 0.25, 0.0625, 0.1), 0.86)],
    ids=["Wd", "Wf"],
)
def test_a_weighting_is_the_product_that_annex_a_defines(weighting: Weighting, corners: tuple[float, ...], q4: float) -> None:
    """The transfer functions written out as in the standard, with f1 to f6 in Hz and Q5 = Q6 = 0.80; Wd has no step from f5 to f6."""
    w1, w2, w3, w4, w5, w6 = (2.0 * math.pi * f for f in corners)
    for frequency in (0.01, 0.05, 0.0625, 0.1, 0.17, 0.4, 0.5, 1.0, 2.0, 7.0, 40.0):
        p = 2j * math.pi * frequency
        high = 1.0 / (1.0 + math.sqrt(2.0) * w1 / p + (w1 / p) ** 2)
        low = 1.0 / (1.0 + math.sqrt(2.0) * p / w2 + (p / w2) ** 2)
        transition = (1.0 + p / w3) / (1.0 + p / (q4 * w4) + (p / w4) ** 2)
        step = (1.0 + p / (0.8 * w5) + (p / w5) ** 2) / (1.0 + p / (0.8 * w6) + (p / w6) ** 2) * (w5 / w6) ** 2
        assert analogue_gain(weighting, frequency) == pytest.approx(abs(high * low * transition * step), rel=1e-12)


@pytest.mark.parametrize("weighting", [WD, WF])
def test_the_kernel_filters_as_scipy_does(weighting: Weighting) -> None:
    noise = np.random.default_rng(2631).normal(size=(2, 2000))
    sections = digital(weighting, RATE)
    expected = [math.sqrt(float(np.mean(signal.sosfilt(sections, samples) ** 2))) for samples in noise]
    assert metrics.weighted_root_mean_square(*noise, sections) == pytest.approx(expected, rel=1e-12)
