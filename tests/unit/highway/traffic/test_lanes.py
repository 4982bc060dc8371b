"""Lanes of a corridor as SUMO counts them."""

import pytest
from tests.support.networks import entrance

from drivecal.highway.traffic.lanes import LanePlace, SumoLanes
from drivecal.roads.corridor import corridor
from drivecal.roads.network import read_network


def test_a_front_beyond_the_end_of_its_edge_stays_on_the_track() -> None:
    road = corridor(read_network(entrance(), "road.net.xml"), ["before", "beside", "after"], "road.net.xml")
    lanes = SumoLanes(road, road.stations)
    end = float(road.places["before", 0][-1, 0])
    edge, lane, position = lanes.ahead("before", 0, end + 30.0)
    assert (edge, lane) == ("beside", 1)  # lane 0 of this edge is that of the ramp
    assert 0.0 < position < 30.0
    assert lanes.ahead("before", 1, end - 4.0)[:2] == ("before", 1)
    assert lanes.ahead("before", 1, end - 4.0).position == pytest.approx(end - 4.0)
    assert lanes.ahead("ramp", 0, 1000.0) == LanePlace("ramp", 0, 1000.0)
