"""Corridors of motorways without ramps, against the designs that the networks were built from."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from drivecal.domain.roads import pose_on, project, to_cartesian
from drivecal.highway.scenarios.build import NETWORKS
from drivecal.highway.scenarios.designs import DESIGNS, RoadDesign, line_of
from drivecal.roads.corridor import Corridor, corridor
from drivecal.roads.network import read_network

NEAR = 0.1
"""Metres."""


def built_in(scenario: str) -> tuple[RoadDesign, Corridor]:
    name = f"{scenario}.net.xml"
    network = read_network((NETWORKS / name).read_bytes(), name)
    return DESIGNS[scenario], corridor(network, list(network.edges), name)


@pytest.mark.parametrize("scenario", DESIGNS)
def test_lanes_lie_where_the_road_has_them(scenario: str) -> None:
    road, lanes = built_in(scenario)
    truth = line_of(road)
    assert len(lanes.tracks) == road.lanes
    for row in range(0, len(lanes.stations), 20):
        s = lanes.stations[row]
        for lane in range(road.lanes):
            x, y, _ = to_cartesian(lanes.line, s, lanes.centres[row, lane])
            assert abs(project(truth, x, y, s)[1] - lane * road.lane_width) < NEAR
    assert np.all(lanes.widths == road.lane_width)
    assert abs(lanes.length - road.length) < 1.0


@pytest.mark.parametrize("scenario", DESIGNS)
def test_the_line_is_smooth(scenario: str) -> None:
    _, lanes = built_in(scenario)
    spacing = lanes.line[1, 0]
    assert np.allclose(np.diff(lanes.line[:, 0]), spacing)
    before = [pose_on(lanes.line, s - 1e-9) for s in lanes.stations[1:-1]]
    after = [pose_on(lanes.line, s + 1e-9) for s in lanes.stations[1:-1]]
    assert np.max(np.abs(np.array(before)[:, :4] - np.array(after)[:, :4])) < 1e-7


def test_limits_are_those_of_the_edges() -> None:
    road, lanes = built_in("S5")
    assert sorted({float(limit) for limit in np.unique(lanes.limits)}) == pytest.approx(
        sorted({knot.speed for knot in road.limits}), abs=1e-3
    )


def test_a_position_on_a_lane_is_found_again_as_its_track() -> None:
    road, lanes = built_in("S2")
    for lane in range(road.lanes):
        s, d = lanes.position("e1", lane, 100.0)
        assert lanes.lane_at(s, d) == lane
    assert lanes.lane_at(500.0, -4.0) is None


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
