"""Parameters of the single-track model (Table 8 of the paper) and quantities derived from them in closed form.

Sign convention throughout: x forward, y to the left, angles counter-clockwise; SI units.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.vehicles import VehicleParameter

TABLE_8: tuple[VehicleParameter, ...] = (
    VehicleParameter("mass", "kg", 2060.0, 1200.0, 2600.0, "m, mass of the vehicle"),
    VehicleParameter("cornering_stiffness_front", "N/rad", 75_000.0, 55_000.0, 90_000.0, "c_alpha_f, of the whole front axle"),
    VehicleParameter("cornering_stiffness_rear", "N/rad", 150_000.0, 120_000.0, 180_000.0, "c_alpha_r, of the whole rear axle"),
    VehicleParameter("distance_front", "m", 1.66, 1.0, 2.0, "l_f, front axle to centre of mass"),
    VehicleParameter("distance_rear", "m", 1.55, 1.0, 2.0, "l_r, rear axle to centre of mass"),
    VehicleParameter("yaw_inertia", "kg m^2", 3832.0, 2000.0, 4500.0, "theta_z, moment of inertia about the vertical axis"),
)
"""Nominal values and bounds as printed. The table labels both distances l_f; the second is l_r."""


@dataclass(frozen=True, slots=True)
class SingleTrackParameters:
    """Values of the parameters in Table 8."""

    mass: float
    cornering_stiffness_front: float
    cornering_stiffness_rear: float
    distance_front: float
    distance_rear: float
    yaw_inertia: float

    @classmethod
    def of(cls, values: Mapping[str, float]) -> SingleTrackParameters:
        """Creates parameters from values by name. Raises InvalidInputError for missing, unknown, non-positive or non-finite values."""
        names = [parameter.name for parameter in TABLE_8]
        problems = [
            Problem(f"vehicle.parameters.{name}", "the value is missing", "give all parameters")
            for name in names
            if name not in values
        ]
        for name, value in values.items():
            if name not in names:
                remedy = f"the single-track model has {', '.join(names)}"
                problems.append(Problem(f"vehicle.parameters.{name}", "there is no such parameter", remedy))
            elif not (math.isfinite(value) and value > 0.0):
                problems.append(Problem(f"vehicle.parameters.{name}", f"{value} is unusable", "give a positive finite number"))
        if problems:
            raise InvalidInputError(*problems)
        return cls(**{name: float(values[name]) for name in names})

    @property
    def wheelbase(self) -> float:
        """Wheelbase l_f + l_r (m)."""
        return self.distance_front + self.distance_rear


NOMINAL = SingleTrackParameters(*(parameter.nominal for parameter in TABLE_8))


def understeer_gradient(parameters: SingleTrackParameters) -> float:
    """Returns K_us = m / (l_f + l_r) (l_r / c_f - l_f / c_r), rad per m/s^2 (Rajamani, Vehicle Dynamics and Control, Section 3.3).

    The steady steering angle on a curve is (wheelbase + K_us v^2) times its curvature; K_us < 0 is oversteer.
    """
    front = parameters.distance_rear / parameters.cornering_stiffness_front
    rear = parameters.distance_front / parameters.cornering_stiffness_rear
    return parameters.mass / parameters.wheelbase * (front - rear)
