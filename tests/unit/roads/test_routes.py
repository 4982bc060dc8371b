"""Corridors of routes with ramps, merges and changing lanes, and the routes that are refused."""

import re

import numpy as np
import pytest
from tests.support.networks import built, crossing, edge, entrance, generated, node, roundabout
from tests.support.values import faults_of, faulty_fields

from drivecal.domain.errors import InvalidInputError
from drivecal.roads.corridor import Corridor, corridor
from drivecal.roads.network import read_network

NAME = "road.net.xml"


def drive(content: bytes, *route: str) -> Corridor:
    return corridor(read_network(content, NAME), route, NAME)


def refused(content: bytes, *route: str) -> tuple[str, str]:
    """Field and message of the refusal, which names the file and has a remedy."""
    (problem,) = faults_of(drive, content, *route)
    assert problem.remedy
    assert NAME in problem.field + problem.message
    return problem.field, problem.message


@pytest.mark.parametrize("options", [(), ("--no-internal-links",)], ids=["inside", "without"])
def test_on_the_main_road_the_acceleration_lane_is_a_track_that_begins_and_ends(options: tuple[str, ...]) -> None:
    road = drive(entrance(*options), "before", "beside", "after")
    beside, right, left = road.tracks
    assert [piece.edge for piece in beside.lanes] == ["beside"]
    assert beside.ends
    assert 400 < beside.begin < 430
    assert 690 < beside.end < 700
    assert (right.begin, right.end, right.ends) == (0.0, road.length, False)
    assert [(piece.edge, piece.index) for piece in left.lanes if not piece.edge.startswith(":")] == [
        ("before", 1),
        ("beside", 2),
        ("after", 1),
    ]
    assert np.isnan(road.centres[0]).tolist() == [True, False, False]
    middle = len(road.line[:, 0]) // 2
    assert road.centres[middle, 0] < road.centres[middle, 1] < road.centres[middle, 2]


def test_from_the_ramp_the_line_changes_to_a_lane_that_goes_on() -> None:
    road = drive(entrance(), "ramp", "beside", "after")
    assert not road.tracks[1].ends
    assert road.tracks[0].ends
    start, end = road.centres[0], road.centres[-1]
    assert start[0] == pytest.approx(0.0, abs=0.1)  # the ramp
    assert end[1] == pytest.approx(0.0, abs=0.1)  # the right lane that goes on
    assert road.line[-1, 0] == pytest.approx(road.length)
    assert np.max(np.abs(road.line[:, 4])) < 0.05


def test_widths_and_limits_are_those_of_each_edge() -> None:
    road = drive(entrance(), "before", "beside", "after")
    for s, width, limit in ((100.0, 3.75, 33.33), (550.0, 3.5, 33.33), (1000.0, 3.0, 27.78)):
        row = int(np.searchsorted(road.line[:, 0], s))
        assert road.widths[row, 1] == pytest.approx(width)
        assert road.limits[row, 1] == pytest.approx(limit)


def test_positions_on_lanes_inside_of_junctions_are_known_too() -> None:
    road = drive(entrance(), "before", "beside", "after")
    inside = [piece for piece in road.tracks[1].lanes if piece.edge.startswith(":")]
    assert inside
    s, d = road.position(inside[0].edge, inside[0].index, 0.0)
    assert s == pytest.approx(inside[0].begin)
    assert road.lane_at(s, d) == 1


def test_a_lane_or_position_that_is_not_there_is_refused() -> None:
    road = drive(entrance(), "before", "beside", "after")
    for place, field in ((("before", 2, 0.0), "lane"), (("ramp", 0, 0.0), "edge"), (("before", 0, 5000.0), "s")):
        assert faulty_fields(road.position, *place) == [field]
    for (s, lane), field in (((100.0, 2), "lane"), ((5000.0, 0), "s"), ((-1.0, 0), "s")):
        assert faulty_fields(road.piece, s, lane) == [field]
    assert road.piece(100.0, 1).edge == "before"
    assert road.piece(550.0, 0).edge == "beside"


