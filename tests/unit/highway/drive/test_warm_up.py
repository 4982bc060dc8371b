"""Traffic before a run: who is there at time 0, what room the ego vehicle has, and that each run begins with the same bits."""

from pathlib import Path
from typing import Any
from unittest import mock
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from tests.support.motorways import NETWORK, ROUTE

from drivecal.bundles.highway import HighwayScenario
from drivecal.bundles.traffic.route_files import RouteTraffic
from drivecal.domain.roads import Floats
from drivecal.highway import sumo
from drivecal.highway.drive import geometry
from drivecal.highway.drive.road import HighwayRoad
from drivecal.highway.drive.routes import BRAKING, HEADWAY, STANDING_GAP, too_close
from drivecal.highway.drive.traffic import Traffic, TrafficError
from drivecal.highway.geometry import hit
from drivecal.roads.corridor import corridor
from drivecal.roads.network import read_network

STEP, START, SPEED = 0.1, 2000.0, 25.0
BEGIN = 1000.0
KIND = {"carFollowModel": "Krauss", "sigma": "0.5", "speedDev": "0.1"}
FLOW = {"period": "2", "departLane": "0", "departSpeed": "25"}
"""Vehicles enter 2 km behind the ego vehicle, throughout the warm-up and after it."""


@pytest.fixture(scope="module")
def road() -> HighwayRoad:
    return HighwayRoad(corridor(read_network(NETWORK.read_bytes(), "road.net.xml"), ROUTE, "road.net.xml"), {})


def traffic(
    road: HighwayRoad,
    folder: Path,
    kind: dict[str, str] = KIND,
    flow: dict[str, str] = FLOW,
    warm_up: float = 120.0,
    **data: Any,
) -> Traffic:
    begin = BEGIN - warm_up
    given = {"network": "road.net.xml", "route": ROUTE, "duration": 20, "ego": {"s": START, "speed": SPEED}, "seed": 3}
    given |= {"routes": "day.rou.xml", "begin": BEGIN, "warm_up": warm_up} | data
    root = ET.Element("routes")
    ET.SubElement(root, "vType", kind | {"id": "t"})
    ET.SubElement(root, "route", id="r", edges=" ".join(ROUTE))
    ET.SubElement(root, "flow", flow | {"id": "f", "type": "t", "route": "r", "begin": repr(begin), "end": "9999"})
    changes = frozenset([kind.get("laneChangeModel", "LC2013")])
    routes = RouteTraffic(ET.tostring(root), (), frozenset(), changes, ())
    return Traffic("s", HighwayScenario.model_validate(given), NETWORK, road, STEP, folder, routes)


def said(subject: Traffic) -> Floats:
    """Returns SUMO's values of the other vehicles."""
    return subject.outlines[:, geometry.SAID :].copy()


def driven(subject: Traffic, road: HighwayRoad, steps: int = 15) -> list[tuple[list[str], Floats]]:
    """Names and places of the others at time 0 and after each step of a drive along the right lane."""
    subject.reset()
    rows = [(subject.names, said(subject))]
    subject.motion[geometry.SIZE : geometry.SIZE + 2] = 2.35, 0.95
    for index in range(1, steps + 1):
        s = START + index * SPEED * STEP
        pose = np.array([*road.start(s, subject.start_d), SPEED, 0, 0, 0, 0])
        geometry.place(road.line, road.lanes, pose, s, subject.motion)
        assert subject.advance(index)
        rows.append((subject.names, said(subject)))
    return rows


def same(first: list[tuple[list[str], Floats]], second: list[tuple[list[str], Floats]]) -> bool:
    return all(
        names == others and np.array_equal(places, there, equal_nan=True)
        for (names, places), (others, there) in zip(first, second, strict=True)
    )


def test_a_flow_far_behind_has_reached_the_ego_vehicle_at_time_0(road: HighwayRoad, tmp_path: Path) -> None:
    subject = traffic(road, tmp_path)
    subject.reset()
    assert len(subject.names) > 30
    assert {*subject.names, "ego"} == set(sumo.vehicle.getIDList())
    assert subject.neighbours[:, 0].min() < 100.0 < START + 100.0 < subject.neighbours[:, 0].max()
    assert sumo.vehicle.getLanePosition("ego") > 0.0


