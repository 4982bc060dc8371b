"""SUMO route files as traffic: vehicles, trips and flows with SUMO's defaults; what is not supported is refused by line."""

from __future__ import annotations

import random
from collections.abc import Iterator
from itertools import pairwise, product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import libsumo
import numpy as np
import pytest
from scipy.sparse.csgraph import csgraph_from_dense, shortest_path
from tests.support.networks import entrance
from tests.support.scenario_files import ROUTES, with_routes

from drivecal.bundles.archives import BundleFile
from drivecal.bundles.checks import checked
from drivecal.bundles.highway import CLASSES
from drivecal.bundles.highway_checks import scenario_problems
from drivecal.bundles.highway_roads import check_roads
from drivecal.bundles.traffic import routes
from drivecal.bundles.traffic.routes import WaySearch
from drivecal.bundles.traffic.vehicle_types import MIN_GAP, SIGMA
from drivecal.domain.errors import InvalidInputError

TYPES = """<vTypeDistribution id="d"><vType id="car" probability="3"/><vType id="lorry" vClass="truck"/></vTypeDistribution>"""
"""A distribution of three cars to a lorry."""
ROUTE = '<route id="r" edges="before beside after"/>'
VEHICLE = '<vehicle id="a" route="r" depart="0" departPos="150" departSpeed="28"{}/>'


def file(content: str) -> bytes:
    """A route file with a route `r`."""
    return f"<routes>\n{ROUTE}\n{content}\n</routes>".encode()


def refusal(content: str | bytes, **data: Any) -> str:
    """The refusal of a file."""
    with pytest.raises(InvalidInputError) as error:
        with_routes(file(content) if isinstance(content, str) else content, **data)
    assert all(problem.message and problem.remedy for problem in error.value.problems)
    assert {problem.field for problem in error.value.problems} == {"routes"}
    return str(error.value)


def test_vehicles_trips_and_flows_become_entries() -> None:
    found = with_routes(ROUTES).scenario
    (car,) = found.traffic
    assert (car.id, car.model, car.lane_change, car.lane, car.s, car.speed) == ("a_1", "IDM", "LC2013", 1, 150 - 2.25, 28.0)
    assert (car.max_speed, car.time_headway, car.parameters) == (35.0, 1.2, {"lcAssertive": 2.0})
    late, joins, stream, others = found.flows
    assert (late.begin, late.number, late.lane, late.speed, late.vehicle_class) == (4.5, 1, "best", "max", "truck")
    assert (joins.route, joins.begin, joins.speed) == (["ramp", "beside", "after"], 1.0, 20.0)
    assert (stream.per_hour, stream.random, stream.number, stream.end) == (600.0, False, None, 60.0)
    assert (others.per_hour, others.random, others.model, others.sigma) == (720.0, True, "Krauss", SIGMA)
    assert list(scenario_problems("x", found, 0.1, is_whole=True)) == []


def test_entries_of_the_manifest_stay_beside_those_of_the_file() -> None:
    found = with_routes(file(VEHICLE.format("")), traffic=[{"id": "a", "lane": 0, "s": 160.0, "speed": 25.0}]).scenario
    assert [vehicle.id for vehicle in found.traffic] == ["a", "a-1"]


def test_what_has_no_effect_is_noted_with_its_line() -> None:
    notes = with_routes(ROUTES).notes
    assert any("line 11, <vehicle>" in note for note in notes)
    assert any("line 12, <person>: ignored" in note for note in notes)


def test_sumo_s_defaults_of_arrivals_are_taken_without_a_note() -> None:
    described = with_routes(file(VEHICLE.format(' arrivalPos="max" arrivalSpeed="current" arrivalLane="current"')))
    assert [car.id for car in described.scenario.traffic] == ["a"]
    assert described.notes == ()


def test_defaults_are_sumo_s(tmp_path: Path) -> None:
    types = "".join(f'<vType id="{name}" vClass="{name}"/>' for name in CLASSES)
    (tmp_path / "a.rou.xml").write_text(f"<routes>{types}</routes>")
    (tmp_path / "a.net.xml").write_bytes(entrance())
    libsumo.start(["sumo", "-n", str(tmp_path / "a.net.xml"), "-r", str(tmp_path / "a.rou.xml"), "--no-step-log"])
    try:
        kind = libsumo.vehicletype
        for name, values in CLASSES.items():
            assert (kind.getLength(name), kind.getWidth(name), kind.getSpeedDeviation(name)) == values
            assert (kind.getMinGap(name), kind.getImperfection(name), kind.getSpeedFactor(name)) == (MIN_GAP, SIGMA, 1.0)
    finally:
        libsumo.close()


