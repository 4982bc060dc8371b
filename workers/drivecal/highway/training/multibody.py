"""The multi-body vehicle behind the residual: `vehicle_dynamics_mb` of commonroad-vehicle-models, vehicle 2 (a BMW 320i).

Althoff and Würsching, CommonRoad: Vehicle Models, 2020, Chapter 10: 29 states, roll, pitch, suspension, magic-formula tyres.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from vehiclemodels.init_mb import init_mb
from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb

from drivecal.highway.training.manoeuvres import STEP, OpenLoopManoeuvre
from drivecal.highway.vehicle.parameters import SingleTrackParameters
from drivecal.plugins.ports import Floats

GRAVITY = 9.81
RELATIVE_TOLERANCE, ABSOLUTE_TOLERANCE = 1e-7, 1e-8
MOST_CALLS = 200_000
"""Largest number of evaluations of the equations of motion per manoeuvre; 8,000 are usual."""
_VX, _YAW, _YAW_RATE, _VY = 3, 4, 5, 10


@dataclass(frozen=True, slots=True)
class Recording:
    """Motion of the multi-body vehicle in a manoeuvre, every 0.01 s; arrays of shape (n,), SI units.

    `acceleration`: derivative of the speed over ground; `lateral_acceleration`: of the centre of mass, perpendicular to its course.
    """

    manoeuvre: OpenLoopManoeuvre
    steering_angle: Floats
    speed: Floats
    acceleration: Floats
    y: Floats
    heading: Floats
    side_slip: Floats
    yaw_rate: Floats
    lateral_acceleration: Floats


def _plain(parameters: Any) -> Any:
    """Converts parameters to plain attributes; access to the package's own containers takes most of the time."""
    fields = parameters if isinstance(parameters, Mapping) else vars(parameters)
    return SimpleNamespace(
        **{name: value if value is None or isinstance(value, int | float) else _plain(value) for name, value in fields.items()}
    )


@cache
def vehicle() -> Any:
    """Returns the parameters of vehicle 2."""
    return _plain(parameters_vehicle2())


def converted() -> SingleTrackParameters:
    """Returns vehicle 2 as a single track, converted as in the package.

    The stiffness is that of pure side slip at zero slip, proportional to the static load.
    """
    p = vehicle()
    per_load, wheelbase = -p.tire.p_ky1 * p.m * GRAVITY, p.a + p.b
    return SingleTrackParameters(p.m, per_load * p.b / wheelbase, per_load * p.a / wheelbase, p.a, p.b, p.I_z)


class _ChatteringError(Exception):
    """The integration chatters: the tyres' lateral shift jumps when camber changes its sign, and steps near that point become tiny."""


def record(manoeuvre: OpenLoopManoeuvre) -> Recording | None:
    """Drives a manoeuvre; returns None if the integration takes too long. Raises ArithmeticError if it fails."""
    p = vehicle()
    steering, pull = manoeuvre.steering, manoeuvre.pull

    calls = 0

    def derivatives(time: float, state: Any) -> list[float]:
        nonlocal calls
        calls += 1
        if calls > MOST_CALLS:
            raise _ChatteringError
        inputs = [float(steering(time, 1)), float(np.interp(time, manoeuvre.times, pull))]
        rates: list[float] = vehicle_dynamics_mb([float(value) for value in state], inputs, p)
        return rates

    start = init_mb([0.0, 0.0, 0.0, manoeuvre.speed, 0.0, 0.0, 0.0], p)
    try:
        solution = solve_ivp(
            derivatives,
            (0.0, manoeuvre.times[-1]),
            start,
            method="LSODA",
            t_eval=manoeuvre.times,
            rtol=RELATIVE_TOLERANCE,
            atol=ABSOLUTE_TOLERANCE,
            max_step=10.0 * STEP,
        )
    except _ChatteringError:
        return None
    if not solution.success:
        raise ArithmeticError(f"the multi-body model cannot be integrated: {solution.message}")
    states, calls = solution.y, 0
    rates = np.array([derivatives(time, state) for time, state in zip(manoeuvre.times, states.T, strict=True)]).T
    forward, sideways = states[_VX], states[_VY]
    speed = np.hypot(forward, sideways)
    slip_rate = (rates[_VY] * forward - sideways * rates[_VX]) / speed**2
    return Recording(
        manoeuvre=manoeuvre,
        steering_angle=states[2],
        speed=speed,
        acceleration=(forward * rates[_VX] + sideways * rates[_VY]) / speed,
        y=states[1],
        heading=states[_YAW],
        side_slip=np.arctan2(sideways, forward),
        yaw_rate=states[_YAW_RATE],
        lateral_acceleration=speed * (slip_rate + states[_YAW_RATE]),
    )
