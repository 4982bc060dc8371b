"""Compiled trackers: loops over steps of 0.01 s that steer the vehicle along trajectories and paths, or by commands.

`state` and `plant`: as in `single_track`. `trajectory`, shape (n, 7): as from `Planner.plan`.
"""

import math

import numpy as np

from drivecal.highway.compilation import compiled_with
from drivecal.highway.vehicle import single_track
from drivecal.highway.vehicle.parameters import SingleTrackParameters, understeer_gradient
from drivecal.highway.vehicle.single_track import DRIVE_LAG, DYNAMIC_ABOVE, STEERING_LAG, STEP, move
from drivecal.plugins.ports import Floats

compiled = compiled_with(single_track)

FOLLOWED, UNSTABLE, TOO_SHORT = 0, 1, 2
"""Results of `drive`."""
STEERING, CURVATURE, PATH, TRAJECTORY = 0, 1, 2, 3
"""Inputs that `drive` steers by: an angle of the front wheels, a curvature, a path that it keeps, or a trajectory."""

LATERAL_STIFFNESS, LATERAL_DAMPING = 1.0, 2.0
YAW_RATE_GAIN = 0.75
"""Lateral feedback: 1/s^2 on the lateral error, 1/s on its derivative, and the share of the yaw rate's error, which damps oversteering
vehicles. The first two are slow compared with the vehicle and alone would give a double pole at -1/s. With these values every corner of
Table 8's box that is stable without a controller is stable with it from 10 to 40 m/s."""
SPEED_GAIN = 1.0
POSITION_GAIN = 0.25
"""Longitudinal feedback: 1/s on the speed error, 1/s^2 on the position error (0.5 rad/s, critically damped)."""


def pack_controller(nominal: SingleTrackParameters) -> Floats:
    """Returns the vehicle data of the controller, shape (6,), see `_steering_rate`.

    Wheelbase, understeer gradient, side-slip gradient (rad per m/s^2), distance of the rear axle. For the yaw and side-slip dynamics: v
    times the damping (m/s^2), and v^2 times the determinant over the steady steering angle per curvature (m/s^4).
    """
    front, rear = nominal.cornering_stiffness_front, nominal.cornering_stiffness_rear
    ahead, behind = nominal.distance_front, nominal.distance_rear
    return np.array(
        [
            nominal.wheelbase,
            understeer_gradient(nominal),
            nominal.mass * ahead / (rear * nominal.wheelbase),
            behind,
            (front + rear) / nominal.mass + (ahead * ahead * front + behind * behind * rear) / nominal.yaw_inertia,
            front * rear * nominal.wheelbase / (nominal.mass * nominal.yaw_inertia),
        ]
    )


