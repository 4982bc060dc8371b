"""The multi-body vehicle behind the residual: `vehicle_dynamics_mb` of commonroad-vehicle-models, vehicle 2 (a BMW 320i).

Althoff and Würsching, CommonRoad: Vehicle Models, 2020, Chapter 10: 29 states, roll, pitch, suspension, magic-formula tyres. It drives
random open-loop manoeuvres, i.e. steering and acceleration over time.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from vehiclemodels.init_mb import init_mb
from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb

from drivecal.highway.vehicle.parameters import SingleTrackParameters
from drivecal.plugins.ports import Floats

STEP = 0.01
QUIET = 1.0
"""Seconds of straight driving at the begin, while the suspension of the multi-body model settles. They are dropped."""
DURATION = 5.0
TRAINED = ("lane change", "curve", "slalom", "corrections")
UNSEEN = "swerve"
"""A kind that is not used in training: aside and back at once, as in a double lane change."""


@dataclass(frozen=True, slots=True)
class OpenLoopManoeuvre:
    """Inputs of a vehicle over time.

    `steering`: front wheel angle (rad), twice differentiable; `pull`: desired longitudinal acceleration (m/s^2), shape (n,).
    """

    kind: str
    speed: float
    times: Floats
    steering: Callable[..., Floats]
    pull: Floats


def smooth(u: Floats) -> Floats:
    """Rises from 0 to 1, with two derivatives that vanish at both ends."""
    u = np.clip(u, 0.0, 1.0)
    return u**3 * (10.0 - 15.0 * u + 6.0 * u * u)


def _shape(kind: str, time: Floats, rng: np.random.Generator) -> Floats:
    """Returns steering of magnitude 1 over the time since the quiet second, shape (n,)."""
    if kind == "lane change":
        takes = rng.uniform(2.5, 6.0)
        window = smooth(time / (0.15 * takes)) * smooth((takes - time) / (0.15 * takes))
        return np.asarray(np.sin(2.0 * np.pi * time / takes) * window)
    if kind == "curve":
        entry, lasts, leaves = rng.uniform(0.8, 3.0), rng.uniform(1.0, 4.0), rng.integers(0, 2)
        return smooth(time / entry) - smooth((time - entry - lasts) / entry) * leaves
    if kind == "slalom":
        return np.sin(2.0 * np.pi * rng.uniform(0.1, 0.6) * time) * smooth(time / 0.8)
    if kind == UNSEEN:
        takes = rng.uniform(1.8, 2.4)
        there = np.sin(2.0 * np.pi * time / takes) * np.where(time < takes, 1.0, 0.0)
        back = np.sin(2.0 * np.pi * (time - takes) / takes) * np.where((time >= takes) & (time < 2.0 * takes), 1.0, 0.0)
        return (there - back) * smooth(time / 0.3) * smooth((2.0 * takes - time) / 0.3)
    frequency, phase = rng.uniform(0.05, 1.0, 5), rng.uniform(0.0, 2.0 * np.pi, 5)
    waves = np.sin(2.0 * np.pi * np.outer(time, frequency) + phase) @ (rng.normal(size=5) / np.sqrt(frequency))
    waves = waves * smooth(time)
    return np.asarray(waves / np.abs(waves).max() * rng.uniform(0.2, 0.8))


def draw(kind: str, rng: np.random.Generator, wheelbase: float) -> OpenLoopManoeuvre:
    """Draws a manoeuvre of this kind: 14 to 36 m/s, lateral acceleration up to 4.6 m/s^2 (of a neutral vehicle).

    Half of all manoeuvres brake or accelerate.
    """
    speed = rng.uniform(14.0, 36.0)
    across = rng.uniform(0.3, 4.6) * rng.choice([-1.0, 1.0])
    times = np.round(np.arange(round((QUIET + DURATION - 1.0) / STEP) + 1) * STEP, 9)
    since = np.maximum(times - QUIET, 0.0)
    angle = _shape(kind, since, rng) * across * wheelbase / speed**2
    pull = rng.uniform(-3.2, 2.6) if rng.random() < 0.5 else 0.0
    begins = rng.uniform(0.0, 1.5)
    return OpenLoopManoeuvre(kind, speed, times, CubicSpline(times, angle), pull * smooth((since - begins) / 0.6))


GRAVITY = 9.81
RELATIVE_TOLERANCE, ABSOLUTE_TOLERANCE = 1e-7, 1e-8
MOST_CALLS = 200_000
"""Largest number of evaluations of the equations of motion per manoeuvre; 8,000 are usual."""
_VX, _YAW, _YAW_RATE, _VY = 3, 4, 5, 10


@dataclass(frozen=True, slots=True)
class Recording:
    """Motion of the multi-body vehicle in a manoeuvre, every 0.01 s; arrays of shape (n,), SI units.

    `acceleration`: derivative of the speed over ground; `lateral_acceleration` is the centre of mass's, perpendicular to its course.
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
