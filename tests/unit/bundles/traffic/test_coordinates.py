"""Positions by coordinates: on the roads of the drive, and on one of several roads above each other."""

from functools import cache
from math import pi

import pytest
from tests.support.networks import built, edge, node
from tests.support.scenario_files import CARS, absolute, maps, of_file, scenario, start
from tests.support.values import faults_of

from drivecal.bundles.traffic.elements import read_tree
from drivecal.bundles.traffic.places import FilePlace, Map
from drivecal.roads.network import read_network

NODES = [
    *(node(f"n{x}", x, 0) for x in (0, 400, 1000)),
    *(node(f"o{x}", x, 25) for x in (1000, 0)),
    *(node(f"b{y}", 700, y) for y in (-300, 300)),
    *(node(f"f{x}", x, 500) for x in (0, 1000)),
]
EDGES = [
    edge("first", "n0", "n400", 2),
    edge("second", "n400", "n1000", 2),
    edge("oncoming", "o1000", "o0", 2),  # a carriageway of its own
    edge("bridge", "b-300", "b300", 2),
    edge("far", "f0", "f1000", 2),
]
RAMP = edge("ramp", "n400", "b-300", 1, shape="400,0 450,-10 550,-150 700,-310")
ROUTE = ["first", "second"]


@cache
def roads(connected: bool) -> Map:
    return Map(
        read_network(built(NODES, [*EDGES, RAMP] if connected else EDGES, (), "--offset.disable-normalization", "true"), "n"),
        None,
    )


def placed(x: float, y: float, heading: float | None = None, route: list[str] = ROUTE, *, connected: bool = True) -> FilePlace:
    turned = "" if heading is None else f' h="{heading}"'
    content = f'\n<Position>\n<WorldPosition x="{x}" y="{y}"{turned}/></Position>'
    return roads(connected).place(read_tree(content.encode(), "a.xosc", "Position"), {}, route)


def refused(*place: float, **options: bool | list[str]) -> str:
    (problem,) = faults_of(placed, *place, **options)
    assert "line 3" in problem.message or "line 3" in problem.field
    return problem.message


CROSSING = (701.6, -1.6)
"""On the left lane of the bridge, above the left lane of the route."""


@pytest.mark.parametrize(
    ("heading", "route", "edge_there"),
    [
        (None, ROUTE, "second"),
        (0.1, ROUTE, "second"),
        (0.1, [], "second"),
        (0.5 * pi - 0.1, ROUTE, "bridge"),
        (0.5 * pi, [], "bridge"),
    ],
)
def test_of_roads_above_each_other_the_heading_decides(heading: float | None, route: list[str], edge_there: str) -> None:
    assert placed(*CROSSING, heading, route).edge == edge_there


def test_nothing_is_guessed_if_neither_heading_nor_route_decide() -> None:
    message = refused(*CROSSING, route=[])
    assert "bridge" in message
    assert "second" in message


def test_roads_that_do_not_belong_to_the_drive_are_not_looked_at() -> None:
    assert placed(*CROSSING, 1.4, connected=False).edge == "second"
    for place in ((701.6, 100.0), (500.0, 498.0)):
        message = refused(*place, connected=False)
        assert "bridge" in message or "far" in message
    assert placed(701.6, 100.0).edge == "bridge"
    assert placed(500.0, 498.0, route=[]).edge == "far"


def test_the_other_carriageway_belongs_to_the_drive() -> None:
    there = placed(600.0, 29.8, connected=False)
    assert (there.edge, there.index) == ("oncoming", 0)
    assert there.position == pytest.approx(400, abs=0.1)


def test_places_where_edges_meet_are_on_the_closest_lane() -> None:
    assert placed(399.0, -4.8).edge == "first"
    assert placed(401.0, -1.6).edge in {"second", "first"}


def test_a_place_on_no_lane_is_refused() -> None:
    assert "no lane" in refused(100.0, 60.0)


def test_a_start_on_one_of_several_roads_is_that_of_its_heading(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(maps(), "maps/motorway.xodr", roads(True))
    (x, y), at = CROSSING, '<Position><WorldPosition x="{}" y="{}" h="{}"/></Position>'
    starts = start("Ego", at.format(100, -1.6, 0), absolute(30)) + start("Other", at.format(x, y, pi / 2), absolute(25))
    (other,) = of_file(scenario(CARS, starts), route=["first", "second"]).scenario.traffic
    assert (other.edge, other.path) == ("bridge", None)
    starts = starts.replace(f'x="{x}" y="{y}"', 'x="500" y="498.4"')
    (problem,) = faults_of(of_file, scenario(CARS, starts.replace(str(pi / 2), "0")), route=["first"])
    assert problem.remedy