def test_a_network_of_netgenerate_is_driven_along_its_edges() -> None:
    content = generated("--grid", "--grid.x-number", "6", "--grid.y-number", "1", "--grid.length", "400", "-L", "3")
    road = drive(content, "A0B0", "B0C0", "C0D0", "D0E0", "E0F0")
    assert road.length == pytest.approx(2000.0)
    assert [not track.ends for track in road.tracks] == [True] * 3
    assert road.centres[0].tolist() == pytest.approx([0.0, 3.2, 6.4])


def changed(content: bytes, pattern: str, replacement: str) -> bytes:
    text, count = re.subn(pattern, replacement, content.decode(), flags=re.DOTALL)
    assert count
    return text.encode()


def test_crossings_are_driven_if_nobody_gives_way_and_traffic_lights_are_not() -> None:
    road = corridor(read_network(crossing(), "n"), ["west", "east"], "n", crossings=True)
    assert len(road.tracks) == 1
    with pytest.raises(InvalidInputError):
        corridor(read_network(crossing("traffic_light"), "n"), ["west", "east"], "n", crossings=True)


def test_crossings_are_refused() -> None:
    field, message = refused(crossing(), "west", "east")
    assert field == "route[1]"
    assert "south" in message
    field, message = refused(crossing("traffic_light"), "west", "east")
    assert field == "route[1]"
    assert "traffic lights" in message
    for kind in ("allway_stop", "priority_stop", "right_before_left"):
        assert refused(crossing(kind), "west", "east")[0] == "route[1]"


def test_roundabouts_are_refused() -> None:
    field, message = refused(roundabout(), "in", "r1", "r2", "out")
    assert field == "route[1]"
    assert "roundabout" in message


def test_edges_that_are_missing_unconnected_or_inside_of_junctions_are_refused() -> None:
    content = entrance()
    assert refused(content, "before", "besides", "after")[0] == "route[1]"
    assert refused(content, "ramp", "after")[0] == "route[1]"
    assert refused(content, "before", "ramp")[0] == "route[1]"
    inside = next(name for name in read_network(content, NAME).edges if name.startswith(":"))
    assert refused(content, inside)[0] == "route[0]"
    for route in ((), ("before", "before")):
        with pytest.raises(InvalidInputError):
            drive(content, *route)


def test_roads_without_lanes_for_cars_are_refused() -> None:
    content = changed(entrance(), r'(<lane id="beside_\d" index="\d") ', r'\1 allow="bus" ')
    field, message = refused(content, "before", "beside", "after")
    assert field == "route[1]"
    assert "passenger cars" in message
    content = changed(entrance(), r'(<lane id="after_\d" index="\d") ', r'\1 disallow="passenger truck" ')
    assert refused(content, "before", "beside", "after")[0] == "route[2]"


def test_lanes_for_buses_alone_are_no_tracks() -> None:
    content = changed(entrance(), r'(<lane id="before_0" index="0") ', r'\1 allow="bus" ')
    road = drive(content, "before", "beside", "after")
    assert [piece.index for track in road.tracks for piece in track.lanes if piece.edge == "before"] == [1]


def test_turning_back_is_refused() -> None:
    nodes = [node("a", 0, 0), node("b", 500, 0)]
    edges = [edge("there", "a", "b", 1), edge("back", "b", "a", 1)]
    turning = [{"from": "there", "to": "back", "fromLane": "0", "toLane": "0"}]
    content = built(nodes, edges, turning)
    assert refused(content, "there", "back")[0] == "route[1]"


def test_a_street_corner_is_refused_as_too_tight() -> None:
    nodes = [node("a", 0, 0), node("b", 500, 0), node("c", 500, 500)]
    content = built(nodes, [edge("first", "a", "b", 3), edge("second", "b", "c", 3)], (), "--no-internal-links")
    assert "radius" in refused(content, "first", "second")[1] or "tight" in refused(content, "first", "second")[1]


