"""OpenSCENARIO files as traffic: places, speeds, actions, conditions and their references; what is ignored is noted."""

from typing import Any

import numpy as np
import pytest
from tests.support.opendrive_files import PAVED, Road, document, line
from tests.support.scenario_files import (
    BESIDE,
    BRAKE,
    CARS,
    EGO,
    HEADWAY,
    IN,
    NEAR,
    OTHER,
    STEP,
    WORLD,
    absolute,
    act,
    change_of_lane,
    change_of_speed,
    cut_in,
    cut_out,
    event,
    lane,
    maps,
    motorway,
    of_file,
    refused,
    scenario,
    slower_cut_in,
    start,
    trigger,
    vehicle,
    when,
    when_all,
    when_time,
    with_events,
)
from tests.support.values import faults_of, present

from drivecal.bundles.archives import BundleFile
from drivecal.bundles.highway_actions import Action, Brake, CutIn, Drift
from drivecal.bundles.highway_checks import declared_scenario
from drivecal.bundles.highway_roads import files_read
from drivecal.bundles.traffic.description import Description, described
from drivecal.bundles.traffic.elements import read_tree
from drivecal.bundles.traffic.places import Map
from drivecal.domain.errors import InvalidInputError
from drivecal.roads.conversion import converted
from drivecal.roads.network import read_network
from drivecal.roads.opendrive import read_opendrive

ROAD = "maps/motorway.xodr"

ACTION = f'<Action name="also"><PrivateAction>{IN}</PrivateAction></Action>'


def actions(content: bytes) -> list[Action]:
    """The actions of the other car."""
    return list(of_file(content).scenario.traffic[0].actions)


@pytest.mark.parametrize(("index", "s", "offset"), [(-3, 150.0, 0.0), (-1, 800.0, 0.7), (2, 1200.0, -0.5), (-2, 1990.0, 0.0)])
def test_a_place_on_a_lane_is_that_of_the_file(index: int, s: float, offset: float) -> None:
    other = start("Other", lane(index, s, offset), absolute(20))
    placed = of_file(scenario(CARS | {"Other": vehicle(centre=0.0)}, EGO + other)).scenario.traffic[0]
    assert placed.edge is not None
    result = maps()["maps/motorway.xodr"].network.edges[placed.edge].lanes[placed.lane]
    share = placed.s / result.length * np.sum(np.hypot(*np.diff(result.shape, axis=0).T))
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(result.shape, axis=0).T))])
    here = np.array([np.interp(share, along, column) for column in result.shape.T])
    points, _ = read_opendrive(motorway(), "x").roads["7"].centre(0, index, np.array([s]))
    assert np.hypot(*(here - points[0])) < 0.05
    assert placed.offset == pytest.approx(offset if index < 0 else -offset, abs=0.05)
    assert placed.edge == ("-7" if index < 0 else "7")


def test_positions_mean_a_point_behind_the_centre() -> None:
    ahead, centred = (
        of_file(scenario(CARS | {"Other": vehicle(centre=centre)}, EGO + OTHER)).scenario.traffic[0].s for centre in (1.4, 0.0)
    )
    assert ahead - centred == pytest.approx(1.4, abs=1e-6)


@pytest.mark.parametrize(
    ("position", "same"),
    [
        ('<Position><RelativeLanePosition entityRef="Ego" dLane="1" ds="50" offset="0.3"/></Position>', lane(-2, 200, 0.3)),
        ('<Position><RelativeLanePosition entityRef="Ego" dLane="0" ds="-40"/></Position>', lane(-3, 110)),
        (
            '<Position><RelativeLanePosition entityRef="Ego" dLane="0" dsLane="1250"/></Position>',
            lane(-3, 600 + 800 / 1.004375),
        ),
        ('<Position><RelativeRoadPosition entityRef="Ego" ds="50" dt="3.5"/></Position>', lane(-2, 200)),
        ('<Position><RoadPosition roadId="7" s="200" t="-5.25"/></Position>', lane(-2, 200)),
        (
            WORLD.format(100 + 200 * np.cos(0.2) + 5.25 * np.sin(0.2), 50 + 200 * np.sin(0.2) - 5.25 * np.cos(0.2)),
            lane(-2, 200),
        ),
    ],
)
def test_places_by_other_means_are_the_same(position: str, same: str) -> None:
    one, other = (
        of_file(scenario(CARS, EGO + start("Other", place, absolute(25)))).scenario.traffic[0] for place in (position, same)
    )
    assert (one.edge, one.lane) == (other.edge, other.lane)
    assert (one.s, one.offset) == pytest.approx((other.s, other.offset), abs=2e-3)


