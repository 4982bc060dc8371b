"""What is measured of every run, and stored: the metrics of the reference scale and others that an evaluator may rate."""

from __future__ import annotations

import numpy as np

from drivecal.comfort import kernels, weighting
from drivecal.plugins.ports import Floats

RATE = 100.0
"""Rows of `dynamics` per second."""
WINDOW = 50
"""Rows in 0.5 s, over which peaks are averaged (UN R79, 5.6.2.1.3, prescribes this for lateral jerk)."""
REVERSAL_GAP = 0.001
"""Front wheel angle (rad) by which the steering must turn back to count as reversed: one degree at a steering wheel geared 17 to 1."""
SWING = (0.1, 0.05, 10.0)
"""An offset of 0.1 m is noticeable; below 0.05 m for 10 samples (1 s) the vehicle is centred again."""

NAMES = (
    "peak_lateral_acceleration_mps2",
    "peak_lateral_jerk_mps3",
    "peak_longitudinal_acceleration_mps2",
    "peak_longitudinal_jerk_mps3",
    "lateral_acceleration_rms_mps2",
    "longitudinal_acceleration_rms_mps2",
    "peak_yaw_rate_radps",
    "offset_rms_m",
    "offset_peak_m",
    "offset_overshoot_m",
    "steering_reversals_per_minute",
    "iso2631_longitudinal_rms_mps2",
    "iso2631_lateral_rms_mps2",
    "iso2631_horizontal_rms_mps2",
    "iso2631_longitudinal_msdv_mps15",
    "iso2631_lateral_msdv_mps15",
)

_HORIZONTAL = weighting.digital(weighting.WD, RATE)
_SICKNESS = weighting.digital(weighting.WF, RATE)


def comfort_metrics(dynamics: Floats, offset: Floats) -> dict[str, float]:
    """The metrics of one run by name, see `NAMES`; names carry units.

    `dynamics`: one row per 0.01 s: speed, longitudinal acceleration, lateral acceleration, yaw rate, steering angle of the front wheels
    (SI), shape (n, 5). `offset`: signed distance (m) from the centre of the target lane every 0.1 s, shape (m,). Peaks are the largest
    absolute moving averages over 0.5 s, of jerk as well (ISO 11270, UN R79). `iso2631_*_rms` are weighted by Wd with k = 1 (ISO 2631-1,
    Section 8, comfort of seated persons, supporting surface), `iso2631_*_msdv` are motion sickness dose values in m/s^1.5 (Annex D)
    weighted by Wf; the standard defines them for vertical motion, here they are taken of the horizontal one, as is usual
    for cars. Raises ValueError where a series is empty.
    """
    if dynamics.shape[0] == 0 or offset.shape[0] == 0:
        raise ValueError("comfort is measured of at least one row of dynamics and one offset")
    values = np.empty(len(NAMES))
    kernels.measure(dynamics, offset, _HORIZONTAL, _SICKNESS, 1.0 / RATE, WINDOW, REVERSAL_GAP, SWING, values)
    return dict(zip(NAMES, values.tolist(), strict=True))