def test_a_start_may_leave_the_warm_up_out(road: HighwayRoad, tmp_path: Path) -> None:
    subject = traffic(road, tmp_path)
    subject.reset(is_warm=False)
    assert {*subject.names, "ego"} == set(sumo.vehicle.getIDList())
    assert len(subject.names) <= 1
    subject.reset()
    assert sumo.simulation.getTime() == pytest.approx(BEGIN + STEP)
    assert len(subject.names) > 30


@pytest.mark.parametrize(
    "kind",
    [
        KIND,
        pytest.param(KIND | {"laneChangeModel": "SL2015"}, marks=pytest.mark.slow),
        pytest.param(KIND | {"carFollowModel": "EIDM"}, marks=pytest.mark.slow),
        pytest.param(KIND | {"carFollowModel": "ACC"}, marks=pytest.mark.slow),
        pytest.param(KIND | {"carFollowModel": "CACC"}, marks=pytest.mark.slow),
        pytest.param(KIND | {"carFollowModel": "W99"}, marks=pytest.mark.slow),
    ],
    ids=lambda kind: f"{kind['carFollowModel']}-{kind.get('laneChangeModel')}",
)
def test_each_run_begins_and_goes_on_with_the_same_bits(kind: dict[str, str], road: HighwayRoad, tmp_path: Path) -> None:
    flow = FLOW | {"period": "exp(0.5)", "departLane": "free"}
    subject = traffic(road, tmp_path, kind, flow)
    first = driven(subject, road)
    assert len(first[0][0]) > 20
    assert same(first, driven(subject, road))
    (tmp_path / "other").mkdir()
    assert same(first, driven(traffic(road, tmp_path / "other", kind, flow), road))


def test_sumo_is_loaded_once_for_each_run(road: HighwayRoad, tmp_path: Path) -> None:
    with mock.patch.object(sumo, "load", wraps=sumo.load) as load:
        subject, other = traffic(road, tmp_path), traffic(road, tmp_path)
        other.reset()
        assert load.call_count == 2
        subject.reset()
        assert load.call_count == 3, "another one was loaded"
        subject.seed(4)
        subject.reset()
        assert load.call_count == 4


def test_times_of_actions_count_from_time_0(road: HighwayRoad, tmp_path: Path) -> None:
    brake = {"do": "brake", "time": 1, "speed": 10, "rate": 5}
    lead = {"id": "lead", "s": START + 100, "speed": 25, "model": "constant", "actions": [brake]}
    speeds = [places[0, 2] for _, places in driven(traffic(road, tmp_path, warm_up=20, traffic=[lead]), road)]
    assert speeds[:10] == pytest.approx([25.0] * 10)
    assert speeds[15] == pytest.approx(22.5, abs=0.6)


def test_the_ego_vehicle_and_placed_ones_have_room_at_time_0(road: HighwayRoad, tmp_path: Path) -> None:
    kind = {"carFollowModel": "IDM", "maxSpeed": "20", "speedFactor": "10", "speedDev": "0", "tau": "0.8"}
    dense = {"period": "1", "departLane": "0", "departSpeed": "20"}
    at = {"speed": SPEED, "lane": 0}
    subject = traffic(road, tmp_path, kind, dense, warm_up=150, traffic=[at | {"id": "lead", "s": START + 60}])
    subject.reset()
    assert subject.names[0] == "lead"
    assert subject.starting == 1
    assert len(subject.names) > 30
    pose, size = np.array([*road.start(START, subject.start_d)]), np.array([2.35, 0.95])
    assert hit(subject.outlines, pose, size) < 0
    others = subject.neighbours[1:]
    s = others[np.abs(others[:, 1] - subject.start_d) < 1.0, 0]  # in the same lane
    behind, ahead = START - s[s < START], s[s > START + 60] - START - 60
    assert behind.min() > STANDING_GAP + HEADWAY * subject.neighbours[1:, 2].min() + 4.7
    assert ahead.min() > STANDING_GAP + HEADWAY * SPEED + 5**2 / (2 * BRAKING) + 4.7
    assert not len(s[(s > START) & (s < START + 60)])


