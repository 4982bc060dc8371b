"""Real networks: coordinates, widths, limits and connections against sumolib, and how smooth the line is."""

from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import sumolib
from tests.support.networks import GAMES, REAL, real_corridor, real_network
from tests.support.roads import to_cartesian

from drivecal.domain.roads import pose_on
from drivecal.roads.corridor import LARGEST_DIFFERENCE, SHORT
from drivecal.roads.lines import lengths
from drivecal.roads.route import lanes_of

NEAR = 0.1
"""Metres."""
MOTORWAYS = ["motorway", "exits", "highway"]
"""Routes without corners that no car can drive at the limit."""
every_route = pytest.mark.parametrize("name", REAL)


@cache
def reference(file: str) -> Any:
    return sumolib.net.readNet(str(GAMES / file), withInternal=True)


def lane_of(name: str, edge: str, index: int) -> Any:
    return reference(REAL[name][0]).getLane(f"{edge}_{index}")


@every_route
def test_positions_lie_on_the_lanes_of_the_file(name: str) -> None:
    road = real_corridor(name)
    assert len(road.places) >= len(road.tracks)
    for edge, index in road.places:
        lane = lane_of(name, edge, index)
        shape, length = [point[:2] for point in lane.getShape()], lane.getLength()
        for share in np.linspace(0.0, 1.0, 7):
            along = share * float(sumolib.geomhelper.polyLength(shape))
            truth = sumolib.geomhelper.positionAtShapeOffset(shape, along)
            x, y, _ = to_cartesian(road.line, *road.position(edge, index, float(share * length)))
            assert np.hypot(x - truth[0], y - truth[1]) < 0.05


@every_route
def test_centres_widths_and_limits_are_those_of_the_file(name: str) -> None:
    road = real_corridor(name)
    for number, track in enumerate(road.tracks):
        for piece in track.lanes:
            lane = lane_of(name, piece.edge, piece.index)
            shape = [point[:2] for point in lane.getShape()]
            rows = np.flatnonzero((road.line[:, 0] > piece.begin + 1.0) & (road.line[:, 0] < piece.end - 1.0))
            assert np.allclose(road.widths[rows, number], lane.getWidth())
            assert np.allclose(road.limits[rows, number], lane.getSpeed())
            for row in rows[:: max(1, len(rows) // 15)]:
                x, y, _ = to_cartesian(road.line, road.line[row, 0], road.centres[row, number])
                assert sumolib.geomhelper.distancePointToPolygon((x, y), shape) < NEAR


@every_route
def test_tracks_follow_connections_of_the_file(name: str) -> None:
    for track in real_corridor(name).tracks:
        plain = [piece for piece in track.lanes if not piece.edge.startswith(":")]
        for before, after in pairwise(plain):
            links = lane_of(name, before.edge, before.index).getOutgoing()
            assert lane_of(name, after.edge, after.index) in [link.getToLane() for link in links]


@every_route
def test_heading_and_curvature_are_continuous(name: str) -> None:
    line = real_corridor(name).line
    assert np.allclose(np.diff(line[:, 0]), line[1, 0])
    for s in line[1:-1, 0]:
        before, after = pose_on(line, s - 1e-9), pose_on(line, s + 1e-9)
        assert np.allclose(before[:4], after[:4], atol=1e-7)
    chords = np.arctan2(*np.diff(line[:, 1:3], axis=0).T[::-1])
    middles = 0.5 * (line[1:, 3] + line[:-1, 3])
    assert np.max(np.abs(np.angle(np.exp(1j * (chords - middles))))) < 2e-3


@pytest.mark.parametrize("name", MOTORWAYS)
def test_the_line_stays_within_a_hand_of_the_guides_lanes(name: str) -> None:
    file, route = REAL[name]
    road, lanes = real_corridor(name), lanes_of(real_network(file), route)
    assert all(begin is end for begin, end in lanes.guide)
    shapes = [begin.shape for begin, _ in lanes.guide] + [lane.shape for passage in lanes.passages for lane in passage]
    for x, y in road.line[::10, 1:3]:
        nearest = min(sumolib.geomhelper.distancePointToPolygon((x, y), [tuple(point) for point in shape]) for shape in shapes)
        assert nearest < NEAR


@pytest.mark.parametrize("name", MOTORWAYS)
def test_curves_can_be_driven_at_the_limit(name: str) -> None:
    road = real_corridor(name)
    limit = np.nanmax(road.limits, axis=1)
    assert np.max(np.abs(road.line[:, 4]) * limit**2) < 10.0


def test_ramps_and_dropped_lanes_are_there() -> None:
    counts = {name: [track.ends for track in real_corridor(name).tracks].count(True) for name in REAL}
    assert all(counts[name] for name in ("motorway", "exits", "entrance", "ramp"))
    assert {len(real_corridor(name).tracks) for name in REAL} >= {2, 3, 4, 5}


@pytest.mark.parametrize("file", sorted({file for file, _ in REAL.values()}))
def test_lengths_of_all_lanes_keep_the_bound_of_routes(file: str) -> None:
    for edge in real_network(file).edges.values():
        for lane in edge.lanes:
            size = float(lengths(lane.shape)[-1])
            assert abs(lane.length - size) <= LARGEST_DIFFERENCE * max(size, SHORT)