def test_lanes_beside_a_vehicle_of_the_other_direction_are_counted_as_in_the_file() -> None:
    """Also if it is placed by coordinates: lane 3 lies outside of lane 2."""
    road = present(maps()["maps/motorway.xodr"].file)
    (point,) = road.roads["7"].centre(0, 2, np.array([500.0]))[0]
    world = f'<Position><WorldPosition x="{point[0]}" y="{point[1]}"/></Position>'
    beside = '<Position><RelativeLanePosition entityRef="Other" dLane="1" ds="30" offset="0.5"/></Position>'
    cars = CARS | {"Third": vehicle()}
    result = []
    for position in (world, lane(2, 500)):
        content = scenario(cars, EGO + start("Other", position, absolute(20)) + start("Third", beside, absolute(20)))
        result.append([(entry.lane, entry.s, entry.offset) for entry in of_file(content).scenario.traffic])
    assert [[index for index, *_ in places] for places in result] == [[1, 0], [1, 0]]
    assert [s for _, s, _ in result[0]] == pytest.approx([s for _, s, _ in result[1]], abs=1.0)
    assert [places[1][2] for places in result] == pytest.approx([-0.5, -0.5], abs=0.05)


def test_a_cut_in_has_the_file_s_speeds_lanes_and_conditions() -> None:
    result = of_file(cut_in()).scenario
    assert (result.network, result.route, result.duration) == ("maps/motorway.xodr", ["-7"], 15.0)
    assert (result.ego.speed, result.ego.lane, result.ego.length) == (30.0, 0, 4.6)
    (other,) = result.traffic
    assert (other.id, other.model, other.speed, other.lane, other.length) == ("Other", "constant", 36.0, 1, 4.2)
    change, brake = other.actions
    assert isinstance(change, CutIn)
    assert isinstance(brake, Brake)
    assert (change.by, change.beside, change.seconds) == (0, "ego", 3.0)
    (condition,) = present(change.when)
    assert (condition.quantity, condition.vehicle, condition.to) == ("headway", "ego", "Other")
    assert (condition.above, condition.centres, condition.rising) == (0.8, True, True)
    assert [(entry.done, entry.delay) for entry in present(brake.when)] == [(change.id, 1.0)]
    assert (brake.speed, brake.rate) == (15.0, 4.0)


def test_parameters_of_the_scenario_replace_those_of_the_file() -> None:
    near, far = (of_file(slower_cut_in(), parameters={"gap": gap}).scenario.traffic[0] for gap in (12, 60.5))
    assert present(near.actions[0].when)[0].below == 12.0
    assert far.s - near.s == pytest.approx(3 * 48.5, abs=0.5)
    assert near.speed == 22.0


def test_a_change_of_lanes_by_absolute_lane_has_sumo_s_index() -> None:
    (change,) = actions(with_events(event("in", change_of_lane('<AbsoluteTargetLane value="${-2 + 1}"/>', 2), when_time(3))))
    assert isinstance(change, CutIn)
    assert (change.lane, change.by, change.seconds) == (2, None, 2.0)


