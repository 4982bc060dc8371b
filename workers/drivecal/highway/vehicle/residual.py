"""Neural residual of the hybrid vehicle: its arrays, their file, and their layout for the kernels."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from drivecal.highway.vehicle.parameters import SingleTrackParameters
from drivecal.plugins.arrays import Array, DamagedArraysError, Expected, read_arrays, write_arrays
from drivecal.plugins.ports import Floats

FILE = Path(__file__).with_name("hybrid.npz")
KIND = "drivecal hybrid vehicle residual 1"
MOST_UNITS = 64
GRAVITY = 9.81
STEERING_HORIZON = 0.1
"""Seconds over which the steering rate input extrapolates, about the time that a tyre takes to build up its force."""

_EXPECTED = {
    "hidden": Expected("float64", (None, 15)),
    "output": Expected("float64", (None, 2)),
    "limits": Expected("float64", (6,)),
    "bounds": Expected("float64", (2,)),
    "speed": Expected("float64", (2,)),
    "baseline": Expected("float64", (6,)),
}


@dataclass(frozen=True, slots=True)
class Residual:
    """A network with one hidden layer of tanh units; `equations.residual_inputs` and `.residual_outputs` define its inputs and outputs.

    `hidden`: (units, 15), weights of the four lateral inputs, of the same times speed, of the same times longitudinal acceleration, of 1,
    speed and longitudinal acceleration.
    `output`: (units, 2), weights to lateral and yaw acceleration. `limits`: (6,), largest magnitude of each input in training. `bounds`:
    (2,), magnitudes at which the outputs are clipped. `speed`: (2,), centre and half width (m/s) of the speeds in training. `baseline`:
    (6,), single-track parameters of the vehicle in training, in the order of Table 8.
    """

    hidden: Floats
    output: Floats
    limits: Floats
    bounds: Floats
    speed: Floats
    baseline: Floats

    def __post_init__(self) -> None:
        if not 1 <= len(self.hidden) == len(self.output) <= MOST_UNITS:
            raise ValueError(
                f"{len(self.hidden)} hidden and {len(self.output)} output rows; give as many of both, 1 to {MOST_UNITS}"
            )
        if min(self.limits.min(), self.bounds.min(), self.speed.min(), self.baseline.min()) <= 0.0:
            raise ValueError("limits, bounds, speed and baseline must be positive")

    @property
    def arrays(self) -> Mapping[str, Array]:
        """Stored arrays by name."""
        return {name: getattr(self, name) for name in _EXPECTED}

    def write(self, path: Path) -> None:
        """Writes the arrays to a file."""
        write_arrays(path, KIND, self.arrays)

    def pack(self, parameters: SingleTrackParameters) -> Floats:
        """Returns the values that follow the coefficients of one vehicle in `plant`, shape (12 + 17 units,)."""
        p = parameters
        yaw = p.yaw_inertia * p.wheelbase / (p.mass * GRAVITY * p.distance_front * p.distance_rear)
        load = p.mass * GRAVITY * p.distance_rear / p.wheelbase
        scales = np.array([yaw, STEERING_HORIZON * p.cornering_stiffness_front / load])
        layers = np.hstack([self.hidden, self.output]).ravel()
        return np.concatenate([scales, self.speed, self.limits, self.bounds, layers])


def read(path: Path = FILE) -> Residual:
    """Reads a residual. Raises DamagedArraysError if the file is missing, damaged or of another kind."""
    arrays = read_arrays(path, KIND, _EXPECTED)
    try:
        return Residual(**arrays)
    except ValueError as error:
        raise DamagedArraysError(path.name, str(error)) from error


@cache
def shipped() -> Residual:
    """Returns the residual that drivecal is shipped with."""
    return read()
