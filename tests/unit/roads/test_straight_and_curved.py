"""Corridors of motorways without ramps, against the designs that the networks were built from."""

from itertools import pairwise

import pytest

from drivecal.roads.corridor import corridor
from drivecal.roads.network import read_network

NEAR = 0.1
"""Metres."""


@pytest.mark.parametrize("length", [100, 1_000, 9_000])
def test_lanes_of_two_points_follow_one_another_at_any_length(length: int) -> None:
    ends = (0, length, 2 * length)
    edges = "".join(
        f'<edge id="e{number}" from="j{number}" to="j{number + 1}"><lane id="e{number}_0" index="0" speed="30" length="{length}" '
        f'width="3.5" shape="{begin},0 {end},0"/></edge>'
        for number, (begin, end) in enumerate(pairwise(ends))
    )
    junctions = "".join(f'<junction id="j{number}" type="priority" x="{x}" y="0"/>' for number, x in enumerate(ends))
    connection = '<connection from="e0" to="e1" fromLane="0" toLane="0" dir="s" state="M"/>'
    network = read_network(f'<net version="1.20">{edges}{junctions}{connection}</net>'.encode(), "long.net.xml")
    road = corridor(network, ["e0", "e1"], "long.net.xml")
    assert road.length == pytest.approx(2 * length, abs=0.01)
    [track] = road.tracks
    assert (track.begin, track.end) == pytest.approx((0.0, road.length))