def test_speeds_change_in_a_time_a_distance_or_at_a_rate() -> None:
    relative = '<RelativeTargetSpeed entityRef="Ego" value="1.2" speedTargetValueType="factor" continuous="true"/>'
    contents = (
        change_of_speed(absolute(10), "linear", "time", 4),
        change_of_speed(absolute(10), "linear", "distance", 80),
        change_of_speed(absolute(40), "linear", "rate", 2),
        change_of_speed(relative),
        change_of_speed(absolute(10), "linear", "rate", 0),
    )
    events = [event(f"e{n}", f"<LongitudinalAction>{content}</LongitudinalAction>") for n, content in enumerate(contents)]
    result = actions(with_events(*events))
    assert [(action.seconds, action.metres, action.rate) for action in result if isinstance(action, Brake)] == [
        (4.0, None, None), (None, 80.0, None), (None, None, 2.0), (0.0, None, None),
    ]  # fmt: skip
    last = result[-1]
    assert isinstance(last, Brake)
    assert (last.like, last.factor, last.speed, last.continuous) == ("ego", 1.2, 0.0, True)


def speed(name: str, value: float, *conditions: str, rate: float = 2) -> str:
    """An event that changes the speed."""
    content = f"<LongitudinalAction>{change_of_speed(absolute(value), 'linear', 'rate', rate)}</LongitudinalAction>"
    return event(name, content, *conditions)


def test_conditions_on_several_vehicles_hold_at_once() -> None:
    (change,) = actions(with_events(event("in", IN, when_all("none"))))
    assert [(entry.vehicle, entry.rising) for entry in present(change.when)] == [("Other", False), ("ego", False)]


@pytest.mark.parametrize(
    ("rule", "strict"),
    [
        ("greaterThan", (True, False)),
        ("lessThan", (True, True)),
        ("greaterOrEqual", (False, False)),
        ("lessOrEqual", (False, False)),
    ],
)
def test_the_value_itself_counts_by_its_rule(rule: str, strict: tuple[bool, bool]) -> None:
    conditions = when("Other", f'<SpeedCondition value="3" rule="{rule}"/>'), when_time(3, rule)
    (change,) = actions(with_events(event("in", IN, *conditions)))
    assert tuple(condition.strict for condition in present(change.when)) == strict


def test_what_waits_for_several_actions_waits_for_the_last_of_them() -> None:
    """Edges of each alone would have to rise in the same step."""
    both = speed("slow", 20, when_time(1)).replace("</Event>", "").replace("</Action>", "</Action>" + ACTION)
    result = actions(with_events(both + "</Event>", speed("then", 30, when_state("event", "slow", edge="rising"))))
    assert [(entry.done, entry.rising) for entry in present(result[-1].when)] == [(result[0].id, False), (result[1].id, False)]


def test_what_waits_for_an_action_without_effect_remembers_that_it_is_done() -> None:
    """The conditions of the ineffective action may hold only once, before the conditions of the waiting action."""
    idle = speed("idle", 10, when("Ego", NEAR.replace("$gap", "12")), rate=0)
    second = speed("second", 10, when_state("event", "idle", edge="rising"), rate=0)
    unwanted = speed("unwanted", 10, when_time(1), rate=0)
    awaiting = speed("then", 20, when_state("action", "secondAction", delay=2))
    brake, last, first = actions(with_events(idle, second, unwanted, awaiting))
    assert [action.do for action in (brake, last, first)] == ["brake", "wait", "wait"]
    conditions = [condition for action in (brake, last, first) for condition in action.when or ()]
    assert [(condition.quantity, condition.done, condition.delay) for condition in conditions] == [
        (None, last.id, 2.0), (None, first.id, 0.0), ("gap", None, 0.0),
    ]  # fmt: skip


def test_repeated_and_skipped_events_are_noted() -> None:
    content = with_events(speed("slow", 20, when_time(1)))
    notes = of_file(content.replace(b'priority="overwrite"', b'priority="skip" maximumExecutionCount="3"')).notes
    assert sum("<Event>" in note for note in notes) == sum("<Event>" in note for note in of_file(content).notes) + 2


