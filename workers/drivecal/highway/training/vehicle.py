"""Training of the hybrid vehicle's residual on the multi-body model.

The objective is the error of whole drives: the vehicle with its residual drives freely for four seconds with the steering of the multi-body
vehicle. (A fit of derivatives, state by state, would burden the network with roll and suspension, whose state a single track does not
have.) Least squares by trust region (SciPy), Jacobian by finite differences in numba.
"""

from collections.abc import Sequence
from dataclasses import astuple, replace

import numpy as np
from scipy.optimize import least_squares

from drivecal.highway.training import multibody
from drivecal.highway.training.drives import EVERY, Drives, hybrid_plant
from drivecal.highway.training.manoeuvres import TRAINED, UNSEEN, draw
from drivecal.highway.training.multibody import Recording
from drivecal.highway.vehicle import equations
from drivecal.highway.vehicle.parameters import SingleTrackParameters
from drivecal.highway.vehicle.residual import Residual
from drivecal.plugins.ports import Floats

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
"""Typical weights of a unit's lateral inputs, other inputs and outputs, by which the search scales its steps."""
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
        return _scaled(drives.outputs(equations.pack_plant(parameters(logarithms))) - drives.truth)

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
    places = range(equations.LAYERS, len(plant))
    begin = plant[equations.LAYERS :]
    typical = np.tile(TYPICAL, UNITS)

    def plant_of(weights: Floats) -> Floats:
        return np.concatenate([plant[: equations.LAYERS], weights])

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
