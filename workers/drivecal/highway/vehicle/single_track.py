"""Compiled motion of the vehicle: equations of motion, Runge-Kutta step, and the plant with its actuators. Arrays are packed:

`state`, shape (9,): x, y, heading psi, speed v, side-slip angle beta, yaw rate, longitudinal acceleration, lateral acceleration, steering
angle of the front wheels. `plant`, shape (8,): the coefficients of `pack_plant`. The position is the centre of mass, whose course over
ground is psi + beta.

The `plant` of a hybrid vehicle continues with the result of `residual.pack`. Its `state` has shape (10,): the last entry
counts the steps that began outside the training range of the residual.
"""

import math

import numpy as np

from drivecal.highway.compilation import compiled_with
from drivecal.highway.vehicle.parameters import SingleTrackParameters
from drivecal.plugins.ports import Floats

STEP = 0.01
"""Integration step, s."""

KINEMATIC_BELOW = 3.0
DYNAMIC_ABOVE = 5.0
"""Speeds (m/s) between which the kinematic and the dynamic model are blended. The stiffest corner of Table 8 has an eigenvalue of about
-540/v; at 3 m/s times 0.01 s that is -1.8, inside Runge-Kutta's stability interval of -2.78."""
SETTLING_TIME = 0.1
"""Time constant (s) with which side slip and yaw rate approach the kinematic relations."""

ADHESION_LIMIT = 9.81
"""Lateral acceleration (m/s^2) that exceeds the grip of road tyres, so that the linear model is no longer valid.

A spin exceeds this limit first: steady side slip per acceleration is at most m l_f / (c_r L) = 0.0144 rad per m/s^2 in Table 8's box, so
that the limit is reached before side slip reaches 0.15 rad."""

STEERING_LAG = 0.08
STEERING_RATE_LIMIT = 0.4
STEERING_LIMIT = 0.5
"""Steering actuator: first-order lag (s), largest rate (rad/s at the wheels, from CommonRoad's parameter sets), largest angle (rad)."""
DRIVE_LAG = 0.15
LOWEST_ACCELERATION, HIGHEST_ACCELERATION = -9.0, 4.0
"""Drive and brakes: first-order lag (s), smallest and largest acceleration (m/s^2)."""

GRAVITY = 9.81
COEFFICIENTS = 8
"""Number of coefficients of the single-track model in `plant`; the residual's values follow, if there are any."""
YAW_SCALE, STEERING_SCALE, SPEED_CENTRE, SPEED_REACH, LIMITS, BOUNDS, LAYERS = 8, 9, 10, 11, 12, 18, 20
"""Positions of the residual's values in `plant`: two scales that depend on the vehicle, the range, the bounds, the layers."""
N_LATERAL, N_INPUTS, N_OUTPUTS = 4, 15, 2
FADE = 0.1
"""Share of the range over which the residual fades out beyond the range's end, to avoid a jump."""

_STEERING_SHARE = 1.0 - math.exp(-STEP / STEERING_LAG)
_DRIVE_SHARE = 1.0 - math.exp(-STEP / DRIVE_LAG)


def pack_plant(parameters: SingleTrackParameters) -> Floats:
    """Returns the coefficients of the equations of motion, shape (8,), see `_slip_and_yaw`."""
    front, rear = parameters.cornering_stiffness_front, parameters.cornering_stiffness_rear
    ahead, behind = parameters.distance_front, parameters.distance_rear
    return np.array(
        [
            (front + rear) / parameters.mass,
            (behind * rear - ahead * front) / parameters.mass,
            front / parameters.mass,
            (behind * rear - ahead * front) / parameters.yaw_inertia,
            (ahead * ahead * front + behind * behind * rear) / parameters.yaw_inertia,
            ahead * front / parameters.yaw_inertia,
            parameters.wheelbase,
            behind / parameters.wheelbase,
        ]
    )


@compiled_with()
def _within(value: float, lowest: float, highest: float) -> float:
    """Clips `value` to the limits; NaN stays NaN, so that a faulty trajectory is detected."""
    if value > highest:
        return highest
    if value < lowest:
        return lowest
    return value


@compiled_with()
def plain_slip_and_yaw(v: float, beta: float, yaw_rate: float, delta: float, plant: Floats) -> tuple[float, float]:
    """Returns the derivatives of side-slip angle and yaw rate of the linear dynamic model (Rajamani, Section 2.3).

    Tyre forces are c_f (delta - beta - l_f r / v) and c_r (-beta + l_r r / v).
    """
    beta_rate = (plant[2] * delta - plant[0] * beta) / v + (plant[1] / (v * v) - 1.0) * yaw_rate
    return beta_rate, plant[3] * beta - plant[4] * yaw_rate / v + plant[5] * delta


