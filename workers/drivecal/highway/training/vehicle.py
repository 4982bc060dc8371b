"""Training of the hybrid vehicle's residual on the multi-body model, and the tables of its model card.

The objective is the error of whole drives: the vehicle with its residual drives freely for four seconds with the steering and speeds of
the multi-body vehicle, but its own yaw rate, acceleration and position. (A fit of derivatives, state by state, would burden the network
with roll and suspension, whose state a single track does not have.) Least squares by trust region (SciPy), Jacobian by finite differences
in numba.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np
from numba import njit
from scipy.optimize import least_squares

from drivecal.highway.training import multibody
from drivecal.highway.training.multibody import QUIET, STEP, TRAINED, UNSEEN, Recording, draw
from drivecal.highway.training.tables import table
from drivecal.highway.vehicle import single_track
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
            slip, yaw = single_track.plain_slip_and_yaw(v, state[4], yaw_rate, state[8], plant)
            lateral, speed, pull = single_track.residual_inputs(v, yaw_rate, slip, yaw, rate, acceleration, plant)
            first, second = single_track.residual_outputs(lateral, speed, pull, plant)
            for j, value in enumerate((*lateral, speed, pull, first, second)):
                extremes[j] = max(extremes[j], abs(value))
        outside += not single_track.advance(state, rate, acceleration, plant, 0.01)
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
    return np.concatenate([single_track.pack_plant(parameters), residual.pack(parameters)])


SEED = 2
TRAINING, HELD_OUT = 128, 32
UNITS = 8
MOST_ACROSS = 5.0
FASTEST = 38.0
"""Limits in m/s^2 and m/s; manoeuvres beyond them are drawn again. At higher speed the multi-body car hardly keeps its course by itself (it
is nearly neutral), and a free drive depends more on the instant of turning than on the tyres. The built-in scenarios stay below 34 m/s."""
YAW_RATE_SCALE, ACCELERATION_SCALE, POSITION_SCALE = 0.005, 0.15, 0.5
"""Errors of equal weight: rad/s, m/s^2, m; about the remaining errors of the single track."""
DECAY = 0.05
"""Weight of the penalty on the network's weights."""
TYPICAL: Floats = np.array([*[10.0] * 12, *[1.0] * 3, 0.01, 0.01])
"""Typical weights of a unit's lateral inputs, other inputs and outputs; the search scales its steps by them."""
ITERATIONS = 40
BOUND = 1.25
"""Bound of the residual, relative to its largest magnitude in training."""


def record_all(kinds: Sequence[str], count: int, seed: int) -> list[Recording]:
    """Records `count` drives of the multi-body vehicle within `MOST_ACROSS` and `FASTEST`, alternating between kinds."""
    rng = np.random.default_rng(seed)
    wheelbase = multibody.converted().wheelbase
    recordings: list[Recording] = []
    while len(recordings) < count:
        recording = multibody.record(draw(kinds[len(recordings) % len(kinds)], rng, wheelbase))
        if recording is None:
            continue
        if np.abs(recording.lateral_acceleration).max() < MOST_ACROSS and recording.speed.max() < FASTEST:
            recordings.append(recording)
    return recordings


def training_drives() -> list[Recording]:
    """Returns the drives for training."""
    return record_all(TRAINED, TRAINING, SEED)


