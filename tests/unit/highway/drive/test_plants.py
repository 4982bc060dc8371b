"""Vehicles of users: conventions of their states."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from drivecal.highway.drive.plants import Plant, UserVehicleModel
from drivecal.highway.vehicle.parameters import TABLE_8, SingleTrackParameters

PARAMETERS = SingleTrackParameters.of({entry.name: entry.nominal for entry in TABLE_8})


class Circle(Plant):
    """Turns by 0.2 rad/s at 20 m/s; `wrapped`: its heading lies between -pi and pi."""

    def __init__(self, *, wrapped: bool) -> None:
        self.wrapped, self.heading = wrapped, 0.0

    def begin(self, parameters: Mapping[str, Any], speed: float) -> None:
        del parameters, speed
        self.heading = 3.1

    def step(self, steering: float, acceleration: float) -> list[float]:
        del steering, acceleration
        self.heading += 0.002
        return [0.0, 0.0, math.remainder(self.heading, math.tau) if self.wrapped else self.heading, 20.0]


def test_a_heading_may_jump_by_a_whole_turn() -> None:
    driven = []
    for wrapped in (False, True):
        vehicle = UserVehicleModel(Circle(wrapped=wrapped), ["x", "y", "heading", "speed"], PARAMETERS)
        vehicle.begin({})
        vehicle.start(0.0, 0.0, 3.1, 20.0)
        dynamics = np.zeros((50, 5))
        vehicle.step(0.0, 0.0, dynamics[:1])  # from 0 to 3.1 at once
        assert vehicle.step(0.0, 0.0, dynamics)
        driven.append(dynamics)
    assert driven[0][:, 3] == pytest.approx(0.2)
    np.testing.assert_allclose(driven[1], driven[0], atol=1e-9)
