"""Geometry of the corridor: places, observations, records and the lane keeper's path, against hand-made roads and `domain.roads`."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.effort import examples
from tests.support.frenet import project, to_frenet
from tests.support.roads import CurvatureKnot, RoadDesign, line_of, to_cartesian

from drivecal.bundles import highway_catalogue as catalogue
from drivecal.highway.drive import geometry, measures
from drivecal.highway.drive.geometry import NAMES, keeper_acceleration
from drivecal.highway.drive.road import slopes
from drivecal.highway.geometry import foot, hit, swept

CURVE = RoadDesign(length=600.0, lanes=3, lane_width=3.5, knots=(CurvatureKnot(0.0, 0.0), CurvatureKnot(200.0, 0.004)))
SIZE = np.array([2.5, 1.0])
VERGE = 0.5


DESIGNED = line_of(CURVE)
LINE = np.column_stack([DESIGNED, np.cos(DESIGNED[:, 3]), np.sin(DESIGNED[:, 3])])


def lanes_of(*centres: float, width: float = 3.5, limit: float = 30.0) -> np.ndarray:
    """Tracks with these centres along the whole line."""
    lanes = np.zeros((len(LINE), len(centres), 5))
    for track, centre in enumerate(centres):
        lanes[:, track, :4] = centre, width, limit, 0.0
        lanes[:, track, 4] = 1.01 * LINE[:, 0]
    return lanes


LANES = lanes_of(0.0, 3.5)
ENDS = np.full(3, 600.0)


def pose(s: float, d: float, yaw: float = 0.0, speed: float = 20.0) -> np.ndarray:
    x, y, heading = to_cartesian(LINE[:, :5], s, d)
    return np.array([x, y, heading + yaw, speed, 0.0, 0.01, 0.5, 0.2])


def placed(s: float, d: float, lanes: np.ndarray = LANES, verge: float = VERGE, **motion: float) -> tuple[bool, np.ndarray]:
    """Returns whether the vehicle is on the road, and its place."""
    place = np.zeros(geometry.MOTION)
    place[geometry.SIZE : geometry.EDGE + 1], place[geometry.STEERING] = [*SIZE, verge], 0.03
    on_road = geometry.place(LINE, lanes, pose(s, d, **motion), s + 3.0, place)
    return on_road, place


def arrays(others: Any) -> tuple[np.ndarray, np.ndarray]:
    """Neighbours and outlines of vehicles (s, d, speed, acceleration, length, width)."""
    rows = np.array(others, dtype=float).reshape(-1, 6)
    neighbours, outlines = np.zeros((len(rows), 6)), np.zeros((len(rows), geometry.OUTLINED))
    neighbours[:, [0, 1, 2, 4, 5]], outlines[:, 5:7] = rows[:, [0, 1, 2, 4, 5]], rows[:, 2:4]
    return neighbours, outlines


def observed(others: Any, s: float = 100.0, d: float = 0.0, lanes: np.ndarray = LANES, **motion: float) -> dict[str, float]:
    return signals_of(arrays(others), 1.5, 0.0, s, d, lanes, **motion)


def signals_of(
    others: tuple[np.ndarray, np.ndarray], time: float, lead: float, s: float, d: float, lanes: np.ndarray, **motion: float
) -> dict[str, float]:
    _, place = placed(s, d, lanes, **motion)
    signals = np.zeros(geometry.SIGNALS)
    geometry.observe(LINE, lanes, ENDS, *others, place, pose(s, d, **motion), time, lead, signals)
    return dict(zip(NAMES, signals.tolist(), strict=True))


def test_the_compiled_code_and_the_catalogue_have_the_same_names() -> None:
    assert len(NAMES) == geometry.SIGNALS
    assert len(measures.COLUMNS) == geometry.RECORDED
    assert set(measures.COLUMNS) == set(catalogue.SERIES)
    assert geometry.FAR == catalogue.FAR


@settings(max_examples=50, deadline=None)
@given(s=st.floats(1, 599), d=st.floats(-8, 8), off=st.floats(-20, 20))
def test_foot_points_are_those_of_the_domain(s: float, d: float, off: float) -> None:
    x, y, heading = to_cartesian(LINE[:, :5], s, d)
    assert foot(LINE, x, y, s + off)[:2] == pytest.approx(project(LINE[:, :5], x, y, s), abs=1e-6)
    assert geometry.searched(LINE, x, y, 0.0)[:3] == pytest.approx((s, d, heading), abs=1e-6)


def test_a_vehicle_is_placed_in_its_lane() -> None:
    on_road, place = placed(300.0, 3.0, yaw=0.02)
    assert on_road
    assert place[geometry.S] == pytest.approx(300)
    assert place[geometry.TRACK] == 1
    assert place[geometry.OFFSET] == pytest.approx(-0.5)
    assert place[geometry.HEADING_ERROR] == pytest.approx(0.02)
    assert (place[geometry.LIMIT], place[geometry.WIDTH]) == (30, 3.5)
    assert place[geometry.ALONG] == pytest.approx(1.01 * (300 + 2.5 / (1 - 0.004 * 3)))
    x, y, heading, *_ = pose(300.0, 3.0, 0.02)
    assert place[geometry.FRONT : geometry.FRONT + 3] == pytest.approx(
        [x + 2.5 * math.cos(heading), y + 2.5 * math.sin(heading), 90 - math.degrees(heading)]
    )


@pytest.mark.parametrize(("d", "on_road"), [(-1.2, True), (-1.3, False), (4.7, True), (4.8, False)])
def test_the_road_ends_half_a_metre_beyond_its_outermost_lanes(d: float, on_road: bool) -> None:
    assert placed(100.0, d)[0] is on_road


def test_a_marking_lies_between_lanes_of_unequal_width() -> None:
    lanes = lanes_of(0.0, 3.375)
    lanes[:, 0, 1], lanes[:, 1, 1] = 2.85, 3.9  # the marking is at 1.425
    for d, track in ((1.42, 0), (1.43, 1), (1.6, 1)):
        _, place = placed(100.0, d, lanes)
        assert (place[geometry.TRACK], place[geometry.WIDTH]) == (track, (2.85, 3.9)[track])
        assert abs(place[geometry.OFFSET]) <= 0.5 * place[geometry.WIDTH]


def test_of_lanes_that_overlap_the_closer_centre_counts() -> None:
    merging = lanes_of(0.0, 0.3)
    merging[:, 1, 1] = 4.5
    for d, track in ((0.0, 0), (0.14, 0), (0.16, 1), (2.0, 1)):
        assert placed(100.0, d, merging)[1][geometry.TRACK] == track


def test_a_ramp_is_a_road_of_its_own_until_its_lanes_come_close() -> None:
    ramp = lanes_of(-12.0, 0.0, 3.5)
    for d, on_road in ((-12.0, True), (-10.8, True), (-10.6, False), (-6.0, False), (-1.3, False), (-1.2, True), (3.5, True)):
        assert placed(100.0, d, ramp)[0] is on_road
    for d, left, right in ((-12.0, 0, 0), (0.0, 1, 0), (3.5, 0, 1)):
        signals = observed([[150.0, -12.0, 20.0, 0.0, 4.0, 2.0]], 100.0, d, ramp)
        assert (signals["left_lane_exists"], signals["right_lane_exists"]) == (left, right)
        assert signals["right_gap"] == 1000
    opening = lanes_of(-7.0, 0.0)  # a lane opens between them
    assert placed(100.0, -3.5, opening)[0]
    assert observed([], 100.0, 0.0, opening)["right_lane_exists"] == 1


def test_a_lane_that_ends_is_no_road_any_more() -> None:
    lanes = LANES.copy()
    lanes[LINE[:, 0] > 250, 0] = np.nan
    assert placed(240.0, 0.0, lanes)[0]
    assert not placed(260.0, 0.0, lanes)[0]
    assert observed([], 240.0, 0.0, lanes)["right_lane_exists"] == 0
    assert observed([], 240.0, 3.5, lanes)["right_lane_exists"] == 1
    assert observed([], 260.0, 3.5, lanes)["right_lane_exists"] == 0


@given(
    st.floats(0.0, 600.0),
    st.floats(-5.0, 12.0),
    st.floats(-0.4, 0.4),
    st.floats(5.0, 45.0),
    st.floats(-3.0, 3.0),
    st.floats(-4.0, 4.0),
)
def test_the_motion_is_the_domains(s: float, d: float, slip: float, speed: float, along: float, across: float) -> None:
    line = LINE[:, :5]
    x, y, road = to_cartesian(line, s, d)
    heading = road + 0.1
    place = np.zeros(geometry.MOTION)
    geometry.place(LINE, LANES, np.array([x, y, heading, speed, slip, 0.0, along, across]), s + 1.0, place)
    motion = place[geometry.FRENET : geometry.FRENET + 6].tolist()
    cosine, sine = math.cos(heading + slip), math.sin(heading + slip)
    velocity = (speed * cosine, speed * sine)
    acceleration = (along * cosine - across * sine, along * sine + across * cosine)
    # at a joint either is right
    here = [(x + shift * math.cos(road), y + shift * math.sin(road)) for shift in (0.0, -1e-9, 1e-9)]
    expected = [list(to_frenet(line, point, velocity, acceleration, s + 1.0)) for point in here]
    assert any(motion == pytest.approx(each, abs=1e-6) for each in expected), (motion, expected)


@pytest.mark.parametrize(
    ("d", "yaw", "on_road"), [(0.0, 0.0, True), (-0.74, 0.0, True), (-0.76, 0.0, False), (-0.74, 0.1, False), (4.3, 0.0, False)]
)
def test_a_vehicle_is_off_a_road_without_verge_as_soon_as_a_corner_is(d: float, yaw: float, on_road: bool) -> None:
    assert placed(100.0, d, verge=0.0, yaw=yaw)[0] is on_road


def test_a_vehicle_that_keeps_its_lane_is_where_its_speed_leads_it() -> None:
    """Its front is on the curve, its centre behind it."""
    s, offset, length = 420.0, 0.35, 12.0
    others = arrays([[s - 2.5 - 6.0, 3.75, 25.0, 0.0, length, 2.5]])
    others[1][0, geometry.SAID :] = 1.01 * s - 2.5, offset, 25.0, 1
    geometry.locate(LINE, LANES, *others, 0.1, True)
    (neighbour,), (outline,) = others
    centre, d, along, sideways = neighbour[:4]
    assert (d, sideways) == pytest.approx((3.5 + offset, 1.0))
    assert along == pytest.approx(25.0 / (1.0 - 0.004 * d))
    x, y, _ = to_cartesian(LINE[:, :5], s, d)
    *there, heading = to_cartesian(LINE[:, :5], centre, d)
    assert math.hypot(x - there[0], y - there[1]) == pytest.approx(6.0, abs=0.01)
    assert outline[:7] == pytest.approx([*there, heading, 6.0, 1.25, 25.0, 0.0])
    geometry.locate(LINE, LANES, *others, 0.0, True)
    assert others[0][0, 3] == 0.0  # without an earlier place


def test_gaps_are_between_bumpers_and_per_lane() -> None:
    signals = observed(
        [
            [160.0, 0.1, 22.0, -1.0, 12.0, 2.0],  # the leader is a lorry
            [200.0, 0.0, 10.0, 0.0, 4.0, 2.0],  # hidden behind it
            [70.0, 0.0, 25.0, 0.3, 5.0, 2.0],
            [120.0, 3.4, 28.0, 0.0, 4.0, 2.0],
        ]
    )
    assert signals["gap"] == pytest.approx(60 - 2.5 - 6)
    assert (signals["leader_speed"], signals["leader_acceleration"]) == (22, -1)
    assert signals["rear_gap"] == pytest.approx(30 - 2.5 - 2.5)
    assert signals["follower_speed"] == 25
    assert signals["left_gap"] == pytest.approx(20 - 2.5 - 2)
    assert (signals["left_lane_exists"], signals["right_lane_exists"]) == (1, 0)
    assert (signals["left_rear_gap"], signals["left_follower_speed"]) == (1000, 20)
    assert (signals["right_gap"], signals["right_leader_speed"]) == (1000, 20)


def test_a_leader_exists_and_has_a_relative_speed() -> None:
    for ahead, gap in ((160.0, 52.5), (104.0, -3.5)):
        signals = observed([[ahead, 0.0, 22.0, -1.0, 10.0, 2.0]])
        assert (signals["gap"], signals["leader_exists"], signals["relative_speed"]) == pytest.approx((gap, 1, 2))


@pytest.mark.parametrize(
    "others",
    [
        [],
        [[70.0, 0.0, 25.0, 0.0, 5.0, 2.0], [150.0, 3.5, 25.0, 0.0, 5.0, 2.0]],  # behind, and in the next lane
        [[math.nan, math.nan, 25.0, 0.0, 5.0, 2.0]],  # on another level
    ],
)
def test_without_a_leader_the_relative_speed_is_0(others: list[list[float]]) -> None:
    signals = observed(others)
    assert (signals["gap"], signals["leader_exists"], signals["relative_speed"]) == (1000, 0, 0)


def test_speeds_of_others_are_metres_of_their_own_way_and_places_move_along_the_line() -> None:
    d, stretch = -7.0, 1.0 + 0.004 * 7.0  # on the outer side of a curve of 250 m
    lanes = lanes_of(d)
    x, y, _ = to_cartesian(LINE[:, :5], 340.0, d)
    others = arrays([[0.0, 0, 0, 0, 5, 2]])
    others[1][0, geometry.SAID :] = x, y, 30.0, np.nan
    geometry.locate(LINE, lanes, *others, 0.0, False)
    signals = signals_of(others, 1.5, 0.0, 300.0, d, lanes, speed=30.0)
    assert signals["leader_speed"] == pytest.approx(30.0)
    assert signals["gap"] == pytest.approx(40 * stretch - 5 - 2.5)
    moved = signals_of(others, 0.0, 0.1, 300.0, d, lanes, speed=30.0)
    assert moved["gap"] == pytest.approx(signals["gap"] + 3.0)


@pytest.mark.parametrize("turn", [math.pi, -math.pi, 3 * math.pi + 0.1])
def test_a_vehicle_against_the_route_has_its_own_heading_and_speed(turn: float) -> None:
    """Its front is before its centre as it drives, and its speed changes by its own acceleration."""
    neighbours, outlines = others = arrays([[0.0, 0, 0, 0, 5, 2]])
    for step, s, speed in ((0.0, 340.0, 30.0), (0.1, 337.0, 29.8)):
        x, y, heading = to_cartesian(LINE[:, :5], s, 7.0)
        heading += turn
        outlines[0, geometry.SAID :] = x + 2.5 * math.cos(heading), y + 2.5 * math.sin(heading), speed, heading
        geometry.locate(LINE, LANES, *others, step, False)
        assert neighbours[0, :2] == pytest.approx((s, 7.0), abs=1e-6)
        assert outlines[0, :6] == pytest.approx((x, y, heading, 2.5, 1.0, -speed))
    assert outlines[0, 6] == pytest.approx(2.0)
    seen = signals_of(others, 0.0, 0.0, 300.0, 0.0, LANES)
    assert (seen["gap"], seen["left_gap"]) == (1000, 1000)  # it is outside the lanes


def test_a_vehicle_against_the_route_leads_in_the_own_lane_and_is_no_follower() -> None:
    wrong_way, behind = [160.0, 0.0, -20.0, 0.5, 5.0, 2.0], [60.0, 0.0, -20.0, 0.5, 5.0, 2.0]
    signals = observed([wrong_way, behind])
    assert signals["gap"] == pytest.approx(60 - 2.5 - 2.5)
    assert (signals["leader_speed"], signals["leader_acceleration"]) == (-20, 0.5)
    assert (signals["rear_gap"], signals["follower_speed"]) == (1000, 20)
    assert observed([[160.0, 6.7, -20.0, 0.0, 5.0, 2.0]])["left_gap"] == 1000


def test_a_vehicle_between_two_lanes_is_in_both() -> None:
    for offset, seen in ((2.2, True), (2.5, False), (1.75, True)):
        signals = observed([[150.0, offset, 20.0, 0.0, 4.0, 2.0]])
        assert (signals["gap"] < 1000) is seen
        assert signals["left_gap"] < 1000


def test_own_state_and_road_are_observed() -> None:
    lanes = LANES.copy()
    lanes[LINE[:, 0] > 330, :, 2] = 22.0
    signals = observed([], 300.0, 0.2, lanes, yaw=0.01)
    expected = {
        "time": 1.5, "speed": 20, "own_acceleration": 0.5, "lateral_acceleration": 0.2, "yaw_rate": 0.01, "steering_angle": 0.03,
        "position": 300, "lane": 0, "lane_offset": 0.2, "heading_error": 0.01, "lane_width": 3.5, "lane_end": 300 * (1 - 0.004 * 0.2),
        "route_end": 300, "limit": 30, "limit_ahead": 22, "road_curvature": 0.004, "gap": 1000, "leader_speed": 20,
    }  # fmt: skip
    assert {name: signals[name] for name in expected} == pytest.approx(expected)
    assert observed([], 100.0)["curvature_2s"] == pytest.approx(0.004 * 140 / 200)


def corners(x: float, y: float, heading: float, half_length: float, half_width: float) -> np.ndarray:
    signs = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)])
    along, across = signs[:, 0] * half_length, signs[:, 1] * half_width
    return np.column_stack(
        [x + along * math.cos(heading) - across * math.sin(heading), y + along * math.sin(heading) + across * math.cos(heading)]
    )


def overlap_by_sampling(one: tuple[float, ...], other: tuple[float, ...]) -> bool:
    """Does any of a dense set of points of one rectangle, its border included, lie in the other?"""
    a, b, _, d = corners(*one)
    u, v = np.meshgrid(np.linspace(0, 1, 60), np.linspace(0, 1, 60))
    points = a + u[..., None] * (b - a) + v[..., None] * (d - a)
    x, y, heading, half_length, half_width = other
    along = (points[..., 0] - x) * math.cos(heading) + (points[..., 1] - y) * math.sin(heading)
    across = (points[..., 1] - y) * math.cos(heading) - (points[..., 0] - x) * math.sin(heading)
    return bool(((abs(along) <= half_length) & (abs(across) <= half_width)).any())


@settings(max_examples=examples(300), deadline=None)
@given(
    st.floats(-8, 8),
    st.floats(-5, 5),
    st.floats(-math.pi, math.pi),
    st.floats(1.5, 6.0),
    st.floats(0.7, 1.3),
    st.floats(-math.pi, math.pi),
)
def test_rectangles_hit_where_points_of_one_lie_in_the_other(
    x: float, y: float, heading: float, half_length: float, half_width: float, ego_heading: float
) -> None:
    ego = (0.0, 0.0, ego_heading, 2.4, 0.9)
    shrunk, grown = ((x, y, heading, half_length + by, half_width + by) for by in (-0.15, 0.15))
    pose = np.array([0.0, 0.0, ego_heading, 0.0, 0.0, 0.0, 0.0, 0.0])
    is_hit = hit(np.array([(x, y, heading, half_length, half_width)]), pose, np.array([2.4, 0.9])) >= 0
    if overlap_by_sampling(shrunk, ego):
        assert is_hit
    if not overlap_by_sampling(grown, ego) and not overlap_by_sampling(ego, grown):
        assert not is_hit


@pytest.mark.parametrize(
    ("begin", "end", "struck"),
    [
        ((7.5, 0.0, 0.0), (-7.5, 0.0, 0.0), True),
        ((7.5, 1.89, 0.0), (-7.5, 1.89, 0.0), True),
        ((7.5, 1.91, 0.0), (-7.5, 1.91, 0.0), False),
        ((7.5, 4.0, 0.0), (-7.5, -4.0, 0.0), True),
        ((30.0, 0.0, 0.0), (4.6, 0.0, 0.0), False),
        ((-4.6, 0.0, 0.0), (-30.0, 0.0, 0.0), False),
        ((7.5, 1.95, 3.13), (-7.5, 1.95, -3.13), False),  # a turn of 0.02 rad, not of nearly a circle
        ((7.5, 1.95, 0.0), (-7.5, 1.95, 0.5), True),
        ((np.nan, np.nan, 0.0), (-7.5, 0.0, 0.0), False),
        ((7.5, 0.0, 0.0), (np.nan, np.nan, 0.0), False),
    ],
)
def test_collisions_within_a_step(begin: tuple[float, float, float], end: tuple[float, float, float], struck: bool) -> None:
    far = [300.0, 0.0, 0.0, 2.0, 0.9]
    before, after = (np.array([far, [*place, 2.0, 0.9]]) for place in (begin, end))
    assert (swept(before, after, np.zeros(3), np.zeros(8), SIZE) == 1) is struck
    moved = np.array([[15.0, 3.0, 0.0]] * 2)  # all of it seen from a vehicle that moves itself
    before[:, :3] += moved
    after[:, :3] += 2 * moved
    assert (swept(before, after, moved[0], np.append(2 * moved[0], np.zeros(5)), SIZE) == 1) is struck


def test_the_path_runs_along_the_lane() -> None:
    path = np.zeros((13, 7))
    path[:, 0] = np.arange(13) * 0.05
    geometry.path_of(LINE, LANES, 1, 300.0, 25.0, path)
    for row in path:
        s, d = project(LINE[:, :5], row[1], row[2], 300 + 25 * row[0])
        assert d == pytest.approx(3.5, abs=1e-9)
        assert row[3] == pytest.approx(np.interp(s, LINE[:, 0], LINE[:, 3]), abs=1e-6)
    assert np.hypot(*np.diff(path[:, 1:3], axis=0).T) == pytest.approx(np.full(12, 25 * 0.05), rel=1e-4)
    assert path[:, 4] == pytest.approx(np.full(13, 0.004 / (1 - 0.004 * 3.5)), rel=1e-6)


def test_the_path_goes_on_beside_the_line_after_the_lane_s_end() -> None:
    lanes = LANES.copy()
    lanes[LINE[:, 0] > 305, 1] = np.nan
    path = np.zeros((13, 7))
    path[:, 0] = np.arange(13) * 0.05
    for begin in (300.0, 306.0, 320.0):
        geometry.path_of(LINE, lanes, 1, begin, 25.0, path)
        offsets = [project(LINE[:, :5], row[1], row[2], begin + 25 * row[0])[1] for row in path]
        assert offsets == pytest.approx([3.5] * 13, abs=1e-9)
        assert path[:, 4] == pytest.approx(np.full(13, 0.004 / (1 - 0.004 * 3.5)), rel=1e-6)


def test_slopes_do_not_jump_where_lanes_begin_and_end() -> None:
    s = LINE[:, 0]
    centres = np.column_stack(
        [0.01 * s, np.where((s >= 200) & (s <= 250), 3.5 + 0.02 * s, np.nan), np.where(s == 300, 7.0, np.nan)]
    )
    taken = slopes(LINE, centres)
    assert taken[:, 0] == pytest.approx(np.full(len(s), 0.01))
    there = ~np.isnan(centres[:, 1])
    assert taken[there, 1] == pytest.approx(np.full(there.sum(), 0.02))
    assert np.isnan(taken[~there, 1]).all()
    assert taken[s == 300, 2] == pytest.approx(0)
    lanes = lanes_of(0.0, 0.0, 0.0)
    lanes[:, :, 0], lanes[:, :, 3] = centres, taken
    for place in (200.2, 203.0, 204.9, 245.2, 249.8):
        offset = 3.5 + 0.02 * place
        bend = 0.004 if place > 200 else 0.0
        signals = observed([], place, offset, lanes)
        assert signals["road_curvature"] == pytest.approx(bend / (1 - bend * offset), abs=1e-6)


def test_the_speed_keeper_brakes_for_a_leader_and_reaches_the_limit() -> None:
    def acceleration(**signals: float) -> float:
        values = dict.fromkeys(NAMES, 0.0) | {"speed": 20.0, "limit_ahead": 30.0, "gap": 1000.0, "leader_speed": 20.0} | signals
        return keeper_acceleration([values[name] for name in NAMES])

    assert acceleration() == pytest.approx(1.5 * (1 - (2 / 3) ** 4))
    assert acceleration(speed=30.0) == pytest.approx(0)
    assert acceleration(speed=35.0) < 0
    assert acceleration(speed=35.0, limit_ahead=10.0) == pytest.approx(-2.0), "as comfortable as for a leader"
    assert acceleration(gap=20.0) < -1
    assert acceleration(gap=200.0) > 0
    assert math.isfinite(acceleration(gap=-1.0))