@compiled_with()
def _within_range(lateral: tuple[float, float, float, float], speed: float, pull: float, plant: Floats) -> float:
    """Returns the weight of the residual: 1 inside its training range, 0 beyond `FADE` of the range outside."""
    largest = max(abs(speed) / plant[LIMITS + 4], abs(pull) / plant[LIMITS + 5])
    for k in range(N_LATERAL):
        largest = max(largest, abs(lateral[k]) / plant[LIMITS + k])
    return min(1.0, max(0.0, (1.0 + FADE - largest) / FADE))


@compiled_with()
def residual_inputs(
    v: float, yaw_rate: float, beta_rate: float, yaw_acceleration: float, delta_rate: float, acceleration: float, plant: Floats
) -> tuple[tuple[float, float, float, float], float, float]:
    """Returns the dimensionless inputs of the residual, from the single-track model's own derivatives.

    Lateral: lateral acceleration over g; yaw acceleration over that of forces of each axle's load (l_f l_r m g / (L theta_z)); centripetal
    less lateral acceleration over g; force over load that the front axle gains in 0.1 s of this steering rate. Then speed (centred, over
    its half width) and longitudinal acceleration over g. They are comparable for all vehicles in Table 8's box.
    """
    lateral = v * (beta_rate + yaw_rate) / GRAVITY
    yaw, steering = yaw_acceleration * plant[YAW_SCALE], delta_rate * plant[STEERING_SCALE]
    speed = (v - plant[SPEED_CENTRE]) / plant[SPEED_REACH]
    return (lateral, yaw, v * yaw_rate / GRAVITY - lateral, steering), speed, acceleration / GRAVITY


