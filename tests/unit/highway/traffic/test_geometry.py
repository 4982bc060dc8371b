"""The compiled geometry against independent ways to compute the same."""

from math import cos, hypot, pi, sin

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from tests.support.effort import examples
from tests.support.frenet import to_frenet

from drivecal.domain.roads import Floats, reference_line, to_cartesian
from drivecal.highway.geometry import hit, with_directions
from drivecal.highway.scenarios.highway import HIGHWAY
from drivecal.highway.traffic.geometry import along_at, locate, place, s_at

S4 = HIGHWAY.scenarios["S4"]
LINE = reference_line(S4.road)
TABLE = with_directions(LINE)
ALONG = np.column_stack([1.01 * LINE[:, 0], LINE[:, 0], 0.99 * LINE[:, 0]])
"""Positions along lanes that SUMO counts in metres of its own."""
FRAME = np.array([2.4, 0.9, S4.road.right_edge, S4.road.left_edge, S4.road.lane_width, 2.0, 0.1])
stations = st.floats(-20.0, S4.road.length + 20.0)
offsets = st.floats(-5.0, 12.0)


@settings(deadline=None)  # the first call compiles
@given(stations, offsets, st.floats(-0.4, 0.4), st.floats(5.0, 45.0), st.floats(-3.0, 3.0), st.floats(-4.0, 4.0))
@example(560.0, 7.759043061582124, 0.0, 5.0, 0.0, 0.0)
def test_the_ego_vehicle_s_motion_is_the_domain_s(
    s: float, d: float, slip: float, speed: float, along: float, across: float
) -> None:
    x, y, road = to_cartesian(LINE, s, d)
    heading = road + 0.1
    motion = np.zeros(6)
    pose = np.array([x, y, heading, speed, slip, 0.0, along, across])
    place(TABLE, ALONG, FRAME, pose, s + 1.0, motion, np.zeros(4))
    velocity = (speed * cos(heading + slip), speed * sin(heading + slip))
    acceleration = (along * cos(heading) - across * sin(heading), along * sin(heading) + across * cos(heading))
    here = [
        (x + shift * cos(road), y + shift * sin(road)) for shift in (0.0, -1e-9, 1e-9)
    ]  # at a joint of the line either side is right
    expected = [list(to_frenet(LINE, point, velocity, acceleration, s + 1.0)) for point in here]
    assert any(motion.tolist() == pytest.approx(each, abs=1e-6) for each in expected), (motion, expected)


@pytest.mark.parametrize(
    ("d", "yaw", "on_road"), [(0.0, 0.0, True), (-0.97, 0.0, True), (-0.98, 0.0, False), (-0.97, 0.1, False), (8.5, 0.0, False)]
)
def test_a_vehicle_is_off_the_road_as_soon_as_a_corner_is(d: float, yaw: float, *, on_road: bool) -> None:
    x, y, heading = to_cartesian(LINE, 400.0, d)
    pose = np.array([x, y, heading + yaw, 30.0, 0.0, 0.0, 0.0, 0.0])
    assert place(TABLE, ALONG, FRAME, pose, 400.0, np.zeros(6), np.zeros(4)) is on_road


def corners(x: float, y: float, heading: float, half_length: float, half_width: float) -> Floats:
    signs = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)])
    along, across = signs[:, 0] * half_length, signs[:, 1] * half_width
    return np.column_stack([x + along * cos(heading) - across * sin(heading), y + along * sin(heading) + across * cos(heading)])


def overlap_by_sampling(one: tuple[float, ...], other: tuple[float, ...]) -> bool:
    """Does any of a dense set of points of one rectangle, its border included, lie in the other?"""
    a, b, _, d = corners(*one)
    u, v = np.meshgrid(np.linspace(0, 1, 60), np.linspace(0, 1, 60))
    points = a + u[..., None] * (b - a) + v[..., None] * (d - a)
    x, y, heading, half_length, half_width = other
    along = (points[..., 0] - x) * cos(heading) + (points[..., 1] - y) * sin(heading)
    across = (points[..., 1] - y) * cos(heading) - (points[..., 0] - x) * sin(heading)
    return bool(((abs(along) <= half_length) & (abs(across) <= half_width)).any())