@pytest.mark.parametrize(
    ("amount", "per_hour", "number", "random"),
    [
        ('vehsPerHour="900"', 900.0, None, False),
        ('perHour="900"', 900.0, None, False),
        ('period="4" number="3"', 900.0, 3, False),
        ('period="exp(0.25)"', 900.0, None, True),
        ('probability="0.25"', 900.0, None, True),
        ('number="5" end="20"', 900.0, 5, False),
    ],
)
def test_flows_have_the_file_s_amount(amount: str, per_hour: float, number: int | None, random: bool) -> None:
    (flow,) = with_routes(file(f'<flow id="f" route="r" begin="0" {amount}/>')).scenario.flows
    assert flow.per_hour == pytest.approx(per_hour)
    assert (flow.number, flow.random) == (number, random)


@pytest.mark.parametrize(
    ("content", "part"),
    [
        ('<vType id="t" carFollowModel="Wiedemann"/>' + VEHICLE.format(' type="t"'), "Wiedemann"),
        ('<vType id="t" laneChangeModel="DK2008"/>' + VEHICLE.format(' type="t"'), "DK2008"),
        ('<vType id="t" vClass="tram"/>' + VEHICLE.format(' type="t"'), "tram"),
        ('<vType id="t" taU="1"/>' + VEHICLE.format(' type="t"'), "taU"),
        ('<vType id="t" length="-3"/>' + VEHICLE.format(' type="t"'), "length"),
        ('<vType id="t" tau="nan"/>' + VEHICLE.format(' type="t"'), "tau"),
        ('<vType id="t" speedFactor="norm(x,1)"/>' + VEHICLE.format(' type="t"'), "speedFactor"),
        (VEHICLE.format(' type="none"'), "no vType none"),
        (VEHICLE.format(' reroute="true"'), "reroute"),
        (VEHICLE.format(' arrivalPos="120"'), "arrivalPos"),
        (VEHICLE.format(' arrivalSpeed="10"'), "arrivalSpeed"),
        (VEHICLE.format(' arrivalLane="1"'), "arrivalLane"),
        (VEHICLE.format(' arrivalPosLat="left"'), "arrivalPosLat"),
        ('<flow id="f" route="r" period="2" arrivalPos="random"/>', "arrivalPos"),
        (VEHICLE.format("").replace('route="r"', 'route="q"'), "no route q"),
        (VEHICLE.format("").replace('depart="0"', 'depart="triggered"'), "depart"),
        (VEHICLE.format("").replace("/>", '><stop lane="before_0" duration="3"/></vehicle>'), "stops"),
        ('<vehicle id="a" depart="0"><route edges="before"><stop lane="before_0" duration="3"/></route></vehicle>', "stops"),
        (VEHICLE.format("") * 2, "same name"),
        ('<vehicle id="a" depart="0"><route edges="before nowhere"/></vehicle>', "no edge nowhere"),
        ('<vehicle id="a" depart="0"><route edges="ramp after"/></vehicle>', "route[1]"),
        ('<trip id="a" depart="0" from="after" to="before"/>', "no way"),
        ('<trip id="a" depart="0" from="before"/>', "to is missing"),
        ('<flow id="f" route="r" begin="0"/>', "how many"),
        ('<flow id="f" route="r" period="2" vehsPerHour="3"/>', "period"),
        ('<flow id="f" route="r" period="exp(-1)"/>', "rate"),
        ('<flow id="f" route="r" period="exp(1)" number="3" end="9"/>', "number"),
        ('<vTypeDistribution id="d"/>', "no type can be drawn"),
        ('<vTypeDistribution id="d"><vType id="t" probability="0"/></vTypeDistribution>', "no type can be drawn"),
        ('<vTypeDistribution id="d"><vType id="t"/><param/></vTypeDistribution>', "<param>"),
        ('<vTypeDistribution id="d" vTypes="t"/>', "no vType t"),
        ('<vType id="t"/><vTypeDistribution id="d" vTypes="t" probabilities="0.5 0.5"/>', "probabilities"),
        ('<vType id="t"/><vTypeDistribution id="d" vTypes="t" probabilities="-1"/>', "probabilities"),
        ('<vType id="t"/><vTypeDistribution id="t" vTypes="t"/>', "same id"),
        ('<vType id="t"/><vTypeDistribution id="d" vTypes="t t"/>', "twice"),
        (TYPES + '<flow id="f" type="d" route="r" period="exp(1)" number="3"/>', "number"),
        ('<include href="/etc/passwd"/>', "include"),
        ("".join(f'<vehicle id="v{index}" route="r" depart="{index / 200}"/>' for index in range(2001)), "more than 2,000"),
    ],
)  # fmt: skip
def test_what_is_not_supported_is_refused_by_line(content: str, part: str) -> None:
    whole = with_checks(content)
    assert part in whole
    assert "a.rou.xml: line " in whole