OFFSET = (
    '<LateralAction><LaneOffsetAction continuous="false"><LaneOffsetActionDynamics {}/>'
    '<LaneOffsetTarget><AbsoluteTargetLaneOffset value="0.9"/></LaneOffsetTarget></LaneOffsetAction></LateralAction>'
)


@pytest.mark.parametrize(
    ("dynamics", "acceleration", "seconds", "noted"),
    [
        ('maxLateralAcc="0.5" dynamicsShape="sinusoidal"', 0.5, None, False),
        ('maxLateralAcc="100" dynamicsShape="sinusoidal"', 20.0, None, False),
        ('maxLateralAcc="0.5" dynamicsShape="linear"', 0.5, None, True),
        ('maxLateralAcc="0.5" dynamicsShape="step"', None, 0.1, True),
        ('dynamicsShape="sinusoidal"', None, None, True),
        ('maxLateralAcc="INF" dynamicsShape="sinusoidal"', None, None, True),
    ],
)
def test_offsets_are_drifts(dynamics: str, acceleration: float | None, seconds: float | None, noted: bool) -> None:
    content = with_events(event("drift", OFFSET.format(dynamics), when_time(2)))
    (drift,) = actions(content)
    assert isinstance(drift, Drift)
    assert (drift.offset, drift.lateral_acceleration, drift.seconds) == (0.9, acceleration, seconds)
    assert any("<LaneOffsetActionDynamics>" in note and "driven" in note for note in of_file(content).notes) is noted


def test_offsets_on_left_lanes_count_to_the_left_of_the_road(monkeypatch: pytest.MonkeyPatch) -> None:
    content = with_events(event("drift", OFFSET.format(""), when_time(2)), other=start("Other", lane(2, 900), absolute(25)))
    (drift,) = actions(content)
    assert isinstance(drift, Drift)
    assert drift.offset == -0.9
    monkeypatch.setattr(Map, "lane_numbers", lambda *_: ["-1", "1"])
    assert "<AbsoluteTargetLaneOffset>" in refused(content)


def test_the_act_s_trigger_comes_before_the_event_s() -> None:
    story = act("Other", event("in", change_of_lane(BESIDE), when("Ego", NEAR)), conditions=(when_time(4),))
    (action,) = of_file(scenario(CARS, EGO + OTHER, story, parameters={"gap": 20})).scenario.traffic[0].actions
    assert action.when is not None
    assert [condition.above for condition in action.after] == [4.0]
    assert [condition.below for condition in action.when] == [20.0]


def test_an_obstacle_stands_and_a_leader_leaves_before_it() -> None:
    leader, box = of_file(cut_out()).scenario.traffic
    assert (box.speed, box.length, box.model, box.actions) == (0.0, 2.0, "constant", [])
    (change,) = leader.actions
    assert isinstance(change, CutIn)
    assert (change.by, change.beside, change.metres) == (1, None, 60.0)
    (reach,) = present(change.when)
    assert (reach.quantity, reach.vehicle, reach.below) == ("distance", "Other", 1.0)


def test_a_place_to_be_reached_is_on_its_own_lane_of_the_route() -> None:
    places = []
    for position in (lane(-3, 300), lane(-2, 300), lane(-1, 320, 0.6)):
        reach = f'<ReachPositionCondition tolerance="2">{position}</ReachPositionCondition>'
        (change,) = actions(with_events(event("in", IN, when("Other", reach, "none"))))
        assert change.when is not None
        places.append((present(change.when[0].s), change.when[0].d))
    assert places[0][0] == pytest.approx(300, abs=0.5)
    assert [s - places[0][0] for s, _ in places] == pytest.approx([0, 0, 20], abs=0.05)
    assert [d - places[0][1] for _, d in places] == pytest.approx([0, 3.5, 7.6], abs=0.05)


