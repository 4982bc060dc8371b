"""Roads above and below a route."""

import pytest
from tests.support.networks import REAL, bridges, built, edge, entrance, node, real_corridor, real_network

from drivecal.roads.corridor import NEAR, corridor, other_levels
from drivecal.roads.network import read_network

ROUTE = ("before", "after")


def test_edges_that_cross_the_lanes_without_a_junction_are_on_another_level() -> None:
    network = read_network(bridges(), "road.net.xml")
    levels = other_levels(network, corridor(network, ROUTE, "road.net.xml"))
    assert set(levels) == {"bridge", "ramp"}
    begin, end = levels["bridge"]
    assert begin < 300 < end
    assert end - begin < 25
    begin, end = levels["ramp"]
    (lane,) = network.edges["ramp"].lanes
    assert NEAR < lane.length - 320 < begin < lane.length - 300 < end < lane.length - 280


def test_the_other_road_sees_the_route_on_another_level() -> None:
    network = read_network(bridges(), "road.net.xml")
    levels = other_levels(network, corridor(network, ("bridge",), "road.net.xml"))
    assert set(levels) == {"before", "back"}
    assert levels["before"] == pytest.approx((300, 300), abs=12)


def test_ramps_and_roads_beside_a_route_are_on_its_level() -> None:
    network = read_network(entrance(), "road.net.xml")
    assert other_levels(network, corridor(network, ("before", "beside", "after"), "road.net.xml")) == {}


def test_the_other_direction_of_a_narrow_road_is_on_its_level() -> None:
    nodes, there = [node("a", 0, 0), node("b", 1000, 0)], edge("there", "a", "b", 1, width="2.4")
    network = read_network(built(nodes, [there, edge("back", "b", "a", 1, width="2.4")], []), "road.net.xml")
    assert other_levels(network, corridor(network, ("there",), "road.net.xml")) == {}


@pytest.mark.parametrize("name", REAL)
def test_levels_of_real_networks_are_edges_beside_the_route(name: str) -> None:
    network, route = real_network(REAL[name][0]), real_corridor(name)
    levels = other_levels(network, route)
    assert not levels.keys() & {edge for edge, _ in route.places}
    for crossing, (begin, end) in levels.items():
        assert begin < end < max(lane.length for lane in network.edges[crossing].lanes) + 10
