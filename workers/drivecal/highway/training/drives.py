"""Free drives of the single track with the steering and speeds of recordings, but its own yaw rate, acceleration and position."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from drivecal.highway.training.manoeuvres import QUIET, STEP
from drivecal.highway.training.multibody import Recording
from drivecal.highway.vehicle import equations
from drivecal.highway.vehicle.parameters import SingleTrackParameters
from drivecal.highway.vehicle.residual import Residual
from drivecal.plugins.ports import Floats

SECONDS = 4.0
BEGIN, STEPS = round(QUIET / STEP), round(SECONDS / STEP)
EVERY = 10
"""Interval of the samples that a fit uses."""


@njit
def _drive(plant: Floats, inputs: Floats, start: Floats, out: Floats, extremes: Floats) -> int:
    """Drives freely with the steering and speeds of a recording; returns the number of steps outside the residual's range.

    `inputs`: (n + 1, 2), steering angle and speed; `start`: (3,), heading, side slip, yaw rate; `out`: (n, 3), yaw rate, lateral
    acceleration, lateral position; `extremes`: (8,), raised to the magnitudes of the residual's six inputs and two outputs, or (0,) to skip
    them.
    """
    state = np.zeros(10)
    state[2], state[3], state[4], state[5], state[8] = start[0], inputs[0, 1], start[1], start[2], inputs[0, 0]
    outside = 0
    for k in range(out.shape[0]):
        state[8], state[3] = inputs[k, 0], inputs[k, 1]
        rate, acceleration = (inputs[k + 1, 0] - inputs[k, 0]) / 0.01, (inputs[k + 1, 1] - inputs[k, 1]) / 0.01
        if extremes.shape[0] > 0:
            v, yaw_rate = state[3], state[5]
            slip, yaw = equations.plain_slip_and_yaw(v, state[4], yaw_rate, state[8], plant)
            lateral, speed, pull = equations.residual_inputs(v, yaw_rate, slip, yaw, rate, acceleration, plant)
            first, second = equations.residual_outputs(lateral, speed, pull, plant)
            for j, value in enumerate((*lateral, speed, pull, first, second)):
                extremes[j] = max(extremes[j], abs(value))
        outside += not equations.advance(state, rate, acceleration, plant, 0.01)
        out[k, 0], out[k, 1], out[k, 2] = state[5], state[7], state[1]
    return outside


@njit
def _drive_all(plant: Floats, inputs: Floats, starts: Floats, out: Floats, extremes: Floats) -> int:
    outside = 0
    for k in range(inputs.shape[0]):
        outside += _drive(plant, inputs[k], starts[k], out[k], extremes)
    return outside


@dataclass(frozen=True, slots=True)
class Drives:
    """Recordings as arrays, see `_drive`: `inputs` (m, n + 1, 2), `starts` (m, 3), `truth` (m, n, 3)."""

    inputs: Floats
    starts: Floats
    truth: Floats

    @classmethod
    def of(cls, recordings: Sequence[Recording]) -> Drives:
        """Cuts the recordings to `SECONDS` after the quiet second."""
        end = BEGIN + STEPS
        inputs = [np.column_stack([drive.steering_angle, drive.speed])[BEGIN : end + 1] for drive in recordings]
        starts = [[drive.heading[BEGIN], drive.side_slip[BEGIN], drive.yaw_rate[BEGIN]] for drive in recordings]
        truth = [
            np.column_stack([drive.yaw_rate, drive.lateral_acceleration, drive.y - drive.y[BEGIN]])[BEGIN + 1 : end + 1]
            for drive in recordings
        ]
        return cls(np.array(inputs), np.array(starts), np.array(truth))

    def outputs(self, plant: Floats) -> Floats:
        """Returns the motion of the vehicle with this `plant`, in the format of `truth`."""
        out = np.empty_like(self.truth)
        _drive_all(plant, self.inputs, self.starts, out, np.zeros(0))
        return out

    def derivatives(self, plant: Floats, places: Sequence[int], steps: Floats) -> Floats:
        """Returns derivatives of every `EVERY`-th sample of `outputs` with respect to entries of `plant`, by forward differences.

        Shape: (places, m, n / EVERY, 3).
        """
        slopes = np.empty((len(places), len(self.truth), STEPS // EVERY, 3))
        base = self.outputs(plant)[:, EVERY - 1 :: EVERY]
        for index, (place, step) in enumerate(zip(places, steps, strict=True)):
            changed = plant.copy()
            changed[place] += step
            slopes[index] = (self.outputs(changed)[:, EVERY - 1 :: EVERY] - base) / step
        return slopes

    def errors(self, plant: Floats) -> Floats:
        """Returns errors of all drives, shape (m, 3).

        R.m.s. over time of yaw rate (rad/s) and lateral acceleration (m/s^2), magnitude of lateral position after 4 s (m).
        """
        difference = self.outputs(plant) - self.truth
        over_time = np.sqrt((difference[:, :, :2] ** 2).mean(axis=1))
        return np.column_stack([over_time, np.abs(difference[:, -1, 2])])

    def extremes(self, plant: Floats) -> tuple[Floats, float]:
        """Returns the largest magnitudes of the residual's six inputs and two outputs, (8,), and the share of steps out of range."""
        extremes = np.zeros(8)
        outside = _drive_all(plant, self.inputs, self.starts, np.empty_like(self.truth), extremes)
        return extremes, outside / (len(self.inputs) * STEPS)


def hybrid_plant(parameters: SingleTrackParameters, residual: Residual) -> Floats:
    """Returns the `plant` of a hybrid vehicle."""
    return np.concatenate([equations.pack_plant(parameters), residual.pack(parameters)])
