"""`follow`: the kernel against a naive implementation, symmetries, and what it does with input that does not fit."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.effort import examples
from tests.unit.highway.vehicle.driving import Drive, curve, lane_change, straight

from drivecal.highway.vehicle import kernels, single_track
from drivecal.highway.vehicle.model import SingleTrackModel
from drivecal.highway.vehicle.parameters import NOMINAL, TABLE_8, SingleTrackParameters, understeer_gradient
from drivecal.plugins.ports import Floats

boxes = st.builds(SingleTrackParameters, *(st.floats(parameter.minimum, parameter.maximum) for parameter in TABLE_8))


class Naive:
    """Controller and vehicle once more, by the formulas in numpy, for speeds above `DYNAMIC_ABOVE`."""

    def __init__(self, p: SingleTrackParameters, pose: Floats) -> None:
        self.p = p
        self.x = np.array([*pose, 0.0, 0.0, 0.0])  # x, y, psi, v, beta, yaw rate, steering angle
        self.acceleration = 0.0

    def derivative(self, x: Floats, steering_rate: float, acceleration: float) -> Floats:
        p, (_, _, psi, v, beta, yaw_rate, delta) = self.p, x
        front = p.cornering_stiffness_front * (delta - beta - p.distance_front * yaw_rate / v)
        rear = p.cornering_stiffness_rear * (-beta + p.distance_rear * yaw_rate / v)
        return np.array(
            [
                v * math.cos(psi + beta),
                v * math.sin(psi + beta),
                yaw_rate,
                acceleration,
                (front + rear) / (p.mass * v) - yaw_rate,
                (p.distance_front * front - p.distance_rear * rear) / p.yaw_inertia,
                steering_rate,
            ]
        )

    def commands(self, trajectory: Floats, time: float) -> tuple[float, float]:
        """Steering rate and acceleration for the next step."""
        nominal, (x, y, psi, v, beta, yaw_rate, delta) = NOMINAL, self.x
        rows = trajectory[:, 0]
        k = min(int(time / 0.1 + 1e-9), len(rows) - 2)
        u = time / 0.1 + 1e-9 - k
        (x0, y0, h0, _, v0), (x1, y1, h1, _, v1) = trajectory[k, 1:6], trajectory[k + 1, 1:6]
        turn = (h1 - h0 + math.pi) % (2.0 * math.pi) - math.pi
        ends, tangents = (
            np.array([[x0, y0], [x1, y1]]),
            0.1 * np.array([[v0 * math.cos(h0), v0 * math.sin(h0)], [v1 * math.cos(h0 + turn), v1 * math.sin(h0 + turn)]]),
        )
        point = (
            (2 * u**3 - 3 * u**2 + 1) * ends[0]
            + (u**3 - 2 * u**2 + u) * tangents[0]
            + (3 * u**2 - 2 * u**3) * ends[1]
            + (u**3 - u**2) * tangents[1]
        )
        heading = h0 + u * turn
        along = np.array([math.cos(heading), math.sin(heading)])
        across = np.array([-along[1], along[0]])
        position_error, lateral_error = along @ ([x, y] - point), across @ ([x, y] - point)
        course_error = math.remainder(psi + beta - heading, 2.0 * math.pi)

        steady = nominal.wheelbase + understeer_gradient(nominal) * v**2
        matrix = np.array([self.nominal_column(v, 0), self.nominal_column(v, 1)]).T
        delay = single_track.STEERING_LAG - np.trace(matrix) / np.linalg.det(matrix) - nominal.distance_rear / v
        slip_per_acceleration = nominal.mass * nominal.distance_front / (nominal.cornering_stiffness_rear * nominal.wheelbase)
        lead = slip_per_acceleration * v - nominal.distance_rear / v
        ahead, due = np.interp([time + max(delay, 0.0), time + max(lead, 0.0)], rows, trajectory[:, 4])
        feedback = kernels.LATERAL_STIFFNESS * lateral_error / v**2 + kernels.LATERAL_DAMPING * math.sin(course_error) / v
        target = steady * (ahead + kernels.YAW_RATE_GAIN * (due - yaw_rate / v) - feedback)
        target = np.clip(target, -single_track.STEERING_LIMIT, single_track.STEERING_LIMIT)
        share = 1.0 - math.exp(-single_track.STEP / single_track.STEERING_LAG)
        rate = np.clip(
            (target - delta) * share / single_track.STEP, -single_track.STEERING_RATE_LIMIT, single_track.STEERING_RATE_LIMIT
        )

        speed = np.interp(time, rows, trajectory[:, 5])
        wanted = np.interp(time + single_track.DRIVE_LAG, rows, trajectory[:, 6])
        wanted -= kernels.SPEED_GAIN * (v * math.cos(course_error) - speed) + kernels.POSITION_GAIN * position_error
        wanted = np.clip(wanted, single_track.LOWEST_ACCELERATION, single_track.HIGHEST_ACCELERATION)
        share = 1.0 - math.exp(-single_track.STEP / single_track.DRIVE_LAG)
        return float(rate), float(self.acceleration + share * (wanted - self.acceleration))

    @staticmethod
    def nominal_column(v: float, column: int) -> Floats:
        """A column of the nominal vehicle's dynamics matrix, by its response to a unit of side slip or yaw rate."""
        probe = Naive(NOMINAL, np.zeros(4))
        x = np.zeros(7)
        x[3], x[4 + column] = v, 1.0
        return probe.derivative(x, 0.0, 0.0)[4:6]

    def follow(self, trajectory: Floats, since: float, steps: int) -> Floats:
        rows = []
        h = single_track.STEP
        for k in range(steps):
            u = self.commands(trajectory, since + k * h)
            k1 = self.derivative(self.x, *u)
            k2 = self.derivative(self.x + h / 2 * k1, *u)
            k3 = self.derivative(self.x + h / 2 * k2, *u)
            k4 = self.derivative(self.x + h * k3, *u)
            self.x = self.x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            self.acceleration = u[1]
            slip_rate = self.derivative(self.x, *u)[4]
            rows.append([self.x[3], u[1], self.x[3] * (slip_rate + self.x[5]), self.x[5], self.x[6]])
        return np.array(rows)