@pytest.mark.parametrize("kind", ['RelativeLanePosition dLane="0"', 'RelativeRoadPosition dt="0"'])
def test_a_place_that_moves_with_an_entity_is_not_reached(kind: str) -> None:
    """It would stay where it is at the start."""
    place = f'<Position><{kind} entityRef="Ego" ds="30"/></Position>'
    reach = f'<ReachPositionCondition tolerance="2">{place}</ReachPositionCondition>'
    assert "moves with" in refused(with_events(event("in", IN, when("Other", reach, "none"))))


def test_a_lane_that_is_driven_elsewhere_is_refused_by_its_type_there() -> None:
    sections = [
        (0.0, {-1: ("driving", PAVED), -2: ("driving", PAVED)}),
        (500.0, {-1: ("driving", PAVED), -2: ("border", PAVED)}),
    ]
    road = document([Road("7", [line(1_000.0)], sections)])
    roads = Map(read_network(converted(road, ROAD).network, ROAD), lambda: read_opendrive(road, ROAD))
    place, other = (read_tree(lane(-2, s).encode(), "a.xosc", "Position") for s in (600, 400))
    assert roads.place(other, {}, []).index == 0
    with pytest.raises(InvalidInputError, match="border"):
        roads.place(place, {}, [])


def test_a_place_beside_the_route_is_not_reached() -> None:
    reach = f'<ReachPositionCondition tolerance="2">{lane(2, 300)}</ReachPositionCondition>'
    assert "route" in refused(with_events(event("in", IN, when("Other", reach, "none"))))


def test_what_drives_the_ego_vehicle_in_the_file_is_noted() -> None:
    driven = {"Ego": vehicle() + "<ObjectController/><ObjectController/>", "Other": vehicle()}
    notes = of_file(scenario(driven, EGO + OTHER, act("Ego", event("brake", BRAKE)))).notes
    assert any("<ObjectController>" in note for note in notes)
    assert any("<Event>" in note and "controller" in note for note in notes)


def test_what_is_ignored_is_noted_with_its_line() -> None:
    content = cut_in().replace(b"<Entities>", b"<Environment><Weather/></Environment>\n<Entities>")
    assert any(note.startswith("scenarios/a.xosc: line 6, <Environment>: ignored") for note in of_file(content).notes)


def test_attributes_that_are_not_read_are_noted_with_their_line() -> None:
    content = cut_in().replace(b'freespace="false"', b'freespace="false" coordinateSystem="entity" alongRoute="true"')
    more = [note for note in of_file(content).notes if note not in of_file(cut_in()).notes]
    assert len(more) == 2
    assert all("<TimeHeadwayCondition>" in note for note in more)
    assert any("entity" in note for note in more)
    assert any(note.endswith("ignored: alongRoute") for note in more)
    assert of_file(content.replace(b'"entity"', b'"lane"').replace(b' alongRoute="true"', b"")).notes == of_file(cut_in()).notes
    assert not any("ignored" in note for note in of_file(cut_in()).notes)


def test_distances_of_reference_points_that_are_measured_from_centres_are_noted_with_the_metres() -> None:
    reach = f'<ReachPositionCondition tolerance="2">{lane(-3, 300)}</ReachPositionCondition>'
    free = HEADWAY.replace('"false"', '"true"')
    for condition, ego, other, metres in (
        (HEADWAY, 1.4, 1.3, "0.10 m"),
        (HEADWAY, 1.4, 1.4, None),
        (free, 1.4, 0.2, None),
        (reach, 1.4, 0.2, "1.40 m"),
        (reach, 0.0, 1.3, None),
    ):
        cars = {"Ego": vehicle(4.6, ego), "Other": vehicle(4.6, other)}
        notes = of_file(scenario(cars, EGO + OTHER, act("Other", event("in", IN, when("Ego", condition, "none"))))).notes
        assert [metres in note for note in notes if "centres" in note and metres] == ([True] if metres else [])
        assert any("centres" in note for note in notes) is (metres is not None)