def with_checks(content: str) -> str:
    """The refusal of a file, of its reading or of the checks of what it became."""
    scenario = {
        "network": "road.net.xml",
        "route": ["before", "beside", "after"],
        "duration": 20,
        "ego": {"lane": 0, "s": 100, "speed": 28},
        "routes": "a.rou.xml",
    }
    document = {
        "problem": "acc",
        "parameters": {"T": {"lower": 0.8, "upper": 2.5}},
        "simulator": {"kind": "highway", "controller": {"kind": "python", "file": "acc.py", "output": ["acceleration"]}},
        "scenarios": {"merge": scenario},
        "measures": {"min_ttc_s": "s"},
        "scores": {"safe": {"formula": "min_ttc_s", "direction": "maximise", "range": [0, 10]}},
    }
    files = {"road.net.xml": entrance(), "a.rou.xml": file(content), "acc.py": b""}
    with pytest.raises(InvalidInputError) as error:
        check_roads(checked(document), {name: BundleFile(text, executable=False) for name, text in files.items()})
    assert {problem.field for problem in error.value.problems} == {"scenarios.merge.routes"}
    return str(error.value)


def day(*times: float) -> str:
    """Vehicles that depart at times of day."""
    return "".join(f'<vehicle id="v{time:g}" route="r" depart="{time:g}" departPos="50" departSpeed="20"/>' for time in times)


@pytest.mark.parametrize(
    ("content", "data", "parts"),
    [
        (day(25_200, 25_230), {}, ["none of its 2", "from 0 to 20 s", "from 25200 to 25230 s", "`begin: 25200`"]),
        ('<flow id="f" route="r" begin="7:00:00" end="8:00:00" vehsPerHour="900"/>', {}, ["25200 to 28800", "`begin: 25200`"]),
        (
            '<flow id="f" route="r" begin="0" end="100" vehsPerHour="900"/>',
            {"begin": 300, "warm_up": 60},
            ["from 240 to 320 s"],
        ),
        ('<flow id="f" route="r" begin="0" period="1" number="9"/>', {"begin": 300}, ["none of its 1"]),
        (day(10), {"begin": 25_200}, ["at 10 s", "`begin: 10`"]),
        ('<vType id="t"/>', {}, ["no vehicle, trip or flow"]),
    ],
)
def test_a_file_without_a_vehicle_for_the_run_is_refused_with_its_times(
    content: str, data: dict[str, Any], parts: list[str]
) -> None:
    message = refusal(content, **data)
    assert "a.rou.xml: line 1, <routes>" in message
    for part in parts:
        assert part in message


def test_times_of_the_file_begin_at_the_scenario_s_begin() -> None:
    described = with_routes(file(day(25_000, 25_200, 25_210.5, 25_220)), begin=25_200)
    (there,) = described.scenario.traffic
    (comes,) = described.scenario.flows
    assert (there.id, there.speed, comes.id, comes.begin, comes.number) == ("v25200", 20.0, "v25210_5", 10.5, 1)
    assert [note for note in described.notes if "1 of 4" in note and "before 25200 s" in note]
    assert any("25220 s" in note for note in described.notes)


