"""Vehicles of users: conventions of their states."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from drivecal.highway.drive.plants import Plant, PlantError, UserVehicleModel
from drivecal.highway.vehicle.kernels import STEERING
from drivecal.highway.vehicle.parameters import TABLE_8, SingleTrackParameters

PARAMETERS = SingleTrackParameters.of({entry.name: entry.nominal for entry in TABLE_8})

NO_PATH = np.zeros((2, 7))


class Circle(Plant):
    """Turns by 2 rad/s at 2 m/s; `wrapped`: its heading lies between -pi and pi."""

    def __init__(self, *, wrapped: bool) -> None:
        self.wrapped, self.heading = wrapped, 0.0

    def begin(self, parameters: Mapping[str, Any], speed: float) -> None:
        del parameters, speed
        self.heading = 0.0

    def step(self, steering: float, acceleration: float) -> list[float]:
        del steering, acceleration
        self.heading += 0.02
        return [0.0, 0.0, math.remainder(self.heading, math.tau) if self.wrapped else self.heading, 2.0]


def test_a_heading_may_jump_by_a_whole_turn() -> None:
    driven = []
    for wrapped in (False, True):
        vehicle = UserVehicleModel(Circle(wrapped=wrapped), ["x", "y", "heading", "speed"], PARAMETERS)
        vehicle.begin({})
        vehicle.start(0.0, 0.0, 3.1, 2.0)
        dynamics = np.zeros((400, 5))
        assert vehicle.drive(STEERING, 0.0, 0.0, NO_PATH, 0.0, dynamics)
        driven.append(dynamics)
    assert driven[0][:, 3] == pytest.approx(2.0)
    np.testing.assert_allclose(driven[1], driven[0], atol=1e-9)


class Standing(Plant):
    """Gives the same state in every step."""

    def __init__(self, *state: float) -> None:
        self.state = state

    def begin(self, parameters: Mapping[str, Any], speed: float) -> None:
        del parameters, speed

    def step(self, steering: float, acceleration: float) -> tuple[float, ...]:
        del steering, acceleration
        return self.state


def begun(*state: float) -> UserVehicleModel:
    """A vehicle that starts somewhere at 20 m/s and gives this state after its first step."""
    vehicle = UserVehicleModel(Standing(*state), ["x", "y", "heading", "speed"], PARAMETERS)
    vehicle.begin({})
    vehicle.start(100.0, -50.0, 1.0, 20.0)
    return vehicle


@pytest.mark.parametrize("state", [(0.2, 0.0, 0.0, 20.0), (0.0, 0.9, math.tau - 0.1, 20.9), (0.9, -0.4, -0.1, 19.0)])
def test_a_state_that_follows_from_the_start_is_taken(state: tuple[float, ...]) -> None:
    vehicle = begun(*state)
    vehicle.drive(STEERING, 0.0, 0.0, NO_PATH, 0.0, np.zeros((1, 5)))
    assert vehicle.pose.item(3) == state[3]
    assert math.hypot(*(vehicle.pose[:2] - (100.0, -50.0))) == pytest.approx(math.hypot(*state[:2]))


@pytest.mark.parametrize(
    "state",
    [(0.2, 0.0, 0.0, 0.0), (0.2, 0.0, 0.0, 72.0), (100.2, -50.0, 0.0, 20.0), (0.2, 3.0, 0.0, 20.0), (0.2, 0.0, 1.0, 20.0)],
)
def test_a_vehicle_that_starts_by_itself_is_refused_in_every_run(state: tuple[float, ...]) -> None:
    vehicle = begun(*state)
    for _ in range(2):
        with pytest.raises(PlantError, match="speed = 20 "):
            vehicle.drive(STEERING, 0.0, 0.0, NO_PATH, 0.0, np.zeros((1, 5)))
        vehicle.start(100.0, -50.0, 1.0, 20.0)
