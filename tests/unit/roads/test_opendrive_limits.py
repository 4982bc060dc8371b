"""Speed limits of OpenDRIVE files: by place, missing ones, and lanes on which any speed is allowed."""

from functools import cache

import numpy as np
import pytest
from tests.support.opendrive_files import FILES, edited
from tests.support.values import faults_of

from drivecal.domain.errors import InvalidInputError
from drivecal.roads.conversion import Conversion, converted
from drivecal.roads.corridor import Corridor, corridor
from drivecal.roads.network import Network, read_network, unlimited
from drivecal.roads.opendrive import DRIVEN

NAME = "road.xodr"
ALONG, AGAINST = ("-5#0", "-5#1", "-5#2", "-5#3", "-5#4", "-5#5"), ("5#5", "5#4", "5#3", "5#2", "5#1", "5#0")
OWN = 'max="33.5" unit="m/s"'
LATER = '</type><type s="100" type="motorway"><speed max="20" unit="m/s"/></type><type s="130" type="motorway"/>'
"""Limits of 33.5 m/s, from s = 100 m on 20 m/s, and from 130 m on none."""


@cache
def conversion(content: bytes) -> Conversion:
    return converted(content, NAME)


def network(content: bytes) -> Network:
    return read_network(conversion(content).network, NAME)


def drive(content: bytes, route: tuple[str, ...], default_limit: float | None = None) -> Corridor:
    return corridor(network(content), route, NAME, default_limit)


def changes(road: Corridor, track: int) -> list[tuple[float, float]]:
    """Returns the places where the limit of a track changes, and the new limits."""
    limits = road.limits[:, track]
    rows = np.flatnonzero(np.diff(limits, prepend=-1.0))
    return [(float(road.line[row, 0]), float(limits[row])) for row in rows]


def test_a_limit_holds_from_its_place_on_in_the_driving_direction() -> None:
    content = edited("two_way", "</type>", LATER)
    along, against = drive(content, ALONG, 30.0), drive(content, AGAINST, 30.0)
    (first, second, third) = changes(along, len(along.tracks) - 1)
    assert (first, second[1], third[1]) == ((0.0, 33.5), 20.0, 30.0)
    assert [second[0], third[0]] == pytest.approx([100.0, 130.0], abs=1.5)
    (first, second, third) = changes(against, len(against.tracks) - 1)
    assert (first, second[1], third[1]) == ((0.0, 30.0), 20.0, 33.5)
    assert against.length - third[0] == pytest.approx(100.0, abs=2.0)
    assert third[0] - second[0] == pytest.approx(30.0, abs=1.5)


def test_sumo_s_cars_keep_the_first_limit_of_a_lane_and_a_note_says_so() -> None:
    content = edited("two_way", "</type>", LATER)
    assert {lane.limit for lane in network(content).edges["-5#0"].lanes} == {33.5}
    (note,) = [note for note in conversion(content).notes if "limit changes" in note]
    assert note.startswith("road 5: ")


def test_the_limit_of_a_lane_changes_in_its_section() -> None:
    slow = '<speed sOffset="0" max="72" unit="km/h"/><speed sOffset="60" max="54" unit="km/h"/>'
    content = edited("two_way", r'(<lane id="-2" type="driving"[^>]*>.*?)</lane>', rf"\1{slow}</lane>")
    road = drive(content, ALONG)
    assert [limit for _, limit in changes(road, 1)] == [20.0, 15.0, 33.5]
    assert changes(road, 1)[1][0] == pytest.approx(60.0, abs=1.5)
    assert changes(road, 2) == [(0.0, 33.5)]


def test_limits_count_by_their_place_in_whatever_order_they_stand() -> None:
    first, later = '<speed sOffset="0" max="72" unit="km/h"/>', '<speed sOffset="60" max="54" unit="km/h"/>'
    content = edited("two_way", r'(<lane id="-2" type="driving"[^>]*>.*?)</lane>', rf"\1{later}{first}</lane>")
    assert [limit for _, limit in changes(drive(content, ALONG), 1)] == [20.0, 15.0, 33.5]


