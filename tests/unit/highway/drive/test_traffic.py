"""The ego vehicle in SUMO: where it is placed, and the speed that the others see."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.support.motorways import NETWORK, ROUTE

from drivecal.bundles.highway import HighwayScenario
from drivecal.highway.drive import geometry
from drivecal.highway.drive.road import HighwayRoad
from drivecal.highway.drive.traffic import CHECKED_STEPS, Traffic
from drivecal.highway.sumo import EGO, GET_POSITION, GET_SPEED
from drivecal.roads.corridor import corridor
from drivecal.roads.network import read_network

STEP, SPEED, SIZE = 0.1, 30.0, np.array([2.35, 0.95])


@pytest.mark.parametrize("metres", [0.2, 1.0, 2.0, 3.1])
def test_others_see_the_ego_vehicle_s_speed_also_if_it_is_placed_anew_behind_the_begin_of_an_edge(
    metres: float, tmp_path: Path
) -> None:
    """Every `CHECKED_STEPS` steps it is: here with its front so many metres behind it."""
    road = HighwayRoad(corridor(read_network(NETWORK.read_bytes(), "road.net.xml"), ROUTE, "road.net.xml"), {})
    data = {"network": "road.net.xml", "route": ROUTE, "duration": 20, "ego": {"s": 100, "speed": SPEED}}
    traffic = Traffic("s", HighwayScenario.model_validate(data), NETWORK, road, STEP, tmp_path)
    traffic.reset()
    motion, front = np.zeros(9), np.zeros(3)
    begin = road.corridor.places["e1", 0][0, 1]
    for index in range(CHECKED_STEPS - 8, CHECKED_STEPS + 4):
        s = begin + metres + (index - CHECKED_STEPS) * SPEED * STEP - SIZE[0]
        pose = np.array([*road.start(s, float(road.lanes[int(s / road.line[1, 0]), 0, 0])), SPEED, 0.0, 0.0, 0.0, 0.0])
        assert geometry.place(road.line, road.lanes, pose, s, SIZE, motion, front)
        assert traffic.advance(index, motion, front, SPEED)
        assert GET_SPEED(EGO) == pytest.approx(SPEED, abs=0.5)
        assert np.hypot(*(np.array(GET_POSITION(EGO)) - front[:2])) < 0.05
