"""The ego vehicle in SUMO: where it is placed, and the lane and the speed that the others see."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.support.motorways import NETWORK, ROUTE
from tests.support.networks import built, edge, entrance, link, node
from tests.support.opendrive_files import edited
from tests.support.values import faulty_fields

from drivecal.bundles.highway import HighwayScenario
from drivecal.highway import sumo
from drivecal.highway.drive import geometry
from drivecal.highway.drive.road import HighwayRoad, LanePlace, SumoLanes
from drivecal.highway.drive.traffic import CHECKED_STEPS, Traffic
from drivecal.highway.sumo import EGO, GET_POSITION, GET_SPEED, lane
from drivecal.roads.conversion import converted
from drivecal.roads.corridor import corridor
from drivecal.roads.network import read_network, unlimited

STEP, SPEED, SIZE = 0.1, 30.0, np.array([2.35, 0.95])


class Drive:
    """A drive at constant speed along the track of a lane, by edge and index, with an ego vehicle alone in SUMO."""

    def __init__(self, network: Path, route: Sequence[str], folder: Path, lane: tuple[str, int]) -> None:
        self.road, self._traffic = traffic(network, route, folder)
        self._traffic.reset()
        self._traffic.motion[geometry.SIZE : geometry.SIZE + 2] = SIZE
        self.front = self._traffic.motion[geometry.FRONT : geometry.FRONT + 3]
        self.lanes = [[(piece.edge, piece.index) for piece in track.lanes] for track in self.road.corridor.tracks]
        self._track = next(number for number, lanes in enumerate(self.lanes) if lane in lanes)

    def steps(self, first: int, count: int, begin: float) -> Iterator[float]:
        """Yields s of the front after each step, from `begin` on."""
        line, lanes, motion = self.road.line, self.road.lanes, self._traffic.motion
        for index in range(first, first + count):
            s = begin + (index - first) * SPEED * STEP - SIZE[0]
            pose = np.array([*self.road.start(s, float(lanes[int(s / line[1, 0]), self._track, 0])), SPEED, 0, 0, 0, 0])
            assert geometry.place(line, lanes, pose, s, motion)
            assert self._traffic.advance(index)
            yield s + SIZE[0]


def traffic(network: Path, route: Sequence[str], folder: Path, *vehicles: dict[str, Any]) -> tuple[HighwayRoad, Traffic]:
    """The road of a route, and an ego vehicle at s = 100 among other vehicles."""
    road = HighwayRoad(corridor(read_network(network.read_bytes(), "road.net.xml"), route, "road.net.xml"), {})
    ego = {"s": 100, "speed": SPEED}
    data = {"network": "road.net.xml", "route": route, "duration": 20, "ego": ego, "traffic": list(vehicles)}
    return road, Traffic("s", HighwayScenario.model_validate(data), network, road, STEP, folder)


def written(content: bytes, folder: Path) -> Path:
    path = folder / "road.net.xml"
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("metres", [0.2, 1.0, 2.0, 3.1])
def test_others_see_the_ego_vehicles_speed_when_it_is_placed_anew(metres: float, tmp_path: Path) -> None:
    """SUMO places the ego vehicle anew every `CHECKED_STEPS` steps, here with its front `metres` behind the edge's begin."""
    drive = Drive(NETWORK, ROUTE, tmp_path, ("e0", 0))
    begin = drive.road.corridor.places["e1", 0][0, 1]
    for _ in drive.steps(CHECKED_STEPS - 8, 12, begin + metres - 8 * SPEED * STEP):
        assert GET_SPEED(EGO) == pytest.approx(SPEED, abs=0.5)
        assert np.hypot(*(np.array(GET_POSITION(EGO)) - drive.front[:2])) < 0.05


def test_the_ego_vehicle_keeps_its_speed_over_junctions_without_lanes_inside(tmp_path: Path) -> None:
    """SUMO's vehicles skip the gaps of 8 m."""
    drive = Drive(written(entrance("--no-internal-links"), tmp_path), ["before", "beside", "after"], tmp_path, ("before", 0))
    speeds = [GET_SPEED(EGO) for _ in drive.steps(1, 40, 350.0)]
    assert speeds == pytest.approx([SPEED] * 40, rel=0.1)