@pytest.mark.parametrize("kind", sorted(DRIVEN))
def test_all_driven_lanes_are_in_the_network(kind: str) -> None:
    content = edited("two_way", '<lane id="-2" type="driving"', f'<lane id="-2" type="{kind}"')
    assert len(network(content).edges["-5#0"].lanes) == len(network(FILES["two_way"]()).edges["-5#0"].lanes)


@pytest.mark.parametrize(
    ("pattern", "replacement"),
    [
        (OWN, 'max="undefined"'),
        (OWN, 'max="0" unit="mph"'),
        (OWN, 'max="-1"'),
        (r"<type.*?</type>", ""),
        (r"<speed [^>]*/>(?=</type>)", ""),
    ],
)
def test_a_route_without_limits_is_refused_by_road_and_field(pattern: str, replacement: str) -> None:
    content = edited("two_way", pattern, replacement)
    (problem,) = faults_of(drive, content, ALONG)
    assert (problem.field, bool(problem.remedy)) == ("default_limit", True)
    assert "road 5" in problem.message
    road = drive(content, ALONG, 36.0)
    assert np.all(np.isnan(road.limits) | (road.limits == 36.0))
    assert "-5#0_0" in unlimited(network(content))


def test_a_default_limit_holds_only_where_the_file_has_none() -> None:
    content = FILES["two_way"]()
    assert np.nanmax(drive(content, ALONG, 50.0).limits) == 33.5
    assert unlimited(network(content)) == ()


def test_no_limit_is_a_stated_speed_and_not_that_of_the_road() -> None:
    content = edited("two_way", OWN, 'max="no limit"')
    road = drive(content, ALONG)
    assert np.nanmin(road.limits) == np.nanmax(road.limits) == 70.0
    assert {lane.limit for lane in network(content).edges["-5#0"].lanes} == {70.0}
    (note,) = [note for note in conversion(content).notes if "no limit" in note]
    assert (note.startswith("road 5: "), "70 m/s" in note) == (True, True)
    free = '<speed sOffset="0" max="no limit"/>'
    beside = edited("two_way", r'(<lane id="-2" type="driving"[^>]*>.*?)</lane>', rf"\1{free}</lane>")
    assert drive(beside, ALONG).limits[10].tolist()[1:] == [70.0, 33.5]


@pytest.mark.parametrize(("limit", "notes"), [("undefined", 0), ("0", 1), ("-1.0", 1)])
def test_an_undefined_limit_of_a_lane_leaves_that_of_the_road(limit: str, notes: int) -> None:
    free = f'<speed sOffset="0" max="{limit}"/>'
    content = edited("two_way", r'(<lane id="-2" type="driving"[^>]*>.*?)</lane>', rf"\1{free}</lane>", count=0)
    assert np.nanmax(drive(content, ALONG).limits) == 33.5
    assert sum("<speed>" in note and "undefined" in note for note in conversion(content).notes) == notes


def test_a_junction_without_limits_has_that_of_the_lane_before() -> None:
    """The main road has a limit of 75 mph; the ramp and its way through the junction have none."""
    content = edited("entrance", r'(<road [^>]*junction="7"[^>]*>.*?)<type.*?</type>', r"\1")
    road = drive(content, ("-1", "-2#0"))
    limits = [limit for _, limit in changes(road, len(road.tracks) - 1)]
    assert limits == [pytest.approx(75 * 0.44704, abs=1e-3), pytest.approx(120 / 3.6, abs=1e-3)]
    with pytest.raises(InvalidInputError) as error:
        drive(content, ("-3", "-2#0"))
    assert [problem.field for problem in error.value.problems] == ["default_limit"]
    assert "road 3" in error.value.problems[0].message


def test_a_network_with_absurd_limits_is_refused() -> None:
    content = conversion(edited("two_way", "</type>", LATER)).network
    for text in (b"0.5,20", b"0.0,1e9", b"0.0,x", b"0.0,20 2.0,20", b""):
        damaged = content.replace(b'"drivecal.limits" value="', b'"drivecal.limits" value="' + text + b" ", 1)
        if not text:
            damaged = content.replace(b'"drivecal.limits" value="0', b'"drivecal.limits" valu="0', 1)
        assert "line " in faults_of(read_network, damaged, NAME)[0].message