def mirrored(rows: Floats, *columns: int) -> Floats:
    rows = rows.copy()
    rows[:, columns] *= -1.0
    return rows


@settings(max_examples=examples(15), deadline=None)
@given(boxes, st.floats(8.0, 40.0), st.floats(-1.0, 1.0), st.floats(-0.02, 0.02))
def test_the_kernel_agrees_with_the_naive_implementation(
    vehicle: SingleTrackParameters, speed: float, offset: float, turned: float
) -> None:
    trajectory = lane_change(speed, 3.0, 5.0)
    trajectory[:, 5] += 0.5 * np.sin(trajectory[:, 0])
    trajectory[:, 6] += 0.5 * np.cos(trajectory[:, 0])
    model, naive = SingleTrackModel(vehicle), Naive(vehicle, np.array([0.3, offset, turned, speed]))
    model.start(0.3, offset, turned, speed)
    dynamics = np.zeros((400, 5))
    if model.follow(trajectory, 0.5, 4.0, dynamics):
        expected = naive.follow(trajectory, 0.5, 400)
        assert dynamics == pytest.approx(expected, rel=1e-9, abs=1e-10)
        assert model.pose[:6] == pytest.approx(naive.x[:6], rel=1e-9, abs=1e-10)


@settings(max_examples=examples(40), deadline=None)
@given(boxes, st.floats(2.0, 40.0), st.floats(-1.0, 1.0))
def test_a_mirrored_drive_is_the_mirror_image_to_the_bit(vehicle: SingleTrackParameters, speed: float, offset: float) -> None:
    trajectory = lane_change(speed, 4.0, 6.0, width=min(3.75, speed))
    results = []
    for sign, path in ((1.0, trajectory), (-1.0, mirrored(trajectory, 2, 3, 4))):
        model = SingleTrackModel(vehicle)
        model.start(0.0, sign * offset, 0.0, speed)
        dynamics = np.zeros((500, 5))
        stable = model.follow(path, 0.0, 5.0, dynamics)
        results.append((stable, dynamics, model.pose.copy()))
    (stable, left, pose), (also_stable, right, other) = results
    assert stable == also_stable
    assert np.array_equal(left, mirrored(right, 2, 3, 4))
    assert np.array_equal(pose, other * [1, -1, -1, 1, -1, -1, 1, -1])