def held_out_drives() -> list[Recording]:
    """Returns other manoeuvres of the same kinds and of a kind that is not used in training."""
    return record_all((*TRAINED, UNSEEN), HELD_OUT + HELD_OUT // len(TRAINED), SEED + 1000)


_SCALES = np.array([YAW_RATE_SCALE, ACCELERATION_SCALE, POSITION_SCALE])


def _scaled(difference: Floats) -> Floats:
    return np.asarray(difference[:, EVERY - 1 :: EVERY] / _SCALES).ravel()


def fit_baseline(drives: Drives) -> SingleTrackParameters:
    """Fits the stiffness of the single track to the multi-body vehicle, as the baseline of the residual.

    Otherwise the network would learn to correct stiffness values of one vehicle, which the vehicles of Table 8 do not have.
    """
    start = multibody.converted()

    def parameters(logarithms: Floats) -> SingleTrackParameters:
        front, rear = np.exp(logarithms)
        return replace(start, cornering_stiffness_front=float(front), cornering_stiffness_rear=float(rear))

    def residuals(logarithms: Floats) -> Floats:
        return _scaled(drives.outputs(single_track.pack_plant(parameters(logarithms))) - drives.truth)

    begin = np.log([start.cornering_stiffness_front, start.cornering_stiffness_rear])
    return parameters(least_squares(residuals, begin, diff_step=[1e-4, 1e-4], x_scale=0.1).x)


def fit_residual(drives: Drives, baseline: SingleTrackParameters) -> Residual:
    """Fits the network, so that the hybrid vehicle follows the multi-body one over whole drives."""
    speeds = drives.inputs[:, :, 1]
    centre, reach = 0.5 * (speeds.max() + speeds.min()), 0.5 * (speeds.max() - speeds.min())
    generator = np.random.default_rng(SEED)
    free = Residual(
        hidden=generator.normal(0.0, 0.3, (UNITS, 15)) * TYPICAL[:15],
        output=generator.normal(0.0, 0.3, (UNITS, 2)) * TYPICAL[15:],
        limits=np.full(6, 1e6),
        bounds=np.full(2, 1e6),
        speed=np.array([centre, reach]),
        baseline=np.array(astuple(baseline)),
    )
    plant = hybrid_plant(baseline, free)
    places = range(single_track.LAYERS, len(plant))
    begin = plant[single_track.LAYERS :]
    typical = np.tile(TYPICAL, UNITS)

    def plant_of(weights: Floats) -> Floats:
        return np.concatenate([plant[: single_track.LAYERS], weights])

    def residuals(weights: Floats) -> Floats:
        return np.concatenate([_scaled(drives.outputs(plant_of(weights)) - drives.truth), DECAY * weights / typical])

    def jacobian(weights: Floats) -> Floats:
        slopes = drives.derivatives(plant_of(weights), places, 1e-6 * typical) / _SCALES
        return np.vstack([slopes.reshape(len(places), -1).T, np.diag(DECAY / typical)])

    optimum = least_squares(residuals, begin, jac=jacobian, x_scale=typical, max_nfev=ITERATIONS)
    layers = optimum.x.reshape(UNITS, 17)
    free = replace(free, hidden=layers[:, :15].copy(), output=layers[:, 15:].copy())
    extremes, _ = drives.extremes(hybrid_plant(baseline, free))
    return replace(free, limits=extremes[:6], bounds=BOUND * extremes[6:])


ERRORS, RANGE = "errors on held-out manoeuvres", "training range"
INPUTS = (
    ("lateral acceleration of the single track / g", "1"),
    ("its yaw acceleration, scaled", "1"),
    ("centripetal less lateral acceleration / g", "1"),
    ("front axle force gained in 0.1 s of steering / its load", "1"),
    ("speed", "m/s"),
    ("longitudinal acceleration / g", "1"),
)


def _root_mean_square(errors: Floats) -> Floats:
    return np.asarray(np.sqrt((errors**2).mean(axis=0)))


def errors(residual: Residual, kinds: Sequence[str], drives: Drives) -> dict[str, Floats]:
    """Returns r.m.s. errors by vehicle (`plain`, `hybrid`, `converted`) and, for the first two, by `plain kind` and `hybrid kind`.

    Each of shape (3,): yaw rate (rad/s), lateral acceleration (m/s^2), lateral position after 4 s (m).
    """
    kind_of_drive = np.array(kinds)
    baseline = SingleTrackParameters(*residual.baseline.tolist())
    means = {"converted": _root_mean_square(drives.errors(single_track.pack_plant(multibody.converted())))}
    plants = {"plain": single_track.pack_plant(baseline), "hybrid": hybrid_plant(baseline, residual)}
    for name, plant in plants.items():
        by_drive = drives.errors(plant)
        means[name] = _root_mean_square(by_drive)
        means |= {f"{name} {kind}": _root_mean_square(by_drive[kind_of_drive == kind]) for kind in dict.fromkeys(kinds)}
    return means


def error_table(residual: Residual, kinds: Sequence[str], drives: Drives) -> str:
    """Returns the table of errors of the plain and the hybrid vehicle, by kind of manoeuvre."""
    means = errors(residual, kinds, drives)

    def row(label: str, count: int, plain: Floats, hybrid: Floats) -> list[str]:
        cells = [
            f"{a * scale:.{digits}f} to {b * scale:.{digits}f}"
            for a, b, scale, digits in zip(plain, hybrid, (1e3, 1, 1), (2, 3, 2), strict=True)
        ]
        return [label, str(count), *cells]

    rows = [row(kind, kinds.count(kind), means[f"plain {kind}"], means[f"hybrid {kind}"]) for kind in dict.fromkeys(kinds)]
    rows.append(row("all", len(kinds), means["plain"], means["hybrid"]))
    rows.append(["hybrid / plain", "", *(f"{value:.2f}" for value in means["hybrid"] / means["plain"])])
    mrad, across, aside = means["converted"] * (1e3, 1.0, 1.0)
    rows.append(["single track as the package converts it", str(len(kinds)), f"{mrad:.2f}", f"{across:.3f}", f"{aside:.2f}"])
    return table(
        ["plain to hybrid", "manoeuvres", "yaw rate, mrad/s", "lateral acceleration, m/s^2", "lateral position after 4 s, m"],
        rows,
    )


def range_table(residual: Residual) -> str:
    """Returns the table of the residual's training range; outside of it the vehicle is the plain one."""
    centre, reach = residual.speed
    rows = []
    for (name, unit), limit in zip(INPUTS, residual.limits, strict=True):
        bounds = (
            f"{centre - limit * reach:.1f} to {centre + limit * reach:.1f}"
            if unit == "m/s"
            else f"up to {limit:.3f} either way"
        )
        rows.append([name, unit, bounds])
    rows.append(["added lateral acceleration / g", "1", f"cut at {residual.bounds[0]:.3f}"])
    rows.append(["added yaw acceleration, scaled", "1", f"cut at {residual.bounds[1]:.3f}"])
    return table(["quantity", "unit", "in training"], rows)
