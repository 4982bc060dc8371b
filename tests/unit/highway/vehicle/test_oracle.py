"""The single-track dynamics against `commonroad-vehicle-models`, an independent implementation integrated by another method.

Its `vehicle_dynamics_st` has the same structure with two differences. Cornering stiffness is normalised by vertical load, one coefficient
for both axles: axle stiffness = mu C_S F_z, so with equal loads it can only be neutral. And the loads move with longitudinal
acceleration a: F_zf = m (g l_r - a h) / L, F_zr = m (g l_f + a h) / L. Neither is in our model, whose stiffness is Table 8's. At a
constant acceleration both are constants, so a fictitious height h gives any pair of axle stiffness, Table 8's included:
mu C_S m (g l_r - a h) / L = c_f and mu C_S m (g l_f + a h) / L = c_r.
"""

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
from vehiclemodels.utils.vehicle_dynamics_ks_cog import vehicle_dynamics_ks_cog
from vehiclemodels.vehicle_dynamics_st import vehicle_dynamics_st

from drivecal.highway.vehicle import single_track
from drivecal.highway.vehicle.parameters import NOMINAL, SingleTrackParameters
from drivecal.plugins.ports import Floats

GRAVITY = 9.81
TAIL_HEAVY = SingleTrackParameters(2600.0, 90_000.0, 120_000.0, 2.0, 1.0, 4500.0)


def commonroad(p: SingleTrackParameters, acceleration: float) -> Any:
    """Their parameters for our vehicle at this acceleration."""
    theirs = parameters_vehicle2()
    theirs.m, theirs.I_z, theirs.a, theirs.b = p.mass, p.yaw_inertia, p.distance_front, p.distance_rear
    stiffness = p.cornering_stiffness_front + p.cornering_stiffness_rear
    # The sum of both conditions gives mu C_S, the front one then a h.
    theirs.tire.p_dy1 = 1.0
    theirs.tire.p_ky1 = -stiffness / (p.mass * GRAVITY)
    moved = GRAVITY * p.distance_rear - p.cornering_stiffness_front * p.wheelbase / (-theirs.tire.p_ky1 * p.mass)
    theirs.h_s = moved / acceleration
    return theirs


def steering_rates(rng: np.random.Generator, pieces: int) -> Floats:
    """Piecewise constant, back and forth, so that the steering angle stays small."""
    rates = rng.uniform(-0.02, 0.02, pieces)
    return np.asarray(rates - rates.mean())


def ours(p: SingleTrackParameters, speed: float, acceleration: float, rates: Floats, piece: float) -> Floats:
    state, plant = np.array([0.0, 0.0, 0.3, speed, 0.0, 0.0, 0.0, 0.0, 0.0]), single_track.pack_plant(p)
    rows = []
    for rate in rates:
        for _ in range(round(piece / single_track.STEP)):
            single_track.advance(state, rate, acceleration, plant, single_track.STEP)
        rows.append([state[0], state[1], state[8], state[3], state[2], state[5], state[4]])
    return np.array(rows)


def theirs(p: Any, speed: float, acceleration: float, rates: Floats, piece: float) -> Floats:
    state = np.array([0.0, 0.0, 0.0, speed, 0.3, 0.0, 0.0])
    rows = []
    for rate in rates:

        def field(_: float, x: Floats, rate: float = rate) -> list[float]:
            derivatives: list[float] = vehicle_dynamics_st(x, [rate, acceleration], p)
            return derivatives

        state = solve_ivp(field, (0.0, piece), state, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
        rows.append(state)
    return np.array(rows)


@pytest.mark.parametrize("acceleration", [1.0, -1.0])
@pytest.mark.parametrize(("vehicle", "speed"), [(NOMINAL, 20.0), (NOMINAL, 35.0), (TAIL_HEAVY, 20.0)])
def test_accelerated_vehicles_of_table_8_move_alike(vehicle: SingleTrackParameters, speed: float, acceleration: float) -> None:
    rates = steering_rates(np.random.default_rng(8), 20)
    expected = theirs(commonroad(vehicle, acceleration), speed, acceleration, rates, 0.4)
    assert ours(vehicle, speed, acceleration, rates, 0.4) == pytest.approx(expected, abs=2e-6)
    assert np.abs(expected[:, 1]).max() > 1.0  # it went somewhere


def test_slowly_it_moves_as_their_kinematic_model_for_small_steering_angles() -> None:
    """Theirs has tan(delta) and atan; at 0.05 rad the difference is below 0.1 %."""
    p = parameters_vehicle2()
    p.a, p.b = NOMINAL.distance_front, NOMINAL.distance_rear
    delta, speed, seconds = 0.05, 2.0, 8.0

    def field(_: float, x: Floats) -> list[float]:
        derivatives: list[float] = vehicle_dynamics_ks_cog(x, [0.0, 0.0], p)
        return derivatives

    expected = solve_ivp(field, (0.0, seconds), [0.0, 0.0, delta, speed, 0.0], rtol=1e-10, atol=1e-12).y[:, -1]
    wheelbase = NOMINAL.wheelbase
    settled = [0.0, 0.0, 0.0, speed, NOMINAL.distance_rear / wheelbase * delta, speed * delta / wheelbase, 0.0, 0.0, delta]
    state, plant = np.array(settled), single_track.pack_plant(NOMINAL)
    for _ in range(round(seconds / single_track.STEP)):
        single_track.advance(state, 0.0, 0.0, plant, single_track.STEP)
    assert [state[0], state[1], state[2]] == pytest.approx([expected[0], expected[1], expected[4]], rel=2e-3)
