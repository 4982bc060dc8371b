"""Triggered actions against a recorded SUMO: when they begin, and what they give back."""

from types import SimpleNamespace
from typing import Any

import pytest

from drivecal.bundles.highway import TrafficEntry
from drivecal.domain.errors import NoResultError
from drivecal.highway.drive import actions
from drivecal.highway.drive.actions import Actions, Moving
from drivecal.highway.sumo import FREE, FREE_BUT_SAFE, MODEL

STEP = 0.5


def test_a_path_whose_last_point_stands_twice_goes_straight_on() -> None:
    given = {"s": 0, "speed": 5, "model": "constant"}
    paths = [[[0, 0], [0, 10]], [[0, 0], [0, 10], [0, 10]]]
    once, twice = (actions.PathVehicle(TrafficEntry.model_validate(given | {"path": path})) for path in paths)
    for vehicle in (once, twice):
        vehicle.advance(3.0)
    assert twice.front() == pytest.approx(once.front())


FAR_AWAY = Moving(0.0, 0.0, 0.0, 2.5)


@pytest.fixture
def sumo(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Stands in for SUMO: answers and records the actions' calls for one vehicle on an edge of two lanes."""
    recorded = SimpleNamespace(road="e0", speeds=[], modes=[], offsets=[], centres=[0.0, 3.5])
    recorded.edge = SimpleNamespace(getLaneNumber=lambda edge: 1 if edge.startswith(":") else 2)
    recorded.lane = SimpleNamespace(getWidth=lambda _: 3.5, getLength=lambda _: 100.0)
    recorded.vehicle = SimpleNamespace(
        getSpeed=lambda _: 30.0,
        getRoadID=lambda _: recorded.road,
        getLaneIndex=lambda _: 0,
        getLanePosition=lambda _: 0.0,
        getLateralLanePosition=lambda _: 0.0,
        setLateralLanePosition=lambda _, offset: recorded.offsets.append(offset),
        setSpeed=lambda _, speed: recorded.speeds.append(speed),
        setSpeedMode=lambda _, mode: recorded.modes.append(mode),
        moveTo=lambda *_: None,
    )
    recorded.simulation = SimpleNamespace(convert2D=lambda _, at, lane: (at, recorded.centres[lane]))
    monkeypatch.setattr(actions, "sumo", recorded)
    return recorded


def of(action: dict[str, Any], **vehicle: Any) -> Actions:
    return several(action, **{"model": "IDM"} | vehicle)


def act(these: Actions, step: int, ego: Moving = FAR_AWAY, stretch: float = 1.0) -> None:
    these.act(step * STEP, STEP, {"v": Moving(100.0, 0.0, 30.0, 2.5), "ego": ego}, stretch)


def steps(these: Actions, numbers: range) -> None:
    for number in numbers:
        act(these, number)


def several(*actions: dict[str, Any], **vehicle: Any) -> Actions:
    given = {"s": 100, "speed": 30, "length": 5.0, "model": "constant", "actions": list(actions)}
    return Actions({"v": TrafficEntry.model_validate(given | vehicle)}, lambda _, d, __: d, lambda *_: 1.0, {})


def test_an_action_ends_a_motion_to_the_side_where_it_is(sumo: SimpleNamespace) -> None:
    change = {"id": "in", "do": "cut_in", "time": 0, "lane": 1, "seconds": 4}
    brake = {"do": "brake", "time": 1, "speed": 0, "rate": 10, "ends": ["in"]}
    after = {"do": "drift", "offset": 0.5, "when": [{"done": "in"}], "seconds": 1}
    these = several(change, brake, after)
    steps(these, range(2))
    assert len(sumo.offsets) == 2
    act(these, 2)
    assert (len(sumo.offsets), sumo.speeds) == (2, [25])
    act(these, 3)  # the drift, which waits for the end of the change of lanes
    assert len(sumo.offsets) == 3


def test_a_motion_to_the_side_is_done_at_its_end_whatever_the_rounding(sumo: SimpleNamespace) -> None:
    drift = {"id": "in", "do": "drift", "time": 0.3, "offset": 0.5, "seconds": 0.3}
    these = several(drift, {"do": "brake", "speed": 0, "rate": 10, "when": [{"done": "in"}]})
    for number in range(7):
        these.act(number * 0.1, 0.1, {"v": Moving(100.0, 0.0, 30.0, 2.5), "ego": FAR_AWAY}, 1.0)
        assert len(sumo.speeds) == max(0, number - 5)


def test_an_action_ends_a_change_of_speed_at_the_speed_that_it_has(sumo: SimpleNamespace) -> None:
    brake = {"id": "slow", "do": "brake", "time": 0, "speed": 10, "rate": 10, "hold": 1}
    these = several(brake, {"do": "drift", "offset": 0.5, "time": 1, "seconds": 1, "ends": ["slow"]})
    steps(these, range(6))
    assert sumo.speeds == [25, 20, 20, 20, 20, 20]


def test_an_action_ends_one_that_waits_for_the_end_of_a_junction(sumo: SimpleNamespace) -> None:
    change = {"id": "in", "do": "cut_in", "time": 0, "lane": 1, "seconds": 4}
    brake = {"do": "brake", "time": 0.5, "speed": 0, "rate": 10, "ends": ["in"]}
    after = {"do": "drift", "offset": 0.5, "when": [{"done": "in"}], "seconds": 0.5}
    these = several(change, brake, after)
    sumo.road = ":j"
    steps(these, range(2))
    sumo.road = "e0"
    steps(these, range(2, 5))
    assert sumo.offsets == [0.5]


def test_what_is_done_at_once_is_not_ended_by_an_action_of_the_same_step(sumo: SimpleNamespace) -> None:
    slow = {"id": "slow", "do": "brake", "time": 0, "speed": 20, "seconds": 0}
    aside = {"id": "aside", "do": "drift", "time": 0, "offset": 0.5, "seconds": 0.1}
    for actions_in_order in ((slow, aside | {"ends": ["slow"]}), (aside, slow | {"ends": ["aside"]})):
        sumo.speeds, sumo.offsets = [], []
        act(several(*actions_in_order), 0)
        assert (sumo.speeds, sumo.offsets) == ([20], [0.5])


def test_an_action_that_has_not_begun_is_not_ended(sumo: SimpleNamespace) -> None:
    these = several(
        {"do": "drift", "offset": 0.5, "time": 0, "seconds": 0.5, "ends": ["slow"]},
        {"id": "slow", "do": "brake", "time": 1, "speed": 20, "rate": 10},
    )
    steps(these, range(4))
    assert sumo.speeds == [25, 20]


def test_a_constant_vehicle_comes_back_to_its_own_speed(sumo: SimpleNamespace) -> None:
    these = of({"do": "brake", "time": 0, "speed": 20, "rate": 10, "hold": 1}, model="constant")
    steps(these, range(8))
    assert sumo.speeds == [25, 20, 20, 20, 25, 30, 30, 30]
    assert sumo.modes == [FREE]


def test_a_model_gets_its_speed_back(sumo: SimpleNamespace) -> None:
    these = of({"do": "brake", "time": 0, "speed": 20, "rate": 10, "hold": 1})
    steps(these, range(6))
    assert sumo.speeds == [25, 20, 20, 20, -1]
    assert sumo.modes == [FREE_BUT_SAFE, MODEL]
    assert not these.pending


@pytest.mark.parametrize(("stretch", "begins"), [(1.0, False), (0.9, True)])
def test_a_gap_is_metres_of_the_way_and_not_of_the_line(sumo: SimpleNamespace, stretch: float, begins: bool) -> None:
    these = of({"do": "brake", "gap": 21})
    act(these, 0, Moving(72.0, 0.0, 0.0, 2.5), stretch)  # 28 m of the line between the centres; vehicles of 5 m
    assert (FREE_BUT_SAFE in sumo.modes) is begins


def test_a_cut_in_that_is_due_in_a_junction_waits_for_the_next_edge(sumo: SimpleNamespace) -> None:
    these = of({"do": "cut_in", "gap": 30, "lane": 1, "seconds": 1})
    sumo.road = ":n1_0"
    act(these, 0, Moving(90.0, 0.0, 0.0, 2.5))
    assert (sumo.offsets, these.pending) == ([], True)
    sumo.road = "e1"
    act(these, 1)  # the gap has grown meanwhile
    assert len(sumo.offsets) == 1


@pytest.mark.parametrize(
    ("change", "speeds"),
    [
        ({"speed": 20, "seconds": 1.0}, [25, 20, 20]),
        ({"speed": 40, "seconds": 0.0}, [40, 40, 40]),
        ({"speed": 20, "metres": 25.0}, [25, 20, 20]),
        ({"speed": 2, "like": "ego", "factor": 0.5, "seconds": 0.0}, [14, 14, 14]),
        ({"like": "ego", "continuous": True, "seconds": 0.0}, [24, 22, 20]),
    ],
)
def test_a_speed_is_reached_in_a_time_or_a_distance(sumo: SimpleNamespace, change: dict[str, Any], speeds: list[float]) -> None:
    these = of({"do": "brake", "time": 0} | change, model="constant")
    for step in range(3):
        act(these, step, Moving(0.0, 0.0, 24.0 - 2.0 * step, 2.5))
    assert sumo.speeds == pytest.approx(speeds)


def test_a_speed_that_is_already_another_s_is_kept_to_it(sumo: SimpleNamespace) -> None:
    these = of({"do": "brake", "time": 0, "like": "ego", "continuous": True, "seconds": 2.0}, model="constant")
    for step in range(3):
        act(these, step, Moving(0.0, 0.0, 30.0 - 2.0 * step, 2.5))
    assert sumo.speeds == pytest.approx([30, 28, 26])


@pytest.mark.parametrize(
    ("target", "d", "way"),
    [({"by": 1}, 0.0, 3.5), ({"by": 0, "beside": "ego"}, 3.4, 3.5), ({"by": -1, "beside": "ego"}, 3.4, 0.0)],
)
def test_a_vehicle_changes_to_the_lane_beside(sumo: SimpleNamespace, target: dict[str, Any], d: float, way: float) -> None:
    these = of({"do": "cut_in", "time": 0, "seconds": 1.0} | target, model="constant")
    act(these, 0, Moving(0.0, d, 30.0, 2.5))
    assert sumo.offsets == [pytest.approx(0.5 * way)]  # half of the way after half of the time


def test_a_lane_that_is_not_there_is_named(sumo: SimpleNamespace) -> None:
    assert sumo.road == "e0"
    with pytest.raises(NoResultError, match="lane 3"):
        act(of({"do": "cut_in", "time": 0, "by": 3}), 0)


def test_a_change_of_lanes_takes_as_long_as_its_distance_or_lateral_speed_says(sumo: SimpleNamespace) -> None:
    for given, seconds in (({"metres": 60.0}, 2.0), ({"lateral_speed": 1.875 * 3.5 / 2}, 2.0)):
        sumo.offsets.clear()
        these = of({"do": "cut_in", "time": 0, "by": 1} | given)
        steps(these, range(5))
        assert sumo.offsets[round(0.5 * seconds / STEP) - 1] == pytest.approx(1.75)


def test_a_lane_that_no_car_drives_on_may_lie_between_two_lanes(sumo: SimpleNamespace) -> None:
    sumo.centres = [0.0, 7.0]
    steps(of({"do": "cut_in", "time": 0, "by": 1, "seconds": 2.0}), range(5))
    assert sumo.offsets == pytest.approx([0.724609375, -3.5, -0.724609375, 0.0])


def test_a_lane_is_entered_where_it_is_there_and_reached_in_its_middle(sumo: SimpleNamespace) -> None:
    these = of({"do": "cut_in", "time": 0, "by": 1, "seconds": 2.0})
    steps(these, range(1))
    sumo.centres = [0.0, 4.5]
    steps(these, range(1, 5))
    assert sumo.offsets == pytest.approx([0.3623046875, 1.75, 3.1376953125 - 4.5, 0.0])


def test_an_action_waits_until_another_is_done(sumo: SimpleNamespace) -> None:
    first = {"id": "first", "do": "brake", "time": 0, "speed": 20, "rate": 10}
    second = {"do": "brake", "when": [{"done": "first", "delay": 1.0}], "speed": 30, "rate": 20}
    these = several(first, second)
    steps(these, range(6))
    assert sumo.speeds == [25, 20, 20, 20, 30, 30]


def test_what_waits_for_an_action_that_does_nothing_waits_for_it_once(sumo: SimpleNamespace) -> None:
    near = Moving(80.0, 0.0, 0.0, 2.5)
    wait = {"id": "near", "do": "wait", "gap": 20}
    two = several(wait, {"do": "brake", "speed": 0, "rate": 10, "when": [{"done": "near"}, {"quantity": "time", "above": 1.5}]})
    for step, ego in enumerate((FAR_AWAY, near, FAR_AWAY, FAR_AWAY, FAR_AWAY)):
        act(two, step, ego)
    assert sumo.speeds == [25, 20]
    assert not sumo.offsets
