"""Metrics measured and stored for every run: those of the reference scale and others for user-defined evaluators."""

import math

import numpy as np

from drivecal.highway.comfort import kernels, weighting
from drivecal.plugins.ports import Floats

RATE = 100
"""Rows of `dynamics` per second."""
WINDOW = RATE // 2
"""Rows in 0.5 s, the averaging window of peaks, which UN R79 prescribes for the lateral jerk of lane change systems."""
REVERSAL_GAP = 0.001
"""Front wheel angle (rad) of a steering reversal: one degree at a steering wheel with a ratio of 17 to 1."""
NOTICEABLE, CENTRED, SETTLED = 0.1, 0.05, 10
"""Excursions begin at an offset of 0.1 m and end after 10 samples (1 s) below 0.05 m."""

_HORIZONTAL = weighting.digital(weighting.WD, RATE)
_SICKNESS = weighting.digital(weighting.WF, RATE)


def comfort_metrics(dynamics: Floats, offset: Floats) -> dict[str, float]:
    """Returns the metrics of a run by name; names carry units.

    `dynamics`: one row per 0.01 s: speed, longitudinal acceleration, lateral acceleration, yaw rate, steering angle of the front wheels
    (SI), shape (n, 5). `offset`: signed distance (m) from the centre of the target lane every 0.1 s, shape (m,).

    Peaks are the largest absolute moving averages over 0.5 s, including those of jerk. `iso2631_*_rms` are weighted by Wd with k = 1 (ISO
    2631-1, Section 8.2: comfort of seated persons, on the seat). `iso2631_*_msdv` are motion sickness dose values in m/s^1.5 (Annex D)
    weighted by Wf. The standard defines them for vertical motion; here they are applied to horizontal motion, as is usual for cars.
    Raises ValueError if a series is empty.
    """
    if dynamics.shape[0] == 0 or offset.shape[0] == 0:
        raise ValueError("a series is empty; comfort metrics need at least one row of dynamics and one offset")
    longitudinal, lateral, yaw_rate, steering = np.ascontiguousarray(dynamics.T[1:5])
    offset = np.ascontiguousarray(offset)
    seconds = dynamics.shape[0] / RATE
    lateral_peak, lateral_jerk = kernels.peaks(lateral, WINDOW, RATE)
    longitudinal_peak, longitudinal_jerk = kernels.peaks(longitudinal, WINDOW, RATE)
    weighted_lateral, weighted_longitudinal = kernels.weighted_root_mean_square(lateral, longitudinal, _HORIZONTAL)
    sickening_lateral, sickening_longitudinal = kernels.weighted_root_mean_square(lateral, longitudinal, _SICKNESS)
    return {
        "peak_lateral_acceleration_mps2": lateral_peak,
        "peak_lateral_jerk_mps3": lateral_jerk,
        "peak_longitudinal_acceleration_mps2": longitudinal_peak,
        "peak_longitudinal_jerk_mps3": longitudinal_jerk,
        "lateral_acceleration_rms_mps2": kernels.root_mean_square(lateral),
        "longitudinal_acceleration_rms_mps2": kernels.root_mean_square(longitudinal),
        "peak_yaw_rate_radps": float(np.abs(yaw_rate).max()),
        "offset_rms_m": kernels.root_mean_square(offset),
        "offset_peak_m": float(np.abs(offset).max()),
        "offset_overshoot_m": kernels.overshoot(offset, NOTICEABLE, CENTRED, SETTLED),
        "steering_reversals_per_minute": kernels.reversals(steering, REVERSAL_GAP) * 60.0 / seconds,
        "iso2631_lateral_rms_mps2": weighted_lateral,
        "iso2631_longitudinal_rms_mps2": weighted_longitudinal,
        "iso2631_horizontal_rms_mps2": math.hypot(weighted_lateral, weighted_longitudinal),
        "iso2631_lateral_msdv_mps15": sickening_lateral * math.sqrt(seconds),
        "iso2631_longitudinal_msdv_mps15": sickening_longitudinal * math.sqrt(seconds),
    }