def test_a_road_without_limits_needs_the_scenario_s_default_limit() -> None:
    road = motorway().replace(b"<speed ", b"<velocity ")
    roads = {ROAD: Map(read_network(converted(road, ROAD).network, ROAD), lambda: read_opendrive(road, ROAD))}
    files = {name: BundleFile(content, executable=False) for name, content in (("scenarios/a.xosc", cut_out()), (ROAD, road))}

    def found(**data: Any) -> Description:
        return described(
            declared_scenario({"openscenario": "scenarios/a.xosc", **data}), files_read(files), roads.__getitem__, STEP
        )

    assert [problem.field for problem in faults_of(found)] == ["default_limit"]
    assert found(default_limit=30).scenario.default_limit == 30.0


IDLE = f"<LongitudinalAction>{change_of_speed(absolute(15), 'linear', 'rate', 0)}</LongitudinalAction>"


def when_state(kind: str, reference: str, state: str = "completeState", edge: str = "none", delay: object = 0) -> str:
    """A condition on the state of a part of the storyboard."""
    return (
        f'<Condition name="d" delay="{delay}" conditionEdge="{edge}"><ByValueCondition><StoryboardElementStateCondition '
        f'storyboardElementType="{kind}" storyboardElementRef="{reference}" state="{state}"/></ByValueCondition></Condition>'
    )


def maneuver(name: str, *events: str) -> str:
    return f'<Maneuver name="{name}">{"".join(events)}</Maneuver>'


def story(*maneuvers: str, actor: str = "Other", group: str = "group") -> str:
    """A <Story> of one act and one group of maneuvers."""
    return (
        f'<Story name="story"><Act name="act"><ManeuverGroup name="{group}" maximumExecutionCount="1"><Actors '
        f'selectTriggeringEntities="false"><EntityRef entityRef="{actor}"/></Actors>{"".join(maneuvers)}</ManeuverGroup>'
        "<StartTrigger/></Act></Story>"
    )


def file(*stories: str) -> bytes:
    return scenario(CARS, EGO + OTHER, "".join(stories))


def two_of_a_name(reference: str, kind: str = "event", state: str = "completeState") -> bytes:
    """Two maneuvers with events of one name; the second event waits."""
    second = event("go", IN, when_state(kind, reference, state))
    return file(story(maneuver("first", event("go", BRAKE, when_time(2))), maneuver("second", second)))


@pytest.mark.parametrize(
    ("kind", "reference"),
    [
        ("event", "first::go"),
        ("event", "group::first::go"),
        ("event", "act::first::go"),
        ("event", "story::act::group::first::go"),
        ("action", "first::goAction"),
        ("action", "first::go::goAction"),
        ("maneuver", "first"),
    ],
)
def test_a_reference_may_have_names_of_parts_around_before_its_own(kind: str, reference: str) -> None:
    brake, change = actions(two_of_a_name(reference, kind))
    assert [condition.done for condition in present(change.when)] == [brake.id]


@pytest.mark.parametrize("reference", ["go", "act::go", "story::group::go"])
def test_a_reference_that_fits_two_parts_names_both(reference: str) -> None:
    message = refused(two_of_a_name(reference))
    assert "story::act::group::first::go" in message
    assert "story::act::group::second::go" in message


@pytest.mark.parametrize("reference", ["third::go", "first::group::go", "go::first", "", "::go", "first::"])
def test_a_reference_that_fits_nothing_is_refused(reference: str) -> None:
    assert "there is no event" in refused(two_of_a_name(reference))


def test_a_part_with_the_ego_vehicle_is_another_one_too() -> None:
    content = file(
        story(maneuver("first", event("go", BRAKE)), actor="Ego", group="own"),
        story(maneuver("first", event("go", BRAKE), event("then", IN, when_state("event", "go")))),
    )
    assert "story::act::own::first::go" in refused(content)
    brake, change = actions(content.replace(b'Ref="go"', b'Ref="group::first::go"'))
    assert [condition.done for condition in present(change.when)] == [brake.id]
    assert "with actions of the traffic" in refused(content.replace(b'Ref="go"', b'Ref="own::first::go"'))