@compiled
def _wrapped(angle: float) -> float:
    """Returns the angle (rad) shifted by whole turns into [-pi, pi); angles in that range keep all their bits."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@compiled
def _sample(trajectory: Floats, column: int, time: float, spacing: float) -> float:
    """Returns one column of the trajectory at `time`, linear between rows, constant beyond the last row."""
    position = time / spacing
    row = int(position)
    last = trajectory.shape[0] - 1
    value: float = trajectory[min(row, last), column]
    if row < last:
        value += (position - row) * (trajectory[row + 1, column] - value)
    return value


@compiled
def _steering(
    state: Floats,
    controller: Floats,
    lateral_error: float,
    course_error: float,
    trajectory: Floats,
    time: float,
    spacing: float,
) -> float:
    """Returns the steering angle (rad) that the actuator shall reach.

    Feed-forward is the nominal vehicle's steady steering angle for the curvature due when the vehicle will have reacted: after the
    actuator's lag plus the delay between steering angle and lateral acceleration at low frequency. The yaw rate is compared with the one
    due now; it leads the course by the time that side slip takes to build up.
    """
    v = max(state[3], DYNAMIC_ABOVE)
    steering_per_curvature = controller[0] + controller[1] * v * v
    delay = STEERING_LAG + controller[4] * v / (controller[5] * steering_per_curvature) - controller[3] / v
    lead = controller[2] * v - controller[3] / v
    curvature = _sample(trajectory, 4, time + max(0.0, delay), spacing)
    curvature += YAW_RATE_GAIN * (_sample(trajectory, 4, time + max(0.0, lead), spacing) * (state[3] / v) - state[5] / v)
    curvature -= (LATERAL_STIFFNESS * lateral_error + LATERAL_DAMPING * v * math.sin(course_error)) / (v * v)
    angle: float = steering_per_curvature * curvature
    return angle


@compiled
def _acceleration(
    state: Floats, position_error: float, course_error: float, trajectory: Floats, time: float, spacing: float
) -> float:
    """Returns the acceleration (m/s^2) that drive and brakes shall reach."""
    speed_error = state[3] * math.cos(course_error) - _sample(trajectory, 5, time, spacing)
    return _sample(trajectory, 6, time + DRIVE_LAG, spacing) - SPEED_GAIN * speed_error - POSITION_GAIN * position_error


@compiled
def _row_due(trajectory: Floats, time: float, spacing: float) -> int:
    """Returns the last row of the trajectory due at or before `time`, at most the last but one."""
    return min(int(time / spacing + 1e-9), trajectory.shape[0] - 2)


@compiled
def _directions(trajectory: Floats, row: int) -> tuple[float, float, float, float]:
    """Returns cosine and sine of the heading in this row and in the next."""
    here, there = trajectory[row, 3], trajectory[row + 1, 3]
    return math.cos(here), math.sin(here), math.cos(there), math.sin(there)


@compiled
def _errors(
    state: Floats, trajectory: Floats, time: float, spacing: float, row: int, directions: tuple[float, float, float, float]
) -> tuple[float, float, float]:
    """Returns the distance of the vehicle ahead of the trajectory's point due now (m) and to its left (m), and the course error (rad).

    `row`: as from `_row_due`; `directions`: as from `_directions` of that row. Between rows the path is a cubic Hermite curve: chords would
    cut curves by millimetres ten times a second.
    """
    p = time / spacing + 1e-9 - row
    here, there = trajectory[row, 3], trajectory[row + 1, 3]
    start, end = trajectory[row, 5] * spacing, trajectory[row + 1, 5] * spacing
    blend = p * p * (3.0 - 2.0 * p)
    start *= p * (1.0 - p) * (1.0 - p)
    end *= p * p * (p - 1.0)
    x = trajectory[row, 1] + blend * (trajectory[row + 1, 1] - trajectory[row, 1])
    y = trajectory[row, 2] + blend * (trajectory[row + 1, 2] - trajectory[row, 2])
    dx = state[0] - (x + start * directions[0] + end * directions[2])
    dy = state[1] - (y + start * directions[1] + end * directions[3])
    course = here + p * _wrapped(there - here)
    cosine, sine = math.cos(course), math.sin(course)
    return dx * cosine + dy * sine, dy * cosine - dx * sine, _wrapped(state[2] + state[4] - course)


@compiled
def _record(state: Floats, dynamics: Floats, row: int) -> None:
    """Writes speed, longitudinal acceleration, lateral acceleration, yaw rate and steering angle to a row of `dynamics`."""
    dynamics[row, 0] = state[3]
    dynamics[row, 1] = state[6]
    dynamics[row, 2] = state[7]
    dynamics[row, 3] = state[5]
    dynamics[row, 4] = state[8]


@compiled
def drive(
    state: Floats, plant: Floats, controller: Floats, by: int, lateral: float, acceleration: float, path: Floats, since: float,
    steps: int, dynamics: Floats,
) -> int:  # fmt: skip
    """Drives `steps` steps; returns FOLLOWED, UNSTABLE or TOO_SHORT.

    `by`: STEERING or CURVATURE, i.e. what `lateral` (rad or 1/m) is, PATH or TRAJECTORY. A curvature is reached by the nominal vehicle's
    steady steering angle and feedback of the yaw rate. `path` is kept, from `since` seconds after its start, only sideways; a trajectory
    also lengthwise, in the place of the constant command `acceleration` (m/s^2).

    Overwrites `state` and writes a row (see `_record`) to `dynamics`, shape (steps, 5), at the end of each step. After an unstable step,
    state and rows keep the last valid values.
    """
    last = path.shape[0] - 1
    spacing = path[min(last, 1), 0] - path[0, 0]
    # A negated comparison also rejects a time of NaN.
    if by == TRAJECTORY and not (
        last >= 1 and spacing > 0.0 and since >= 0.0 and since + (steps - 1) * STEP <= last * spacing + 1e-9
    ):
        return TOO_SHORT
    before = state.copy()
    row = -1
    directions = (1.0, 0.0, 1.0, 0.0)
    for k in range(steps):
        steering = lateral
        if by >= PATH:
            time = since + k * STEP
            due = _row_due(path, time, spacing)
            if due != row:
                row = due
                directions = _directions(path, row)
            position_error, lateral_error, course_error = _errors(state, path, time, spacing, row, directions)
            steering = _steering(state, controller, lateral_error, course_error, path, time, spacing)
            if by == TRAJECTORY:
                acceleration = _acceleration(state, position_error, course_error, path, time, spacing)
        elif by == CURVATURE:
            v = max(state[3], DYNAMIC_ABOVE)
            steering = (controller[0] + controller[1] * v * v) * (
                lateral + YAW_RATE_GAIN * (lateral * (state[3] / v) - state[5] / v)
            )
        if not move(state, before, steering, acceleration, plant):
            for remaining in range(k, steps):
                _record(state, dynamics, remaining)
            return UNSTABLE
        _record(state, dynamics, k)
    return FOLLOWED
