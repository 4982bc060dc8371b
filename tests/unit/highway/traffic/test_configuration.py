"""SUMO's options and route file."""

from dataclasses import replace
from xml.etree import ElementTree as ET

import pytest

from drivecal.highway.scenarios.highway import HIGHWAY
from drivecal.highway.traffic.simulation import drift_offsets, routes

S3 = HIGHWAY.scenarios["S3"]


def test_every_vehicle_has_a_type_without_randomness() -> None:
    root = ET.fromstring(routes(S3))
    types = {element.attrib["id"]: element.attrib for element in root.iter("vType")}
    assert set(types) == {vehicle.id for vehicle in S3.traffic} | {"ego"}
    assert {attributes["speedDev"] for attributes in types.values()} == {"0"}
    vehicle = S3.traffic[0]
    assert float(types[vehicle.id]["length"]) == vehicle.length
    assert float(types[vehicle.id]["maxSpeed"]) == vehicle.desired_speed


@pytest.mark.parametrize("name", ["S4", "S5", "S6"])
def test_the_route_covers_every_edge_in_the_direction_of_travel(name: str) -> None:
    scenario = HIGHWAY.scenarios[name]
    route = ET.fromstring(routes(scenario)).find("route")
    assert route is not None
    named = route.attrib["edges"].split()
    assert len(named) > 1
    assert named == [f"e{index}" for index in range(len(named))]
    assert sorted(named) == sorted(edge.attrib["id"] for edge in ET.fromstring(scenario.network).iter("edge"))


def test_hostile_names_are_escaped() -> None:
    vehicle = replace(S3.traffic[0], id='"/><input href="x')
    root = ET.fromstring(routes(replace(S3, traffic=(vehicle,))))
    assert [element.tag for element in root] == ["route", "vType", "vType"]


def test_a_vehicle_drifts_along_its_knots() -> None:
    vehicle = replace(S3.traffic[0], drift=((1.0, 0.0), (2.0, 0.5), (3.0, 0.5), (4.0, -0.5)))
    offsets = drift_offsets(vehicle, S3)
    assert len(offsets) == round(S3.duration / S3.step)
    after = {time: offsets[round(time / S3.step) - 1] for time in (0.5, 1.5, 2.5, 3.5, 10.0)}
    assert after == pytest.approx({0.5: 0.0, 1.5: 0.25, 2.5: 0.5, 3.5: 0.0, 10.0: -0.5})
