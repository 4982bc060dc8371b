"""OpenDRIVE: geometry and conversion against a reader of its own, notes, and files that are refused."""

import re
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.support.changes import replace_in
from tests.support.networks import program
from tests.support.opendrive_files import FILES, PAVED, Road, arc, document, edited
from tests.support.opendrive_reader import Floats, lane_centres, lane_width, roads
from tests.support.roads import to_cartesian
from tests.support.values import faults_of, present

from drivecal.domain.errors import InvalidInputError, UnavailableError
from drivecal.roads import conversion
from drivecal.roads.conversion import Conversion, converted
from drivecal.roads.corridor import Corridor, corridor
from drivecal.roads.network import network_file, read_network, source_of
from drivecal.roads.opendrive import DRIVEN, read_opendrive

NAME = "road.xodr"
NEAR = 0.1
DEFAULT_LIMIT = 31.0
"""Metres per second, for ramps and roads of these files that have no limit."""
ROUTES: dict[tuple[str, str], tuple[str, ...]] = {
    ("exit_ramp", "through"): ("-1#0", "-1#1", "-1#2", "-2"),
    ("exit_ramp", "exit"): ("-1#0", "-1#1", "-1#2", "-3"),
    ("entrance", "through"): ("-1", "-2#0", "-2#1", "-2#2", "-2#3"),
    ("entrance", "ramp"): ("-3", "-2#0", "-2#1", "-2#2", "-2#3"),
    ("direct", "through"): ("-1#0", "-1#1", "-1#2", "-2", "-4#0", "-4#1", "-4#2", "-4#3"),
    ("direct", "exit"): ("-1#0", "-1#1", "-1#2", "-3"),
    ("direct", "ramp"): ("-5", "-4#0", "-4#1", "-4#2", "-4#3"),
    ("two_way", "along"): ("-5#0", "-5#1", "-5#2", "-5#3", "-5#4", "-5#5"),
    ("two_way", "against"): ("5#5", "5#4", "5#3", "5#2", "5#1", "5#0"),
}
every_file = pytest.mark.parametrize("file", FILES)
every_route = pytest.mark.parametrize("route", ROUTES, ids="-".join)


@cache
def conversion_of(file: str) -> Conversion:
    return converted(FILES[file](), NAME)


@cache
def drive(route: tuple[str, str]) -> Corridor:
    return corridor(read_network(conversion_of(route[0]).network, NAME), ROUTES[route], NAME, DEFAULT_LIMIT)


@cache
def truth(file: str) -> dict[tuple[str, float, int], Floats]:
    return lane_centres(FILES[file](), DRIVEN)


def distance(x: float, y: float, points: Floats) -> float:
    """Distance to a polyline."""
    begins, steps = points[:-1], np.diff(points, axis=0)
    share = np.clip(((np.array([x, y]) - begins) * steps).sum(1) / (steps**2).sum(1), 0.0, 1.0)
    return float(np.hypot(*(begins + share[:, None] * steps - (x, y)).T).min())


@every_file
def test_lanes_of_the_file_are_where_another_reader_finds_them(file: str) -> None:
    content = FILES[file]()
    mine = read_opendrive(content, NAME)
    for road in roads(content):
        for number, (begin, end, section) in enumerate(road.sections()):
            s = np.linspace(begin, end - 1e-6, 9)
            for lane in mine.roads[road.id].sections[number].lanes:
                if lane == 0:
                    continue
                points, widths = mine.roads[road.id].centre(number, lane, s)
                element = next(entry for entry in section.iter("lane") if entry.get("id") == str(lane))
                assert np.allclose(points, [road.centre(section, lane, at) for at in s], atol=1e-6)
                assert np.allclose(widths, [lane_width(element, at - begin) for at in s], atol=1e-9)