def test_a_vehicle_that_changes_into_the_lane_of_the_ego_vehicle_leaves_it_room(road: HighwayRoad, tmp_path: Path) -> None:
    subject = traffic(road, tmp_path, warm_up=60)
    subject.reset(is_warm=False)
    begin = sumo.simulation.getTime()
    changing: list[str] = []
    while not changing:
        sumo.STEP()
        others = [name for name in sumo.vehicle.getIDList() if name != "ego"]
        changing = [name for name in others if sumo.vehicle.getLateralSpeed(name) > 1.0]
    name, time, s = changing[0], sumo.simulation.getTime(), sumo.vehicle.getLanePosition(changing[0])
    assert sumo.vehicle.getLaneID(name) == "e0_0"
    assert sumo.vehicle.getLateralLanePosition(name) < 0.5
    for lane, ahead, is_there in ((0, 10.0, False), (1, 10.0, False), (1, 500.0, True)):
        ego = {"s": s + ahead, "lane": lane, "speed": SPEED}
        subject = traffic(road, tmp_path, warm_up=round(time - begin, 6), ego=ego)
        subject.reset()
        assert (name in subject.names) is is_there


@pytest.mark.parametrize(
    ("s", "d", "speed", "sideways", "is_removed"),
    [
        (110.0, 0.0, 30.0, 0.0, True),
        (141.0, 0.0, 30.0, 0.0, False),  # 2 m and 30 m behind the front
        (141.0, 0.0, 10.0, 0.0, True),  # 66.7 m more, to brake to its speed
        (204.0, 0.0, 10.0, 0.0, False),
        (90.0, 0.0, 10.0, 0.0, True),
        (80.0, 0.0, 10.0, 0.0, False),
        (60.0, 0.0, 35.0, 0.0, True),
        (100.0, 3.5, 30.0, 0.0, False),
        (100.0, 2.2, 30.0, 0.0, True),  # partly in its lane
        (100.0, float("nan"), 30.0, 0.0, False),
        (150.0, 0.0, -30.0, 0.0, True),  # against it
        (110.0, 3.4, 30.0, -1.2, True),  # about to be in its lane
        (110.0, -3.4, 30.0, 1.2, True),
        (110.0, 3.4, 30.0, 1.2, False),  # about to leave the adjacent lane
        (110.0, 1.5, 30.0, 1.2, True),  # still in its lane
        (110.0, 7.0, 30.0, -1.2, False),
        (110.0, 3.4, -30.0, 1.2, True),  # its left is the route's right
        (110.0, float("nan"), 30.0, -1.2, False),
    ],
)
def test_vehicles_that_block_a_start_are_removed(s: float, d: float, speed: float, sideways: float, is_removed: bool) -> None:
    ego = np.array([100.0, 0.0, 30.0, 0.0, 5.0, 2.0])
    neighbours = np.array([[1000.0, 0.0, 30.0, 0.0, 5.0, 2.0], [s, d, speed, 0.0, 5.0, 2.0]])
    outlines = np.array([[x, y, 0.0, 2.5, 1.0, speed] for x, y in neighbours[:, :2]])
    outline = np.array([100.0, 0.0, 0.0, 2.5, 1.0, 30.0])
    assert too_close(neighbours, outlines, 1, ego, outline, [0.0, sideways]) == ([1] if is_removed else [])


def test_a_vehicle_that_crosses_the_place_of_one_that_starts_is_removed() -> None:
    ego, outline = np.array([100.0, 0.0, 0.0, 0.0, 5.0, 2.0]), np.array([100.0, 0.0, 0.0, 2.5, 1.0, 0.0])
    neighbours = np.array([[101.0, 4.0, 0.0, 0.0, 12.0, 2.0]])
    outlines = np.array([[101.0, 4.0, np.pi / 2, 6.0, 1.0, 8.0]])
    assert too_close(neighbours, outlines, 0, ego, outline, [0.0]) == [0]


def test_a_route_file_that_sumo_refuses_is_named_with_the_words_of_sumo(road: HighwayRoad, tmp_path: Path) -> None:
    for kind, flow, word in ((KIND | {"carFollowModel": "Foo"}, FLOW, "'t'"), (KIND, FLOW | {"departLane": "9"}, "'f.0'")):
        with pytest.raises(TrafficError, match=word):
            traffic(road, tmp_path, kind, flow, warm_up=5.0).reset()