def test_sumo_has_the_ego_vehicle_in_its_lane_behind_a_split(tmp_path: Path) -> None:
    """A lane leads to two lanes: the corridor takes one, and SUMO may take the other."""
    nodes = [node("a", 0, 0), node("b", 400, 0), node("c", 1200, 0)]
    links = [link("A", "B", 0, 0), link("A", "B", 0, 1), link("A", "B", 1, 2)]
    network = written(built(nodes, [edge("A", "a", "b", 2), edge("B", "b", "c", 3)], links), tmp_path)
    drive = Drive(network, ["A", "B"], tmp_path, ("A", 0))
    assert any({("A", 0), ("B", 1)} <= set(lanes) for lanes in drive.lanes)
    begin = drive.road.corridor.places["B", 1][0, 1]
    lanes = [(s - begin, sumo.vehicle.getLaneID(EGO)) for s in drive.steps(1, 40, begin - 40.0)]
    assert {lane for ahead, lane in lanes if ahead > 2 * SPEED * STEP} == {"B_1"}


@pytest.mark.parametrize("place", [{"edge": "before"}, {}])
def test_a_vehicle_whose_front_is_inside_a_junction_is_refused(place: dict[str, Any], tmp_path: Path) -> None:
    network, route = written(entrance(), tmp_path), ["before", "beside", "after"]
    end = corridor(read_network(network.read_bytes(), "n"), route, "n").places["before", 0].item(-1, 0)
    vehicle = {"speed": 20.0, "length": 4.0} | place
    assert faulty_fields(traffic, network, route, tmp_path, vehicle | {"s": end - 1.5}) == ["scenarios.s.traffic[0].s"]
    _, allowed = traffic(network, route, tmp_path, vehicle | {"s": end - 2.0})
    allowed.reset()
    assert sumo.vehicle.getLanePosition("vehicle0") == pytest.approx(end, abs=0.1)


def test_sumo_s_cars_have_the_scenario_s_limit_where_the_file_has_none(tmp_path: Path) -> None:
    content = converted(edited("two_way", "<type.*?</type>", ""), "road.xodr").network
    network, route = written(content, tmp_path), ["-5#0", "-5#1", "-5#2"]
    roads = read_network(content, "road.net.xml")
    road = HighwayRoad(corridor(roads, route, "road.net.xml", 36.0), {}, unlimited(roads))
    data = {"network": "r.net.xml", "route": route, "duration": 20, "ego": {"s": 100, "speed": SPEED}, "default_limit": 36.0}
    drive = Traffic("s", HighwayScenario.model_validate(data), network, road, STEP, tmp_path)
    for _ in range(2):
        drive.reset()
        assert {lane.getMaxSpeed(name) for name in lane.getIDList()} == {36.0}


def test_a_front_beyond_the_end_of_its_edge_stays_on_the_track() -> None:
    road = corridor(read_network(entrance(), "road.net.xml"), ["before", "beside", "after"], "road.net.xml")
    lanes = SumoLanes(road, road.line[:, 0])
    end = float(road.places["before", 0][-1, 0])
    edge, lane, position = lanes.ahead("before", 0, end + 30.0)
    assert (edge, lane) == ("beside", 1)  # lane 0 of this edge is that of the ramp
    assert 0.0 < position < 30.0
    assert lanes.ahead("before", 1, end - 4.0)[:2] == ("before", 1)
    assert lanes.ahead("before", 1, end - 4.0).position == pytest.approx(end - 4.0)
    assert lanes.ahead("ramp", 0, 1000.0) == LanePlace("ramp", 0, 1000.0)