def test_degrees_are_refused() -> None:
    nodes = [node("a", 13.2, 52.3), node("b", 13.21, 52.305)]
    content = built(nodes, [edge("first", "a", "b", 2)], (), "--precision", "8", "--offset.disable-normalization")
    field, message = refused(content, "first")
    assert field == "route[0]"
    assert "degrees" in message


def test_lengths_that_contradict_the_shape_are_refused() -> None:
    content = changed(entrance(), r'(<lane id="beside_1"[^>]*? length=)"[^"]*"', r'\1"900"')
    field, message = refused(content, "before", "beside", "after")
    assert field == "route[1]"
    assert "900" in message


@pytest.mark.parametrize(
    ("edge", "lane", "factor"), [("beside", 0, 1.105), ("beside", 2, 0.895), (":b_1", 1, 3.0), ("after", 1, 1.105)]
)
def test_every_lane_beside_the_route_has_the_length_of_its_shape(edge: str, lane: int, factor: float) -> None:
    """SUMO moves a vehicle by the lane's length. With a wrong length it approaches at another speed than observed."""
    pattern = rf'(<lane id="{edge}_{lane}"[^>]*? length=")([^"]*)"'
    [(_, text)] = re.findall(pattern, entrance().decode())
    wrong = f"{factor * float(text):.2f}"
    field, message = refused(changed(entrance(), pattern, rf'\g<1>{wrong}"'), "before", "beside", "after")
    assert field == f"route[{['before', 'beside', 'after'].index(edge.replace(':b_1', 'beside'))}]"
    assert all(part in message for part in (edge, f"lane {lane}", wrong))
    near = f"{(1 + 0.5 * (factor - 1)) * float(text):.2f}" if edge == "after" else f"{1.01 * float(text):.2f}"
    drive(changed(entrance(), pattern, rf'\g<1>{near}"'), "before", "beside", "after")


def test_the_lanes_of_a_curve_share_a_length_but_those_of_an_edge_are_not_all_wrong() -> None:
    """netconvert gives each lane the mean of the lengths of all."""
    pattern = r'(<lane id="beside_\d"[^>]*? length=")([^"]*)"'
    lengths = [float(text) for _, text in re.findall(pattern, entrance().decode())]
    wrong = changed(entrance(), pattern, rf'\g<1>{1.06 * lengths[0]:.2f}"')
    field, message = refused(wrong, "before", "beside", "after")
    assert field == "route[1]"
    assert "edge beside" in message


def test_a_length_may_hold_the_gaps_of_a_network_without_lanes_inside_of_junctions() -> None:
    content = entrance("--no-internal-links")
    lane = read_network(content, NAME).edges["beside"].lanes[0]
    assert lane.length > 1.04 * np.hypot(*np.diff(lane.shape, axis=0).T).sum()
    drive(content, "before", "beside", "after")
    far = changed(content, r'(<lane id="beside_0"[^>]*? length=)"[^"]*"', r'\1"330"')
    assert refused(far, "before", "beside", "after")[0] == "route[1]"


def test_lanes_that_are_ordered_from_the_left_are_refused() -> None:
    text = entrance().decode()
    shapes = re.findall(r'<lane id="before_\d".*?shape="([^"]*)"', text)
    text = text.replace(shapes[0], "X").replace(shapes[1], shapes[0]).replace("X", shapes[1])
    assert refused(text.encode(), "before")[0] == "route[0]"


def test_a_route_of_a_few_metres_is_refused() -> None:
    content = built([node("a", 0, 0), node("b", 5, 0)], [edge("first", "a", "b", 1)])
    assert refused(content, "first")[0] == "route"


def test_lanes_that_lie_apart_are_named() -> None:
    content = entrance("--no-internal-links").decode()
    shifted = re.sub(r'(id="after_\d"[^>]*shape=")[^"]*"', r'\g<1>1000,0 1500,60"', content)
    field, message = refused(shifted.encode(), "before", "beside", "after")
    assert field == "route[2]"
    assert re.search(r"line \d+, the lane after_\d", message.replace("'", "").replace('"', ""))
