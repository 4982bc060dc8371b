"""Roads as a replay draws them: the lanes of a route, where the network has them."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.networks import REAL, entrance, real_corridor, real_network

from drivecal.contracts.evaluation import RoadSurface
from drivecal.domain.roads import Floats
from drivecal.highway.drive.replay import LONGEST, TOLERANCE, line_of, route_surface, rows_between, simplified
from drivecal.roads.corridor import Corridor, corridor
from drivecal.roads.network import read_network

CENTIMETRE = 0.01


def holds(surface: RoadSurface, points: Floats) -> list[bool]:
    """Returns whether each point lies in a lane of a surface (by the even-odd rule)."""
    inside = np.zeros(len(points), np.bool_)
    for strip in surface.lanes:
        ring = np.array([*strip.right, *strip.left[::-1]])
        crossings = np.zeros(len(points), np.int64)
        for (ax, ay), (bx, by) in pairwise(np.vstack([ring, ring[:1]]).tolist()):
            if ay == by:
                continue
            between = (points[:, 1] >= min(ay, by)) & (points[:, 1] < max(ay, by))
            crossings += between & (points[:, 0] < ax + (points[:, 1] - ay) * (bx - ax) / (by - ay))
        inside |= crossings % 2 == 1
    return inside.tolist()


def whole(road: Corridor) -> slice:
    return rows_between(road, 0.0, road.length)


@pytest.mark.parametrize("name", REAL)
def test_every_lane_of_a_real_route_is_drawn_where_the_network_has_it(name: str) -> None:
    road, network = real_corridor(name), real_network(REAL[name][0])
    surface = route_surface(road, whole(road))
    shapes = [network.edges[edge].lanes[index].shape for edge, index in road.places if not edge.startswith(":")]
    middles = np.vstack([0.5 * (shape[:-1] + shape[1:]) for shape in shapes])
    assert all(holds(surface, middles))


@pytest.mark.parametrize("name", REAL)
def test_a_strip_is_as_wide_as_its_lane_which_may_be_wider_than_others(name: str) -> None:
    road = real_corridor(name)
    surface = route_surface(road, whole(road))
    widths = set(np.round(road.widths[~np.isnan(road.widths)], 2).tolist())
    drawn = {
        round(float(width), 2)
        for strip in surface.lanes
        for width in np.hypot(*(np.array(strip.left) - np.array(strip.right)).T)
    }
    assert all(min(abs(width - known) for known in widths) <= 2 * CENTIMETRE for width in drawn)
    assert {round(width, 1) for width in widths} <= {round(width, 1) for width in drawn}


def test_a_ramp_is_left_out_and_only_the_outer_borders_are_edges() -> None:
    network = read_network(entrance(), "entrance.net.xml")
    road = corridor(network, ["before", "beside", "after"], "entrance.net.xml")
    route = route_surface(road, whole(road))
    ramp = network.edges["ramp"].lanes[0].shape
    near = 0.5 * (ramp[-2:-1] + ramp[-1:])
    assert holds(route, near) == [False]
    lanes = len(network.edges["beside"].lanes)
    assert lanes > len(network.edges["before"].lanes)
    in_the_middle = np.mean([lane.shape.mean(axis=0)[0] for lane in network.edges["beside"].lanes])
    assert crossed(route.edges, in_the_middle) == 2
    assert crossed(route.markings, in_the_middle) == lanes - 1


def crossed(lines: list[list[list[float]]], x: float) -> int:
    """Number of lines that pass a place of a road along the x axis."""
    return sum(min(a[0], b[0]) <= x < max(a[0], b[0]) for line in lines for a, b in pairwise(line))


def test_a_view_finds_points_on_each_stretch() -> None:
    road = real_corridor("motorway")
    surface = route_surface(road, whole(road))
    for line in [*surface.edges, *surface.markings, *(strip.right for strip in surface.lanes)]:
        assert np.hypot(*np.diff(np.array(line), axis=0).T).max() <= LONGEST
    headings = np.array(line_of(road, whole(road)))[:, 3]
    assert np.abs(np.diff(headings)).max() < 0.1


def test_only_roads_near_the_drive_are_drawn() -> None:
    road = real_corridor("motorway")
    part = route_surface(road, rows_between(road, 100.0, 300.0))
    points = np.vstack([np.array(strip.right) for strip in part.lanes])
    here = road.line[rows_between(road, 100.0, 300.0), 1:3]
    assert max(np.hypot(*(here - point).T).min() for point in points) < 40.0


@given(st.lists(st.tuples(st.floats(0.1, 60.0), st.floats(-1.0, 1.0)), min_size=2, max_size=60))
def test_a_simplified_polyline_stays_within_its_tolerance(steps: list[tuple[float, float]]) -> None:
    ways, turns = np.array(steps).T
    headings = np.cumsum(turns)
    points = np.vstack([[0.0, 0.0], np.cumsum(np.column_stack([ways * np.cos(headings), ways * np.sin(headings)]), axis=0)])
    kept = simplified(points)
    s, places = (np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(each, axis=0).T))]) for each in (points, kept))
    numbers = [int(np.flatnonzero((points == point).all(axis=1))[0]) for point in kept]
    assert numbers[0] == 0
    assert numbers[-1] == len(points) - 1
    assert len(places) == len(numbers)
    for first, last in pairwise(numbers):
        share = ((s[first : last + 1] - s[first]) / (s[last] - s[first]))[:, None]
        chord = points[first] + share * (points[last] - points[first])
        assert np.abs(chord - points[first : last + 1]).max() <= TOLERANCE
