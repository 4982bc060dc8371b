"""Scenarios with a task: when it counts as fulfilled, and how the others drift."""

import numpy as np
import pytest

from drivecal.domain.roads import Floats
from drivecal.highway.drive.tasks import drift_offsets, fulfilled, speed_errors, target_offsets
from drivecal.highway.scenarios import HIGHWAY

S1, S5 = HIGHWAY.scenarios["S1"], HIGHWAY.scenarios["S5"]
STEPS = round(S1.duration / S1.step)
TARGET = S1.task.target_lane * S1.road.lane_width
SPEED = S1.task.speeds[0][1]


def motion_of(d: float, speed: float = SPEED, steps: int = STEPS) -> Floats:
    motion = np.zeros((steps + 1, 6))
    motion[:, 0] = S1.ego.s + np.arange(steps + 1) * S1.step * speed
    motion[:, 1] = speed
    motion[:, 3] = d
    return motion


def test_the_target_lane_at_the_desired_speed_fulfils_the_task() -> None:
    assert fulfilled(motion_of(TARGET), S1)


@pytest.mark.parametrize("d", [0.0, TARGET - S1.task.lane_tolerance - 0.01, TARGET + S1.task.lane_tolerance + 0.01])
def test_beside_the_target_lane_misses_it(d: float) -> None:
    assert not fulfilled(motion_of(d), S1)


@pytest.mark.parametrize("sign", [-1, 1])
def test_the_wrong_speed_misses_it(sign: int) -> None:
    assert not fulfilled(motion_of(TARGET, SPEED + sign * (S1.task.speed_tolerance + 0.01)), S1)


def test_a_lane_reached_too_late_to_be_held_misses_it() -> None:
    motion = motion_of(TARGET)
    motion[-6, 3] = 0.0
    assert not fulfilled(motion, S1)
    motion = motion_of(TARGET)
    motion[-round(S1.task.hold / S1.step) - 2, 3] = 0.0
    assert fulfilled(motion, S1)


def test_a_run_that_ended_early_misses_it() -> None:
    assert not fulfilled(motion_of(TARGET, steps=STEPS - 1), S1)


def test_offsets_count_from_the_target_lane_to_the_left() -> None:
    assert target_offsets(motion_of(TARGET + 0.5), S1) == pytest.approx(0.5)


def test_the_desired_speed_changes_at_its_place_on_the_road() -> None:
    (_, first), (place, second) = S5.task.speeds
    motion = np.zeros((3, 6))
    motion[:, 0] = place - 0.1, place, place + 100.0
    motion[:, 1] = first
    assert speed_errors(motion, S5) == pytest.approx([0.0, first - second, first - second])


def test_a_vehicle_drifts_along_its_knots() -> None:
    vehicle = S1.traffic[0].model_copy(update={"drift": [(1.0, 0.0), (1.0, 0.0), (2.0, 0.5), (3.0, 0.5), (4.0, -0.5)]})
    offsets = drift_offsets(vehicle, S1)
    assert len(offsets) == round(S1.duration / S1.step)
    after = {time: offsets[round(time / S1.step) - 1] for time in (0.5, 1.5, 2.5, 3.5, 10.0)}
    assert after == pytest.approx({0.5: 0.0, 1.5: 0.25, 2.5: 0.5, 3.5: 0.0, 10.0: -0.5})