@settings(max_examples=examples(30), deadline=None)
@given(st.floats(-3.1, 3.1), st.floats(-5000.0, 5000.0), st.floats(-5000.0, 5000.0))
def test_the_roads_place_does_not_matter(angle: float, east: float, north: float) -> None:
    trajectory = lane_change(25.0, 4.0, 6.0)
    moved = trajectory.copy()
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    moved[:, 1:3] = trajectory[:, 1:3] @ turn.T + [east, north]
    moved[:, 3] = np.mod(trajectory[:, 3] + angle, 2.0 * math.pi)  # wraps wherever it likes
    here, there = SingleTrackModel(NOMINAL), SingleTrackModel(NOMINAL)
    here.start(0.0, 0.0, 0.0, 25.0)
    there.start(east, north, angle, 25.0)
    expected, dynamics = np.zeros((500, 5)), np.zeros((500, 5))
    assert here.follow(trajectory, 0.0, 5.0, expected)
    assert there.follow(moved, 0.0, 5.0, dynamics)
    assert dynamics == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("column", [1, 2, 3, 4, 5, 6])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_trajectory_that_is_not_finite_counts_as_unstable(column: int, value: float) -> None:
    trajectory = straight(30.0, 3.0)
    trajectory[1:, column] = value
    model = SingleTrackModel(NOMINAL)
    model.start(0.0, 0.0, 0.0, 30.0)
    dynamics = np.full((10, 5), math.nan)
    followed = model.follow(trajectory, 0.0, 0.1, dynamics)
    assert np.isfinite(dynamics).all()
    assert np.isfinite(model.pose).all()
    # Infinite curvature or acceleration only saturates the actuators at first.
    assert not followed or (value == math.inf and column in {4, 6})


@pytest.mark.parametrize(("lateral_acceleration", "stable"), [(9.0, True), (10.5, False)])
def test_beyond_the_grip_of_tyres_the_vehicle_is_unstable(lateral_acceleration: float, stable: bool) -> None:
    assert Drive(curve(30.0, lateral_acceleration, 12.0)).stable is stable


def test_a_trajectory_that_ends_too_early_is_refused() -> None:
    trajectory = straight(30.0, 1.0)
    model = SingleTrackModel(NOMINAL)
    model.start(0.0, 0.0, 0.0, 30.0)
    assert model.follow(trajectory, 0.9, 0.1, np.zeros((10, 5)))
    with pytest.raises(ValueError, match="trajectory"):
        model.follow(trajectory, 1.0, 0.1, np.zeros((10, 5)))
    with pytest.raises(ValueError, match="trajectory"):
        model.follow(trajectory[:1], 0.0, 0.1, np.zeros((10, 5)))


@pytest.mark.parametrize("time", [math.nan, 0.0, -0.1])
def test_a_trajectory_whose_times_do_not_advance_is_refused(time: float) -> None:
    trajectory = straight(30.0, 1.0)
    trajectory[1, 0] = time
    model = SingleTrackModel(NOMINAL)
    with pytest.raises(ValueError, match="trajectory"):
        model.follow(trajectory, 0.0, 0.1, np.zeros((10, 5)))


def test_dynamics_of_the_wrong_length_are_refused() -> None:
    model = SingleTrackModel(NOMINAL)
    with pytest.raises(ValueError, match="10"):
        model.follow(straight(30.0, 3.0), 0.0, 0.1, np.zeros((9, 5)))