@pytest.mark.parametrize("internal", [True, False])
def test_vehicles_that_keep_their_lanes_are_where_sumo_has_them_until_they_arrive(internal: bool, tmp_path: Path) -> None:
    """Also over junctions; without lanes inside, SUMO's vehicles skip their gaps."""
    nodes = [node("a", 0, 0), node("b", 400, 0), node("c", 700, 60), node("d", 1000, 200)]
    edges = [edge("A", "a", "b", 2), edge("B", "b", "c", 2), edge("C", "c", "d", 2)]
    content = built(nodes, edges, [], *([] if internal else ["--no-internal-links"]))
    vehicles = [{"s": 300, "speed": 30, "lane": 1}, {"s": 500, "speed": 20, "lane": 0}, {"s": 900, "speed": 30, "lane": 1}]
    road, subject = traffic(written(content, tmp_path), ["A", "B", "C"], tmp_path, *vehicles)
    assert subject.keeps_lanes
    subject.motion[geometry.SIZE : geometry.SIZE + 2] = SIZE
    for _ in range(2):
        subject.reset()
        for index in range(200):
            s = 100.0 + index * STEP * 2.0
            pose = np.array([*road.start(s, float(road.lanes[int(s / road.line[1, 0]), 0, 0])), 2.0, 0, 0, 0, 0])
            geometry.place(road.line, road.lanes, pose, s, subject.motion)
            assert subject.advance(index)
            geometry.locate(road.line, road.lanes, subject.neighbours, subject.outlines, STEP, True)
            for name, outline in zip(subject.names, subject.outlines.tolist(), strict=True):
                x, y, heading, half = outline[:4]
                front = x + half * np.cos(heading), y + half * np.sin(heading)
                assert np.hypot(*np.subtract(GET_POSITION(name), front)) < (0.5 if internal else 1.0), (name, index)
        assert subject.names == ["vehicle0"]


def crossing(road: HighwayRoad, s: float, d: float, reach: float) -> list[list[float]]:
    """A path across the road, from `reach` metres to the right of a place to as far to its left."""
    points = []
    for side in (-reach, reach):
        x, y, _ = road.start(s, d + side)
        points.append([x, y])
    return points


@pytest.mark.parametrize(
    ("reach", "final", "steady"), [(6.0, 1.39, 5.0), (6.0, 1.39, 0.0), (30.0, 4.17, 10.0), (20.0, None, 0.0)]
)
def test_a_vehicle_on_a_path_meets_the_ego_vehicle(reach: float, final: float | None, steady: float, tmp_path: Path) -> None:
    """A pedestrian, who waits and starts in time, and a rider, on no lane and of their true size."""
    road, _ = traffic(NETWORK, ROUTE, tmp_path)
    place, steps = 100.0 + SPEED * 6.0, 60
    walker = {
        "id": "walker", "model": "constant", "path": crossing(road, place, 0.0, reach), "s": 0.0, "speed": 0.0, "length": 0.6, "width": 0.5,
        "actions": [{"id": "a", "do": "meet", "time": 0.0, "other_s": place, "at": reach, "speed": final, "steady": steady}],
    }  # fmt: skip
    road, drive = traffic(NETWORK, ROUTE, tmp_path, walker, {"id": "car", "lane": 1, "s": 400.0, "speed": 20.0})
    runs = []
    for _ in range(2):
        drive.reset()
        drive.motion[geometry.SIZE : geometry.SIZE + 2] = SIZE
        rows = []
        for index in range(steps):
            rows.append(drive.outlines[drive.names.index("walker")].copy())
            pose = np.array([*road.start(100.0 + SPEED * STEP * (index + 1), 0.0), SPEED, 0, 0, 0, 0])
            assert geometry.place(road.line, road.lanes, pose, 100.0 + SPEED * STEP * index, drive.motion)
            assert drive.advance(index)
            geometry.locate(road.line, road.lanes, drive.neighbours, drive.outlines, STEP, drive.keeps_lanes)
        rows.append(drive.outlines[drive.names.index("walker")].copy())
        runs.append(np.array(rows))
    assert np.array_equal(runs[0], runs[1])
    x, y, _ = road.start(place, 0.0)
    there = runs[0][-1]
    assert np.hypot(there[0] - x, there[1] - y) < 0.5 * abs(there[5]) * STEP + 0.1
    assert (there[3], there[4]) == (0.3, 0.25)
    if final is not None:
        assert abs(there[5]) == pytest.approx(final, abs=0.05)
        assert runs[0][0, 5] == 0.0
    assert set(drive.names) == {"walker", "car"}
    crossing_speed = drive.neighbours[drive.names.index("walker"), 2]
    assert abs(crossing_speed) < 0.1 * abs(there[5])  # across the road, not along it