@compiled_with()
def residual_outputs(
    lateral: tuple[float, float, float, float], speed: float, pull: float, plant: Floats
) -> tuple[float, float]:
    """Returns the network's additions to lateral acceleration over g and to yaw acceleration (scaled like its inputs).

    One hidden layer of tanh over `lateral` times (1, speed, pull) and over (1, speed, pull), minus the same with `lateral` mirrored. The
    function is odd: mirrored manoeuvres stay mirrored, straight driving stays straight. Fixed order of summation; clipped to the bounds.
    """
    first, second = 0.0, 0.0
    width = N_INPUTS + N_OUTPUTS
    for unit in range((plant.shape[0] - LAYERS) // width):
        at = LAYERS + unit * width
        odd = 0.0
        for k in range(N_LATERAL):
            odd += (plant[at + k] + plant[at + 4 + k] * speed + plant[at + 8 + k] * pull) * lateral[k]
        even = plant[at + 12] + plant[at + 13] * speed + plant[at + 14] * pull
        active = math.tanh(even + odd) - math.tanh(even - odd)
        first += plant[at + N_INPUTS] * active
        second += plant[at + N_INPUTS + 1] * active
    share = _within_range(lateral, speed, pull, plant)
    return share * _within(first, -plant[BOUNDS], plant[BOUNDS]), share * _within(second, -plant[BOUNDS + 1], plant[BOUNDS + 1])


@compiled_with()
def residual_accelerations(state: Floats, delta_rate: float, acceleration: float, plant: Floats) -> tuple[float, float, bool]:
    """Returns the residual's lateral (m/s^2) and yaw acceleration (rad/s^2), 0 without residual, and whether it is within its range."""
    v, yaw_rate = state[3], state[5]
    if plant.shape[0] <= COEFFICIENTS or not v >= DYNAMIC_ABOVE:
        return 0.0, 0.0, False
    beta_rate, yaw_acceleration = plain_slip_and_yaw(v, state[4], yaw_rate, state[8], plant)
    lateral, speed, pull = residual_inputs(v, yaw_rate, beta_rate, yaw_acceleration, delta_rate, acceleration, plant)
    more_lateral, more_yaw = residual_outputs(lateral, speed, pull, plant)
    within = _within_range(lateral, speed, pull, plant) == 1.0
    return GRAVITY * more_lateral, more_yaw / plant[YAW_SCALE], within


@compiled_with()
def _slip_and_yaw(
    v: float, beta: float, yaw_rate: float, delta: float, delta_rate: float, acceleration: float, plant: Floats,
    more_lateral: float, more_yaw: float,
) -> tuple[float, float]:  # fmt: skip
    """Returns the derivatives of side-slip angle and yaw rate.

    The dynamic model plus the residual's accelerations. Below `DYNAMIC_ABOVE` it is blended with the kinematic relations
    beta = l_r / L delta and r = v delta / L, which both variables follow and approach.
    """
    if v >= DYNAMIC_ABOVE:
        beta_rate, yaw_acceleration = plain_slip_and_yaw(v, beta, yaw_rate, delta, plant)
        return beta_rate + more_lateral / v, yaw_acceleration + more_yaw
    share = max(0.0, (v - KINEMATIC_BELOW) / (DYNAMIC_ABOVE - KINEMATIC_BELOW))
    share = share * share * (3.0 - 2.0 * share)
    u = max(v, KINEMATIC_BELOW)
    beta_dynamic, yaw_dynamic = plain_slip_and_yaw(u, beta, yaw_rate, delta, plant)
    beta_kinematic = plant[7] * delta_rate + (plant[7] * delta - beta) / SETTLING_TIME
    yaw_kinematic = (acceleration * delta + v * delta_rate) / plant[6] + (v * delta / plant[6] - yaw_rate) / SETTLING_TIME
    beta_rate = share * beta_dynamic + (1.0 - share) * beta_kinematic
    return beta_rate, share * yaw_dynamic + (1.0 - share) * yaw_kinematic


@compiled_with()
def advance(state: Floats, delta_rate: float, acceleration: float, plant: Floats, step: float) -> bool:
    """Overwrites `state` by one classical Runge-Kutta step (order 4) of `step` seconds at constant steering rate and acceleration.

    The residual of a hybrid vehicle is evaluated at the begin of the step. Returns whether it was within its range.
    """
    more, turn, within = residual_accelerations(state, delta_rate, acceleration, plant)
    x, y, psi, v, beta, yaw, delta = state[0], state[1], state[2], state[3], state[4], state[5], state[8]
    half = 0.5 * step
    course = psi + beta
    x1, y1 = v * math.cos(course), v * math.sin(course)
    b1, r1 = _slip_and_yaw(v, beta, yaw, delta, delta_rate, acceleration, plant, more, turn)
    v2, d2 = v + half * acceleration, delta + half * delta_rate
    beta2, yaw2 = beta + half * b1, yaw + half * r1
    course = psi + half * yaw + beta2
    x2, y2 = v2 * math.cos(course), v2 * math.sin(course)
    b2, r2 = _slip_and_yaw(v2, beta2, yaw2, d2, delta_rate, acceleration, plant, more, turn)
    beta3, yaw3 = beta + half * b2, yaw + half * r2
    course = psi + half * yaw2 + beta3
    x3, y3 = v2 * math.cos(course), v2 * math.sin(course)
    b3, r3 = _slip_and_yaw(v2, beta3, yaw3, d2, delta_rate, acceleration, plant, more, turn)
    v4, d4 = v + step * acceleration, delta + step * delta_rate
    beta4, yaw4 = beta + step * b3, yaw + step * r3
    course = psi + step * yaw3 + beta4
    x4, y4 = v4 * math.cos(course), v4 * math.sin(course)
    b4, r4 = _slip_and_yaw(v4, beta4, yaw4, d4, delta_rate, acceleration, plant, more, turn)
    sixth = step / 6.0
    state[0] = x + sixth * (x1 + 2.0 * x2 + 2.0 * x3 + x4)
    state[1] = y + sixth * (y1 + 2.0 * y2 + 2.0 * y3 + y4)
    state[2] = psi + sixth * (yaw + 2.0 * yaw2 + 2.0 * yaw3 + yaw4)
    state[3] = v4
    state[4] = beta + sixth * (b1 + 2.0 * b2 + 2.0 * b3 + b4)
    state[5] = yaw + sixth * (r1 + 2.0 * r2 + 2.0 * r3 + r4)
    state[8] = d4
    beta_rate, _ = _slip_and_yaw(v4, state[4], state[5], d4, delta_rate, acceleration, plant, more, turn)
    state[6] = acceleration
    state[7] = v4 * (beta_rate + state[5])
    return within


@compiled_with()
def move(state: Floats, before: Floats, steering: float, acceleration: float, plant: Floats) -> bool:
    """Moves the plant by `STEP` towards a steering angle (rad) and an acceleration (m/s^2), through its actuators.

    Returns whether the vehicle is stable; if not, `state` keeps its last valid values. `before`: scratch memory like `state`.
    """
    target = _within(steering, -STEERING_LIMIT, STEERING_LIMIT)
    rate = _within((target - state[8]) * _STEERING_SHARE / STEP, -STEERING_RATE_LIMIT, STEERING_RATE_LIMIT)
    target = _within(acceleration, LOWEST_ACCELERATION, HIGHEST_ACCELERATION)
    reached: float = state[6] + (target - state[6]) * _DRIVE_SHARE
    standstill: float = -state[3] / STEP
    if reached < standstill:
        reached = standstill  # brakes hold a standing vehicle without pushing it
    before[:] = state
    within = advance(state, rate, reached, plant, STEP)
    # Comparisons with NaN are false, so that a state that is not finite is unstable, too.
    if not (abs(state[7]) <= ADHESION_LIMIT and abs(state[0]) + abs(state[1]) + abs(state[3]) < 1e9):
        state[:] = before
        return False
    if not within and plant.shape[0] > COEFFICIENTS:
        state[9] += 1.0
    return True