def test_a_closed_road_is_driven_around_once() -> None:
    links = {"predecessor": ("road", "1"), "successor": ("road", "1")}
    ring = Road("1", [arc(300.0, 2 * np.pi / 300.0)], [(0.0, dict.fromkeys((1, -1), ("driving", PAVED)))], links=links)
    ring.lane_links = {0: {1: (1, 1), -1: (-1, -1)}}
    edges = read_network(converted(document([ring]), NAME).network, NAME).edges.values()
    lanes = [lane for edge in edges for lane in edge.lanes]
    halves = [lane.shape for lane in lanes if lane.edge in {"-1#0", "-1#1"}]
    assert sum(lane.length for lane in lanes) == pytest.approx(600.0, abs=1.0)
    assert np.hypot(*(halves[0][len(halves[0]) // 2] - halves[1][len(halves[1]) // 2])) > 90.0


@pytest.mark.slow(
    "exit_ramp-through", "entrance-through", "direct-through", "direct-exit", "two_way-against", "two_way-along", "direct-ramp"
)
@every_route
def test_tracks_lie_on_lanes_of_the_file(route: tuple[str, str]) -> None:
    road, lanes = drive(route), truth(route[0])
    for number in range(len(road.tracks)):
        for row in np.flatnonzero(~np.isnan(road.centres[:, number]))[::10]:
            x, y, _ = to_cartesian(road.line, road.line[row, 0], road.centres[row, number])
            assert min(distance(x, y, points) for points in lanes.values()) < NEAR


@every_route
def test_every_lane_of_the_file_beside_the_drive_is_a_track(route: tuple[str, str]) -> None:
    """From the file to the corridor: no lane is left out, where it is wide enough for a car."""
    road, file = drive(route), roads(FILES[route[0]]())
    driven = {name.strip("-").split("#")[0] for name in ROUTES[route]}
    side = -1 if ROUTES[route][0].startswith("-") else 1
    for entry in file:
        for begin, end, section in entry.sections() if entry.id in driven else ():
            for lane in section.iter("lane"):
                index = int(lane.get("id", "0"))
                if index * side <= 0 or lane.get("type") not in DRIVEN:
                    continue
                for s in np.linspace(begin + 10.0, end - 10.0, 7):
                    if lane_width(lane, s - begin) > 2.0:
                        point = np.array([entry.centre(section, index, s)])
                        at = nearest(road, point)
                        assert at is not None, (entry.id, index, s)
                        track = present(road.lane_at(*at))
                        row = round(at[0] / road.line[1, 0])
                        assert road.widths[row, track] == pytest.approx(lane_width(lane, s - begin), abs=0.05)
                        assert road.centres[row, track] == pytest.approx(at[1], abs=NEAR)


def nearest(road: Corridor, point: Floats) -> tuple[float, float] | None:
    from drivecal.roads.lines import project

    row = int(np.argmin(np.hypot(*(road.line[:, 1:3] - point).T)))
    s, d = project(road.line, point, road.line[row : row + 1, 0])
    return None if np.isnan(s[0]) else (float(s[0]), float(d[0]))


@every_route
def test_the_line_of_a_converted_road_is_smooth_and_near_its_lanes(route: tuple[str, str]) -> None:
    road, lanes = drive(route), truth(route[0])
    assert np.max(np.abs(np.diff(road.line[:, 4]))) < 2e-3
    if route[1] not in {"exit", "ramp"}:  # there it changes lanes
        assert max(min(distance(x, y, points) for points in lanes.values()) for x, y in road.line[::20, 1:3]) < NEAR


def test_limits_are_those_of_the_file() -> None:
    through, leaving, beside = (
        np.nanmax(drive(route).limits, axis=1)
        for route in (("exit_ramp", "through"), ("exit_ramp", "exit"), ("entrance", "through"))
    )
    assert through[10] == pytest.approx(130 / 3.6, abs=1e-3)
    assert through[-10] == pytest.approx(100 / 3.6, abs=1e-3)
    assert leaving[-10] == pytest.approx(60 / 3.6, abs=1e-3)
    assert beside[10] == pytest.approx(75 * 0.44704, abs=1e-3)
    assert np.nanmax(drive(("two_way", "along")).limits) == pytest.approx(33.5)


def test_limits_of_lanes_stand_above_those_of_roads() -> None:
    slow = '<speed sOffset="0" max="72" unit="km/h"/>'
    content = edited("two_way", r'(<lane id="-2" type="driving"[^>]*>.*?)</lane>', rf"\1{slow}</lane>", count=0)
    lanes = read_network(converted(content, NAME).network, NAME).edges["-5#0"].lanes
    assert [lane.limit for lane in lanes] == pytest.approx([20.0, 33.5])


@pytest.mark.parametrize("limit", ["601", "1e9", "fast", "nan", ""])
def test_absurd_limits_are_refused_by_their_line(limit: str) -> None:
    (problem,) = faults_of(read_opendrive, edited("two_way", r'max="33.5"', f'max="{limit}"'), NAME)
    assert (problem.field, bool(problem.remedy)) == (NAME, True)
    assert re.search(r"line \d+, <speed>", problem.message)


def test_missing_widths_and_ignored_elements_are_noted() -> None:
    width = edited("two_way", r'(<lane id="-2" type="driving"[^>]*>.*?)<width [^>]*/>', r"\1")
    assert any("3.65 m" in note and "road 5" in note for note in converted(width, NAME).notes)
    sign = '<signal s="1" t="1" id="1" name="" dynamic="no" orientation="+" zOffset="0" type="274" subtype="50" value="50"/>'
    signal = edited("two_way", r"</lanes>", f"</lanes><signals>{sign}</signals>")
    assert any("signal" in note for note in converted(signal, NAME).notes)


def test_a_conversion_repeats_itself_and_names_its_source() -> None:
    content = FILES["two_way"]()
    network = converted(content, NAME).network
    assert network == converted(content, NAME).network
    assert b"generated on" not in network
    source = present(source_of(network))
    assert len(source) == 64
    assert source != source_of(conversion_of("entrance").network)
    assert network_file("a/b.xodr") == "a/b.xodr.net.xml"
    assert network_file("b.net.xml") == "b.net.xml"
    assert source_of(b"<net/>") is None
    earlier = network.replace(b" (version 3)", b"")
    assert earlier != network
    assert source_of(earlier) is None


def test_hard_shoulders_are_closed_to_cars() -> None:
    lanes = [lane for edge in read_network(conversion_of("exit_ramp").network, NAME).edges.values() for lane in edge.lanes]
    closed = [lane for lane in lanes if not lane.for_cars and not lane.edge.startswith(":")]
    assert any(lane.width == pytest.approx(2.85) for lane in closed)


def test_virtual_junctions_and_endings_in_capitals_are_read() -> None:
    connection = '<connection id="0" type="virtual"><predecessor elementType="road" elementId="5" elementS="9"/></connection>'
    junction = f'<junction id="77" name="v" type="virtual" mainRoad="5" sStart="9" sEnd="12">{connection}</junction>'
    made = converted(edited("two_way", "</OpenDRIVE>", f"{junction}</OpenDRIVE>"), "ROAD.XODR")
    assert read_network(made.network, NAME).edges.keys() == read_network(conversion_of("two_way").network, NAME).edges.keys()
    assert any("junction 77" in note for note in made.notes)
    assert network_file("ROAD.XODR") == "ROAD.XODR.net.xml"


def test_lanes_may_stand_in_any_order() -> None:
    left = r'(<left>)(<lane id="2".*?</lane>)(<lane id="1".*?</lane>)(</left>)'
    swapped = edited("two_way", left, r"\1\3\2\4", count=0)
    assert read_network(converted(swapped, NAME).network, NAME).edges["5#0"].lanes[0].shape == pytest.approx(
        read_network(conversion_of("two_way").network, NAME).edges["5#0"].lanes[0].shape, abs=1e-3
    )


@every_file
def test_sumo_takes_the_network(file: str, tmp_path: Any) -> None:
    path = tmp_path / "road.net.xml"
    path.write_bytes(conversion_of(file).network)
    script = f"import libsumo; libsumo.start(['sumo', '-n', {str(path)!r}]); libsumo.simulationStep()"
    assert subprocess.run([sys.executable, "-c", script], capture_output=True, check=False).returncode == 0


@pytest.mark.parametrize(
    ("pattern", "replacement"),
    [
        (r'revMajor="1"', 'revMajor="2"'),
        (r'(<road id="5")', r'\1 rule="LHT"'),
        (r"(<planView>).*(</planView>)", r"\1\2"),
        (r"<line ?/>", ""),
        (r"<line ?/>", "<curve/>"),
        (r"<laneSection.*</laneSection>", ""),
        (r'type="driving"', 'type="sidewalk"'),
        (r'curvature="[^"]*"', 'curvature="inf"'),
        (r'length="[^"]*"', 'length="1e300"'),
        (r'<lane id="-2"', '<lane id="-7"'),
        (r'<lane id="-2"', '<lane id="-1"'),
        (r'unit="m/s"', 'unit="furlong"'),
        (r"<OpenDRIVE>", '<!DOCTYPE OpenDRIVE [<!ENTITY a "b">]><OpenDRIVE>'),
        (r"<OpenDRIVE>(.*)</OpenDRIVE>", r"<net>\1</net>"),
        (r"<road .*</road>", ""),
        (r"</OpenDRIVE>", ""),
        (
            r"</OpenDRIVE>",
            '<junction id="4" type="direct"><connection id="0" incomingRoad="5" linkedRoad="6"/></junction></OpenDRIVE>',
        ),
        (r"<width ", "<border "),
    ],
)
def test_what_cannot_be_driven_is_refused(pattern: str, replacement: str) -> None:
    content = edited("two_way", pattern, replacement, count=0)
    route = ROUTES["two_way", "along"]
    (problem,) = faults_of(lambda: corridor(read_network(converted(content, NAME).network, NAME), route, NAME))
    assert problem.remedy
    assert NAME in problem.field + problem.message


@pytest.mark.parametrize("place", ["</OpenDRIVE>", "</lanes>"])
def test_a_file_that_includes_another_is_refused_even_if_that_one_is_there(place: str, tmp_path: Path) -> None:
    (tmp_path / "other.xml").write_text("<userData/>")
    content = edited("two_way", place, f'<include file="{tmp_path / "other.xml"}"/>{place}')
    (problem,) = faults_of(converted, content, NAME)
    assert problem.field == NAME
    assert "<include>" in problem.message


def test_without_netconvert_the_answer_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    replace_in(monkeypatch, conversion, "shutil", which=lambda *_args, **_options: None)
    with pytest.raises(UnavailableError, match=r"drivecal\[opendrive\]"):
        converted(FILES["two_way"](), NAME)


def test_netconvert_that_fails_or_hangs_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    assert conversion.netconvert() == program("netconvert")
    monkeypatch.setattr(conversion, "TIMEOUT", 0.0001)
    with pytest.raises(InvalidInputError, match="netconvert"):
        converted(FILES["two_way"](), NAME)
    monkeypatch.undo()
    monkeypatch.setattr(conversion, "netconvert", lambda: sys.executable)  # an interpreter knows none of the options
    with pytest.raises(InvalidInputError):
        converted(FILES["two_way"](), NAME)
