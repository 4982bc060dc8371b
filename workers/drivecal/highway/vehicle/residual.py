"""Neural residual of the hybrid vehicle: its arrays, their file, and their layout for the kernels."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path

import numpy as np

from drivecal.highway.vehicle.parameters import SingleTrackParameters
from drivecal.plugins.arrays import Array, DamagedArraysError, read_arrays
from drivecal.plugins.ports import Floats

FILE = Path(__file__).with_name("hybrid.npz")
MOST_UNITS = 64
GRAVITY = 9.81
STEERING_HORIZON = 0.1
"""Seconds over which the steering rate input extrapolates, about the time that a tyre takes to build up its force."""


@dataclass(frozen=True, slots=True)
class Residual:
    """A network with one hidden layer of tanh units; `single_track.residual_inputs` and `.residual_outputs` define its inputs and outputs.

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
            raise ValueError(f"{len(self.hidden)} hidden and {len(self.output)} output rows; give 1 to {MOST_UNITS} of both")
        shapes = [
            self.hidden.shape[1:],
            self.output.shape[1:],
            *(array.shape for array in (self.limits, self.bounds, self.speed)),
        ]
        if [*shapes, self.baseline.shape] != [(15,), (2,), (6,), (2,), (2,), (6,)]:
            raise ValueError("an array has another shape")
        if min(self.limits.min(), self.bounds.min(), self.speed.min(), self.baseline.min()) <= 0.0:
            raise ValueError("limits, bounds, speed and baseline must be positive")

    @property
    def arrays(self) -> Mapping[str, Array]:
        """Stored arrays by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def write(self, path: Path) -> None:
        """Writes the arrays to a file."""
        np.savez_compressed(path, allow_pickle=False, **self.arrays)

    def pack(self, parameters: SingleTrackParameters) -> Floats:
        """Returns the values that follow the coefficients of one vehicle in `plant`, shape (12 + 17 units,)."""
        p = parameters
        yaw = p.yaw_inertia * p.wheelbase / (p.mass * GRAVITY * p.distance_front * p.distance_rear)
        load = p.mass * GRAVITY * p.distance_rear / p.wheelbase
        scales = np.array([yaw, STEERING_HORIZON * p.cornering_stiffness_front / load])
        layers = np.hstack([self.hidden, self.output]).ravel()
        return np.concatenate([scales, self.speed, self.limits, self.bounds, layers])


@cache
def shipped(path: Path = FILE) -> Residual:
    """Returns the residual in a file, by default the shipped one. Raises DamagedArraysError if it is missing or damaged."""
    arrays = read_arrays(path, [field.name for field in fields(Residual)])
    try:
        return Residual(**arrays)
    except ValueError as error:
        raise DamagedArraysError(path.name, str(error)) from error