def test_vehicles_enter_in_the_warm_up_and_those_with_a_place_are_there_at_its_end() -> None:
    without = '<vehicle id="base" route="r" depart="25200" departSpeed="20"/><vehicle id="free" route="r" depart="25200" departPos="free"/>'
    content = file(day(24_800, 24_899.5, 24_900, 25_199, 25_200) + without)
    described = with_routes(content, begin=25_200, warm_up=300)
    assert [vehicle.id for vehicle in described.scenario.traffic] == ["v25200"]
    assert described.scenario.traffic == with_routes(content, begin=25_200).scenario.traffic[:1]
    assert [flow.id for flow in described.scenario.flows] == ["v24900", "v25199", "base", "free"]
    assert [flow.begin for flow in described.scenario.flows] == [-300.0, -1.0, 0.0, 0.0]
    assert [note for note in described.notes if "2 of 7" in note and "before 24900 s" in note] == [described.notes[-1]]
    assert list(scenario_problems("x", described.scenario, 0.1, is_whole=True)) == []


@pytest.mark.parametrize(
    ("amount", "begin", "number", "end", "per_hour"),
    [
        ('end="25230" vehsPerHour="900"', -98.0, None, 30.0, 900.0),
        ('end="25230" period="7"', -97.0, None, 30.0, 3600 / 7),
        ('end="25150" period="7"', -97.0, None, -50.0, 3600 / 7),
        ('number="1000" period="7"', -97.0, 1000 - 15, None, 3600 / 7),
        ('number="1000" end="25998"', -100.0, 1000 - 102, 798.0, 3600.0),
        ('number="1000" period="exp(0.5)"', -100.0, 1000 - 51, None, 1800.0),
        ('end="26000" period="exp(0.5)"', -100.0, None, 800.0, 1800.0),
    ],
)
def test_a_flow_that_began_before_is_cut_and_keeps_its_rate(
    amount: str, begin: float, number: int | None, end: float | None, per_hour: float
) -> None:
    """It began at 24998 s, 102 s before the first vehicles may enter."""
    content = file(f'<flow id="f" route="r" begin="24998" {amount}/>')
    (flow,) = with_routes(content, begin=25_200, warm_up=100).scenario.flows
    assert (flow.number, flow.end) == (number, end)
    assert (flow.begin, flow.per_hour) == pytest.approx((begin, per_hour))


def test_what_is_left_out_is_not_checked() -> None:
    bus = (
        '<vehicle id="bus" type="tram" route="q" depart="9:00:00" reroute="true"><stop lane="before_0" duration="3"/></vehicle>'
    )
    described = with_routes(file(bus + day(0)))
    assert [vehicle.id for vehicle in described.scenario.traffic] == ["v0"]


def test_types_are_drawn_by_the_seed_and_the_vehicle_s_id() -> None:
    def classes(count: int, seed: int) -> dict[str | None, str]:
        vehicles = "".join(f'<vehicle id="v{index}" type="d" route="r" depart="{(index + 1) / 20}"/>' for index in range(count))
        return {flow.id: flow.vehicle_class for flow in with_routes(file(TYPES + vehicles), seed=seed).scenario.flows}

    drawn = classes(200, 1)
    assert classes(200, 1) == drawn != classes(200, 2)
    assert classes(50, 1).items() <= drawn.items()
    assert list(drawn.values()).count("truck") == pytest.approx(50, abs=25)


def test_distributions_name_types_with_their_probabilities() -> None:
    types = """<vType id="car"/><vType id="lorry" vClass="truck" probability="9"/>"""
    for words, kind in (('probabilities="0 1"', "truck"), ('probabilities="1 0"', "passenger")):
        content = f'{types}<vTypeDistribution id="d" vTypes="car lorry" {words}/>' + day(0).replace("route=", 'type="d" route=')
        (vehicle,) = with_routes(file(content)).scenario.traffic
        assert vehicle.vehicle_class == kind


def test_an_even_flow_of_several_types_is_its_vehicles() -> None:
    content = file(TYPES + '<flow id="f" type="d" route="r" begin="100" end="400" period="2"/>')
    early, late = (with_routes(content, begin=begin, warm_up=10).scenario.flows for begin in (200, 204))
    assert [flow.begin for flow in early] == [-10.0 + 2 * index for index in range(15)]
    assert [flow.id for flow in early] == [f"f_{index}" for index in range(45, 60)]
    assert {flow.number for flow in early} == {1}
    assert len({flow.vehicle_class for flow in early}) == 2
    kinds = {flow.id: flow.vehicle_class for flow in early}
    assert all(kinds.get(flow.id, flow.vehicle_class) == flow.vehicle_class for flow in late)


