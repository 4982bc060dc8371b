"""Properties of corridors: places on the road and coordinates belong to each other."""

from math import cos, sin

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from tests.support.frenet import project as project_one
from tests.support.networks import REAL, entrance, real_corridor
from tests.support.roads import to_cartesian

from drivecal.roads.corridor import Corridor, corridor
from drivecal.roads.lines import nodes_of, project, smoothed, table
from drivecal.roads.network import read_network

SHARES = st.floats(0.0, 1.0)
OFFSETS = st.floats(-12.0, 12.0)
ROUTES = st.sampled_from([*REAL, "built"])


def road(name: str) -> Corridor:
    if name != "built":
        return real_corridor(name)
    return corridor(read_network(entrance(), "road.net.xml"), ("before", "beside", "after"), "road.net.xml")


@given(ROUTES, st.lists(st.tuples(SHARES, OFFSETS), min_size=1, max_size=20))
def test_s_and_d_are_found_again_from_x_and_y(name: str, places: list[tuple[float, float]]) -> None:
    line = road(name).line
    s, d = np.array(places).T
    s = s * line[-1, 0]
    d = d * np.minimum(1.0, 0.5 / np.maximum(np.abs(np.interp(s, line[:, 0], line[:, 4])) * 12.0, 1e-9))
    points = np.array([to_cartesian(line, *place)[:2] for place in zip(s.tolist(), d.tolist(), strict=True)])
    found_s, found_d = project(line, points, s + 0.3)
    assert np.allclose(found_s, s, atol=1e-4)
    assert np.allclose(found_d, d, atol=1e-4)


@given(ROUTES, SHARES, st.floats(-3.0, 3.0), st.floats(-5.0, 5.0))
def test_many_points_are_projected_as_one_is(name: str, share: float, d: float, off: float) -> None:
    line = road(name).line
    s = share * float(line[-1, 0])
    x, y, _ = to_cartesian(line, s, d)
    one = project_one(line, x, y, s + off)
    many_s, many_d = project(line, np.array([[x, y]]), np.array([s + off]))
    assert np.allclose([many_s[0], many_d[0]], one, atol=1e-7)


@given(ROUTES, SHARES, SHARES)
def test_the_centre_of_a_lane_is_in_its_track(name: str, which: float, share: float) -> None:
    lanes = road(name)
    number = min(int(which * len(lanes.tracks)), len(lanes.tracks) - 1)
    track = lanes.tracks[number]
    piece = track.lanes[min(int(share * len(track.lanes)), len(track.lanes) - 1)]
    place = lanes.places[piece.edge, piece.index]
    s, d = lanes.position(piece.edge, piece.index, float(share * place[-1, 0]))
    if track.begin + 1.0 <= s <= track.end - 1.0:
        off = [abs(float(np.interp(s, lanes.line[:, 0], centres)) - d) for centres in lanes.centres.T]
        assert off[number] < 0.2
        assert lanes.lane_at(s, d) in [other for other, distance in enumerate(off) if distance <= off[number] + 1e-9]


@given(
    st.floats(-1e6, 1e6),
    st.floats(-1e6, 1e6),
    st.floats(-3.2, 3.2),
    st.lists(st.floats(-0.05, 0.05), min_size=2, max_size=30),
    st.floats(5.0, 60.0),
)
def test_a_line_stays_near_any_polyline(x: float, y: float, heading: float, turns: list[float], step: float) -> None:
    headings = heading + np.cumsum(turns)
    steps = step * np.column_stack([np.cos(headings), np.sin(headings)])
    points = np.array([x, y]) + np.vstack([[0.0, 0.0], np.cumsum(steps, axis=0)])
    nodes = nodes_of(points)
    made = smoothed(nodes, np.full(len(nodes), 0.09))
    assert np.max(np.hypot(*(made - nodes).T)) < 0.1
    line = table(made)
    assert abs(line[-1, 0] - step * len(turns)) < 0.01 * step * len(turns) + 0.1
    end = to_cartesian(line, float(line[-1, 0]), 0.0)
    assert np.hypot(end[0] - points[-1, 0], end[1] - points[-1, 1]) < 0.1
    assert abs(cos(end[2]) - cos(headings[-1])) < 0.2
    assert abs(sin(end[2]) - sin(headings[-1])) < 0.2