@pytest.mark.parametrize(("kind", "reference"), [("act", "late"), ("maneuverGroup", "late::group"), ("maneuver", "first")])
def test_an_act_and_what_is_in_it_begin_with_its_trigger_not_with_their_first_action(kind: str, reference: str) -> None:
    first = story(maneuver("first", event("go", BRAKE, when_time(2)))).replace('Act name="act"', 'Act name="late"')
    first = first.replace("<StartTrigger/></Act>", f"{trigger(when_time(3))}</Act>")
    waits = event("then", IN, when_state(kind, reference, "runningState"))
    _, change, begin = actions(file(first, story(maneuver("second", waits)).replace('"story"', '"other"')))
    assert [condition.begun for condition in present(change.when)] == [begin.id]
    assert begin.do == "wait"
    assert not begin.after
    assert [condition.above for condition in present(begin.when)] == [3.0]


@pytest.mark.parametrize(
    ("kind", "reference"), [("maneuver", "first"), ("maneuver", "second"), ("act", "act"), ("story", "story")]
)
def test_what_has_begun_with_the_act_around_or_with_a_story_is_waited_for_no_longer_than_its_delay(
    kind: str, reference: str
) -> None:
    content = two_of_a_name(reference, kind, "runningState")
    assert actions(content)[1].when == []
    late, *_ = present(
        actions(content.replace(b'name="d" delay="0" conditionEdge="none"', b'name="d" delay="5" conditionEdge="rising"'))[
            1
        ].when
    )
    assert (late.delay, late.rising) == (5.0, False)
    assert (late.quantity, late.above) == ("time", 0.0) if kind == "story" else late.begun is not None


def test_what_is_not_read_of_an_acts_trigger_is_noted() -> None:
    content = file(
        story(maneuver("first", event("go", BRAKE))).replace("<StartTrigger/></Act>", '<StartTrigger strange="1"/></Act>')
    )
    assert any("strange" in note for note in of_file(content).notes)


@pytest.mark.slow
def test_a_storyboard_with_too_many_parts_is_refused() -> None:
    events = "".join(f'<Event name="e{index}" priority="parallel"/>' for index in range(10_001))
    assert "10,000 parts" in refused(file(story(maneuver("first", events))))


def events_of(priority: str, *others: str) -> bytes:
    """A change of lanes, and an event of this priority during it."""
    late = event("late", BRAKE, when_time(4)).replace('"overwrite"', f'"{priority}"')
    return file(story(maneuver("first", event("in", IN, when_time(3)), late, *others)))


@pytest.mark.parametrize(("priority", "ends"), [("override", True), ("overwrite", True), ("parallel", False), ("skip", False)])
def test_an_event_ends_the_others_of_its_maneuver_by_its_priority(priority: str, ends: bool) -> None:
    change, brake = actions(events_of(priority))
    assert brake.ends == ([change.id] if ends else [])


def test_an_event_ends_neither_those_of_other_maneuvers_nor_actions_of_its_own() -> None:
    both = event("both", IN, when_time(1)).replace(
        "</Action>", f'</Action><Action name="also"><PrivateAction>{BRAKE}</PrivateAction></Action>'
    )
    content = file(story(maneuver("first", both), maneuver("second", event("late", BRAKE, when_time(4)))))
    assert [action.ends for action in actions(content)] == [[], [], []]


def test_an_event_without_effect_ends_none_and_is_noted() -> None:
    idle = events_of("overwrite", event("idle", IDLE, when_time(5)))
    assert [len(action.ends) for action in actions(idle)] == [1, 1]
    assert any("ends no other event" in note for note in of_file(idle).notes)


def test_a_priority_that_is_unknown_is_refused() -> None:
    assert "priority" in refused(events_of("urgent"))


def test_maneuvers_of_catalogs_are_refused() -> None:
    reference = '<CatalogReference catalogName="c" entryName="e"/>'
    assert "<CatalogReference>" in refused(file(story(reference)))
