"""Stability of the single track without a controller."""

import math

from drivecal.highway.vehicle.parameters import SingleTrackParameters, understeer_gradient


def critical_speed(parameters: SingleTrackParameters) -> float | None:
    """Returns the speed (m/s) above which an oversteering vehicle is unstable without a controller, sqrt(-wheelbase / K_us).

    Returns None for an understeering or neutral vehicle, which is stable at every speed. At the critical speed the determinant of the yaw
    and side-slip dynamics changes its sign (Rajamani, Section 3.3; Mitschke and Wallentowitz, Dynamik der Kraftfahrzeuge, Chapter 20).
    """
    gradient = understeer_gradient(parameters)
    return math.sqrt(-parameters.wheelbase / gradient) if gradient < 0.0 else None