@settings(max_examples=examples(300), deadline=None)
@given(st.floats(-8, 8), st.floats(-5, 5), st.floats(-pi, pi), st.floats(1.5, 6.0), st.floats(0.7, 1.3), st.floats(-pi, pi))
def test_rectangles_hit_where_points_of_one_lie_in_the_other(
    x: float, y: float, heading: float, half_length: float, half_width: float, ego_heading: float
) -> None:
    ego = (0.0, 0.0, ego_heading, 2.4, 0.9)
    shrunk, grown = ((x, y, heading, half_length + by, half_width + by) for by in (-0.15, 0.15))
    pose = np.array([0.0, 0.0, ego_heading, 0.0, 0.0, 0.0, 0.0, 0.0])
    is_hit = hit(np.array([(x, y, heading, half_length, half_width)]), pose, FRAME) >= 0
    if overlap_by_sampling(shrunk, ego):
        assert is_hit
    if not overlap_by_sampling(grown, ego) and not overlap_by_sampling(ego, grown):
        assert not is_hit


def started_at(s: float, lane: int) -> Floats:
    """The ego vehicle's place on a lane when its centre is at s."""
    curvature = np.interp(s, LINE[:, 0], LINE[:, 4])
    return np.array([lane, along_at(TABLE, ALONG, lane, s + 2.4 / (1.0 - curvature * lane * S4.road.lane_width)), 0.0, 0.0])


def placed(s: float, d: float, ego: Floats) -> Floats:
    x, y, heading = to_cartesian(LINE, s, d)
    place(TABLE, ALONG, FRAME, np.array([x, y, heading, 30.0, 0.0, 0.0, 0.0, 0.0]), s, np.zeros(6), ego)
    return ego


def test_the_speed_to_take_leads_along_the_lane_to_the_new_place() -> None:
    ego = placed(403.0, 0.3, started_at(400.0, 0))
    assert ego.tolist() == pytest.approx([0.0, started_at(403.0, 0)[1], 10.0 * 1.01 * 3.0, 0.0], abs=0.02)
    assert placed(402.0, 0.0, ego.copy())[1:3].tolist() == [ego[1], 0.0], "SUMO's vehicles do not drive backwards"


def test_another_lane_begins_when_the_centre_is_over_the_marking() -> None:
    before = started_at(400.0, 0)
    assert placed(403.0, 1.87, before.copy())[[0, 3]].tolist() == [0.0, 0.0]
    lane, front, speed, changed = placed(403.0, 1.88, before.copy())
    assert (lane, changed, speed) == (1.0, 1.0, 30.0)
    assert front == pytest.approx(started_at(403.0, 1)[1], abs=0.02)
    assert placed(403.0, -1.9, before.copy())[0] == 0.0, "the outermost lane goes on beside the road"


@given(st.floats(0.0, S4.road.length), st.floats(-40.0, 40.0), st.integers(0, 2))
def test_a_position_along_a_lane_has_one_s(s: float, away: float, lane: int) -> None:
    assert s_at(TABLE, ALONG, lane, along_at(TABLE, ALONG, lane, s), s + away) == pytest.approx(s, abs=1e-9)


def test_a_front_on_a_curve_becomes_a_centre_behind_it() -> None:
    s, d, length = 420.0, 3.85, 12.0
    neighbours = np.array([[s - 2.5 - 6.0, d - 0.1, 25.0, 0.0, length, 2.5]])
    cells = np.array([[25.0], [d], [1.0], [along_at(TABLE, ALONG, 1, s) - 2.5]])
    outlines = np.zeros((1, 5))
    locate(TABLE, ALONG, cells, neighbours, outlines, 0.1)
    centre_s, centre_d, speed, sideways = neighbours[0, :4]
    assert centre_d == pytest.approx(d)
    assert sideways == pytest.approx(1.0)
    assert speed == pytest.approx(25.0, rel=0.01)
    x, y, _ = to_cartesian(LINE, s, d)
    expected_x, expected_y, heading = to_cartesian(LINE, centre_s, centre_d)
    assert hypot(x - expected_x, y - expected_y) == pytest.approx(6.0, abs=0.01)
    assert outlines[0] == pytest.approx([expected_x, expected_y, heading, 6.0, 1.25])


def test_nothing_moves_sideways_when_there_is_no_earlier_state() -> None:
    neighbours = np.array([[100.0, 1.0, 0.0, 0.0, 5.0, 2.0]])
    locate(TABLE, ALONG, np.array([[20.0], [0.0], [0.0], [103.5]]), neighbours, np.zeros((1, 5)), 0.0)
    assert neighbours[0, 3] == 0.0
    assert neighbours[0, 0] == pytest.approx(103.5 / 1.01 - 2.5)
