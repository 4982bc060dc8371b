"""Parameters of a vehicle model, with the bounds of the robustness study, and the measures of a drive."""

from collections.abc import Mapping
from dataclasses import dataclass

CLOSED_LOOP_MEASURES: Mapping[str, str] = {
    "peak_lateral_acceleration_mps2": "m/s^2",
    "peak_lateral_jerk_mps3": "m/s^3",
    "peak_longitudinal_acceleration_mps2": "m/s^2",
    "peak_longitudinal_jerk_mps3": "m/s^3",
    "lateral_acceleration_rms_mps2": "m/s^2",
    "longitudinal_acceleration_rms_mps2": "m/s^2",
    "peak_yaw_rate_radps": "rad/s",
    "offset_rms_m": "m",
    "offset_peak_m": "m",
    "offset_overshoot_m": "m",
    "steering_reversals_per_minute": "1/min",
    "iso2631_lateral_rms_mps2": "m/s^2",
    "iso2631_longitudinal_rms_mps2": "m/s^2",
    "iso2631_horizontal_rms_mps2": "m/s^2",
    "iso2631_lateral_msdv_mps15": "m/s^1.5",
    "iso2631_longitudinal_msdv_mps15": "m/s^1.5",
    "driven_s": "s",
    "final_offset_m": "m",
    "final_speed_error_mps": "m/s",
}
"""Units by name; vehicle models may measure more, for their own evaluators."""


@dataclass(frozen=True, slots=True)
class VehicleParameter:
    """A physical parameter of a vehicle model in `unit`, with its nominal value and the bounds of Table 8."""

    name: str
    unit: str
    nominal: float
    minimum: float
    maximum: float
    description: str = ""