def test_a_random_flow_of_several_types_is_one_of_each_with_its_share() -> None:
    content = file(TYPES + '<flow id="f" type="d" route="r" begin="0" end="60" period="exp(0.5)"/>')
    cars, lorries = with_routes(content).scenario.flows
    assert [(flow.vehicle_class, flow.per_hour, flow.random) for flow in (cars, lorries)] == [
        ("passenger", 1350.0, True),
        ("truck", 450.0, True),
    ]


def test_a_file_that_is_missing_or_no_route_file_is_refused() -> None:
    assert "<routes>" in refusal(b"<net/>")
    assert "no such file" in refusal(ROUTES, routes="b.rou.xml")


def test_trips_with_many_ways_are_refused_before_they_take_minutes() -> None:
    trips = "".join(f'<trip id="t{n}" depart="0" from="before" via="{"beside " * n}" to="after"/>' for n in range(102))
    assert "different ways" in refusal(trips)


def test_trips_whose_ways_take_too_many_steps_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    trip = '<trip id="t" depart="0" from="before" to="after"/>'
    assert with_routes(file(trip)).scenario.traffic
    monkeypatch.setattr(routes, "MOST_STEPS", 3)
    assert "too long to be searched" in refusal(trip)


def test_ways_are_the_shortest_of_the_network() -> None:
    """Their lengths are those of SciPy, in networks of random lengths."""
    chance = random.Random(7)
    for _ in range(20):
        lengths = {f"e{number}": chance.randint(1, 9) + chance.random() for number in range(30)}
        names = list(lengths)
        followers = {edge: chance.sample(names, chance.randint(0, 4)) for edge in names}
        costs = np.array([[lengths[begin] if end in followers[begin] else np.inf for end in names] for begin in names])
        least = shortest_path(csgraph_from_dense(costs, null_value=np.inf))
        search = WaySearch(network_of(lengths, followers))
        for begin, end in (chance.sample(names, 2) for _ in range(20)):
            way, expected = search.over([begin, end]), least[names.index(begin), names.index(end)]
            if way is None:
                assert expected == np.inf
            else:
                assert (way[0], way[-1]) == (begin, end)
                assert all(after in followers[before] for before, after in pairwise(way))
                assert sum(lengths[edge] for edge in way[:-1]) == pytest.approx(expected)


def test_of_equally_long_ways_the_first_by_the_names_of_its_edges_is_taken() -> None:
    """Compared with a search among all ways, in grids whose lengths are equal."""
    chance = random.Random(3)
    for _ in range(30):
        cells = list(product(range(4), range(4)))
        names = dict(zip(cells, chance.sample([f"e{number}" for number in range(100)], 16), strict=True))
        followers = {
            names[x, y]: [names[cell] for cell in ((x + 1, y), (x, y + 1), (x + 1, y + 1)) if cell in names] for x, y in cells
        }
        begin, end = names[0, 0], names[3, 3]
        lengths = {name: float(chance.randint(1, 2)) for name in names.values()}
        ways = list(every_way(followers, begin, end))
        expected = min(ways, key=lambda way: (sum(lengths[edge] for edge in way[:-1]), way))
        assert WaySearch(network_of(lengths, followers)).over([begin, end]) == expected


def every_way(followers: dict[str, list[str]], begin: str, end: str) -> Iterator[list[str]]:
    """All ways without a circle."""
    if begin == end:
        yield [end]
    for following in followers[begin]:
        yield from ([begin, *rest] for rest in every_way(followers, following, end))


def network_of(lengths: dict[str, float], followers: dict[str, list[str]]) -> Any:
    """A network of these edges, as far as a search needs it."""
    edges = {name: SimpleNamespace(function="", lanes=[SimpleNamespace(length=length)]) for name, length in lengths.items()}
    links = {begin: [SimpleNamespace(end=end, for_cars=True) for end in ends] for begin, ends in followers.items()}
    return SimpleNamespace(edges=edges, connections=links)
