"""SUMO route files as traffic: vehicles, trips and flows with SUMO's defaults; what is not supported is refused by line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import libsumo
import pytest
from tests.support.networks import entrance
from tests.support.scenario_files import ROUTES, with_routes

from drivecal.bundles.archives import BundleFile
from drivecal.bundles.checks import checked
from drivecal.bundles.highway import CLASSES
from drivecal.bundles.highway_checks import scenario_problems
from drivecal.bundles.highway_roads import check_roads
from drivecal.bundles.traffic.route_files import MIN_GAP, SIGMA
from drivecal.domain.errors import InvalidInputError

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
        ('<vTypeDistribution id="d"><vType id="t"/></vTypeDistribution>', "vTypeDistribution"),
        ('<include href="/etc/passwd"/>', "include"),
        ("".join(f'<vehicle id="v{index}" route="r" depart="{index / 100}"/>' for index in range(501)), "more than 500"),
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


def test_a_file_that_is_missing_or_no_route_file_is_refused() -> None:
    assert "<routes>" in refusal(b"<net/>")
    assert "no such file" in refusal(ROUTES, routes="b.rou.xml")


def test_trips_with_many_ways_are_refused_before_they_take_minutes() -> None:
    trips = "".join(f'<trip id="t{n}" depart="0" from="before" via="{"beside " * n}" to="after"/>' for n in range(102))
    assert "different ways" in refusal(trips)
