"""Riders, pedestrians and obstacles of OpenSCENARIO files on trajectories, routes and places off the lanes; maneuvers of catalogs."""

from math import cos, hypot, pi, sin

import numpy as np
import pytest
from tests.support.opendrive_files import exit_ramp
from tests.support.scenario_files import (
    BOX,
    BRAKE,
    CARS,
    EGO,
    IN,
    OTHER,
    STEP,
    absolute,
    act,
    change_of_speed,
    event,
    lane,
    maps,
    of_file,
    refused,
    scenario,
    start,
    trigger,
    vehicle,
    when,
    when_time,
)

from drivecal.bundles.highway import TrafficEntry
from drivecal.bundles.highway_actions import Brake, Meet
from drivecal.bundles.highway_checks import scenario_problems
from drivecal.bundles.traffic import entities
from drivecal.bundles.traffic.description import Description
from drivecal.bundles.traffic.places import Map
from drivecal.domain.errors import InvalidInputError
from drivecal.roads.conversion import converted
from drivecal.roads.network import read_network
from drivecal.roads.opendrive import read_opendrive

HEADING = 0.2
"""Heading of the motorway's straight, which begins at (100, 50)."""
WALKER = (
    f'<Pedestrian name="p" mass="1" pedestrianCategory="pedestrian">{BOX.format(centre=0, length=0.6, width=0.5)}</Pedestrian>'
)
LOCATIONS = "".join(
    f'<{kind}Catalog><Directory path=".\\catalogs"/></{kind}Catalog>' for kind in ("Vehicle", "Maneuver", "Trajectory", "Route")
)
WAY = (
    '<Trajectory name="across" closed="false"><ParameterDeclarations><ParameterDeclaration name="s" parameterType="double" value="1"/>'
    "</ParameterDeclarations><Shape><Polyline><Vertex>{}</Vertex><Vertex>{}</Vertex></Polyline></Shape></Trajectory>"
).format(lane(-3, "$s", -6), lane(-3, "$s", 6))
GIVEN = '<ParameterAssignments><ParameterAssignment parameterRef="s" value="400"/></ParameterAssignments>'
ACROSS = f'<TrajectoryRef><CatalogReference catalogName="ways" entryName="across">{GIVEN}</CatalogReference></TrajectoryRef>'
FOLLOW = (
    "<PrivateAction><RoutingAction><FollowTrajectoryAction><TimeReference><None/></TimeReference>"
    f'<TrajectoryFollowingMode followingMode="position"/>{ACROSS}</FollowTrajectoryAction></RoutingAction></PrivateAction>'
)
STORY = (
    '<Story name="s"><Act name="a"><ManeuverGroup name="g" maximumExecutionCount="1"><Actors selectTriggeringEntities="false">{actors}'
    "</Actors>{content}</ManeuverGroup></Act></Story>"
)
MEET = (
    '<Maneuver name="m"><Event name="e" priority="override"><Action name="x"><PrivateAction><SynchronizeAction masterEntityRef="Ego">'
    "<TargetPositionMaster>{master}</TargetPositionMaster><TargetPosition>{own}</TargetPosition>{final}"
    "</SynchronizeAction></PrivateAction></Action></Event></Maneuver>"
)
FINAL = '<FinalSpeed><AbsoluteSpeed value="1.5"><TargetDistanceSteadyState distance="4"/></AbsoluteSpeed></FinalSpeed>'


def catalog(name: str, content: str) -> bytes:
    return f'<OpenSCENARIO><FileHeader revMajor="1" revMinor="3"/><Catalog name="{name}">{content}</Catalog></OpenSCENARIO>'.encode()


def read(entities: dict[str, str], starts: str, stories: str = "", **catalogs: str) -> Description:
    content = scenario(entities, starts, stories).replace(
        b"<RoadNetwork>", f"<CatalogLocations>{LOCATIONS}</CatalogLocations><RoadNetwork>".encode()
    )
    files = {f"scenarios/catalogs/{name}.xosc": catalog(name, text) for name, text in ({"ways": WAY} | catalogs).items()}
    description = of_file(content, files)
    assert list(scenario_problems("scenarios.x", description.scenario, STEP, is_whole=True)) == []
    return description


def private(name: str, *actions: str) -> str:
    return f'<Private entityRef="{name}">{"".join(actions)}</Private>'


def moved(position: str) -> str:
    return f"<PrivateAction><TeleportAction>{position}</TeleportAction></PrivateAction>"


def acting(actor: str, content: str) -> str:
    return STORY.format(actors=f'<EntityRef entityRef="{actor}"/>' if actor else "", content=content)


def along_road(x: float, y: float) -> tuple[float, float]:
    """Metres along the straight of the motorway, and to the left of its reference line."""
    dx, dy = x - 100.0, y - 50.0
    return dx * cos(HEADING) + dy * sin(HEADING), dy * cos(HEADING) - dx * sin(HEADING)


def other_of(description: Description) -> TrafficEntry:
    (entry,) = description.scenario.traffic
    return entry


def path_of(entry: TrafficEntry) -> list[tuple[float, float]]:
    assert entry.path is not None
    return [along_road(*point) for point in entry.path]


def test_a_pedestrian_of_a_trajectory_of_a_catalog_meets_the_ego_vehicle() -> None:
    own = f'<TrajectoryPosition s="7">{ACROSS}</TrajectoryPosition>'
    master = '<LanePosition roadId="7" laneId="-3" s="390"/>'
    content = acting("Other", MEET.format(master=master, own=own, final=FINAL))
    walker = other_of(read(CARS | {"Other": WALKER}, EGO + private("Other", FOLLOW), content))
    assert (walker.s, walker.speed, walker.length, walker.width, walker.model) == (0.0, 0.0, 0.6, 0.5, "constant")
    (first, right), (last, left) = path_of(walker)
    assert (first, last) == pytest.approx((400.0, 400.0), abs=0.01)
    assert (right, left) == pytest.approx((-8.75 - 6.0, -8.75 + 6.0), abs=0.01)
    (meet,) = walker.actions
    assert isinstance(meet, Meet)
    assert (meet.other, meet.speed, meet.steady) == ("ego", 1.5, 4.0)
    assert meet.at == pytest.approx(7.0)
    assert meet.other_s == pytest.approx(390.0 + 1.4, abs=0.1)  # the centre is ahead of the reference point


def test_a_trajectory_is_followed_as_it_is_also_by_a_vehicle_beside_it() -> None:
    follow = FOLLOW.replace(ACROSS, WAY)
    walker = other_of(read(CARS | {"Other": WALKER}, EGO + private("Other", moved(lane(-3, 3)), follow)))
    (first, right), (last, left) = path_of(walker)
    assert (first, last) == pytest.approx((1.0, 1.0), abs=0.01)
    assert right < -8.75 < left == pytest.approx(-8.75 + 6.0, abs=0.01)


def test_entries_of_catalogs_have_a_limit_of_elements_together(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(entities, "MOST_ELEMENTS", 15)
    with pytest.raises(InvalidInputError, match="catalogs have more than 15 elements"):
        read(CARS | {"Other": WALKER, "Next": WALKER}, EGO + private("Other", FOLLOW) + private("Next", FOLLOW))


def test_a_pedestrian_walks_on_a_lane_and_a_bicycle_has_its_size() -> None:
    rider = vehicle(length=1.9, centre=0.6, category="bicycle").replace('width="1.9"', 'width="0.5"')
    speed = f"<PrivateAction><LongitudinalAction>{change_of_speed(absolute(4))}</LongitudinalAction></PrivateAction>"
    description = read(CARS | {"Other": rider, "Walker": WALKER}, EGO + OTHER + private("Walker", moved(lane(-3, 300)), speed))
    bicycle, walker = description.scenario.traffic
    assert (bicycle.length, bicycle.width, bicycle.path) == (1.9, 0.5, None)
    assert (walker.length, walker.speed, walker.path) == (0.6, 4.0, None)


def test_a_vehicle_against_its_lane_comes_towards_the_ego_vehicle() -> None:
    turned = '<Orientation h="${pi}"/>'
    position = f'<Position><RelativeRoadPosition entityRef="Ego" ds="300" dt="0.5">{turned}</RelativeRoadPosition></Position>'
    oncoming = other_of(read(CARS, EGO + start("Other", position, absolute(20))))
    points = path_of(oncoming)
    assert points[0] == pytest.approx((450.0, -8.25), abs=0.05)
    assert points[-1][0] < points[0][0]
    assert all(point[1] == pytest.approx(-8.25, abs=0.1) for point in points)
    assert (oncoming.s, oncoming.speed) == (1.4, 20.0)


@pytest.mark.parametrize(
    ("kind", "heading", "is_against"),
    [("relative", pi, True), ("relative", 0.0, False), ("absolute", HEADING, True), ("absolute", HEADING + pi, False)],
)
def test_on_a_left_lane_the_heading_says_whether_a_vehicle_drives_against_it(
    kind: str, heading: float, is_against: bool
) -> None:
    beside = lane(1, 300).replace("/></Po", f'><Orientation type="{kind}" h="{heading}"/></LanePosition></Po')
    description = read(CARS, EGO + start("Other", beside, absolute(20)))
    path = other_of(description).path
    assert (path is not None) is is_against
    assert path is None or along_road(*path[-1])[0] > 500.0
    assert any("against the direction of its lane" in note for note in description.notes) is is_against


def test_an_obstacle_stands_relative_to_another_one() -> None:
    beside = '<Position><RelativeObjectPosition entityRef="Other" dx="10" dy="-9"/></Position>'
    description = read(CARS | {"Third": vehicle()}, EGO + OTHER + private("Third", moved(beside)))
    third = description.scenario.traffic[1]
    first, ahead = path_of(third)
    assert first == pytest.approx((210.0, -5.25 - 9.0), abs=0.05)
    assert ahead[0] - first[0] == pytest.approx(1e3, abs=0.01)


@pytest.mark.parametrize(("kind", "heading"), [("absolute", pi / 2), ("relative", HEADING + pi / 2)])
def test_a_heading_beside_another_vehicle_is_absolute_or_relative(kind: str, heading: float) -> None:
    turned = f'<Orientation type="{kind}" h="${{pi / 2}}"/>'
    beside = f'<Position><RelativeObjectPosition entityRef="Other" dx="10" dy="-9">{turned}</RelativeObjectPosition></Position>'
    third = read(CARS | {"Third": vehicle()}, EGO + OTHER + private("Third", moved(beside))).scenario.traffic[1]
    (x, y), (ahead_x, ahead_y) = third.path or []
    assert (ahead_x - x, ahead_y - y) == pytest.approx((1e3 * cos(heading), 1e3 * sin(heading)), abs=1e-2)


def world(along: float, left: float, turn: float) -> str:
    """A <Position> by coordinates: metres along the motorway's straight, to its left, and a turn from its direction (rad)."""
    x, y = (100.0, 50.0) + np.array([[cos(HEADING), -sin(HEADING)], [sin(HEADING), cos(HEADING)]]) @ (along, left)
    return f'<Position><WorldPosition x="{x}" y="{y}" h="{HEADING + turn}"/></Position>'


def turned(index: int, turn: float) -> str:
    """A <Position> on a lane, turned from the direction of the lane, or across a left one from the road's."""
    return lane(index, 300).replace("/></Position>", f'><Orientation type="relative" h="{turn}"/></LanePosition></Position>')


@pytest.mark.parametrize(
    ("position", "begin", "ahead"),
    [
        (world(300, -9, pi / 2), (300.0, -9.0), (0.0, 1.0)),
        (world(300, -9, -pi / 2), (300.0, -9.0), (0.0, -1.0)),
        (world(300, -40, pi / 2), (300.0, -40.0), (0.0, 1.0)),
        (world(300, -10.5 - 3.4, 0.0), (300.0, -13.9), (1.0, 0.0)),
        (turned(-3, pi / 2), (300.0, -8.75), (0.0, 1.0)),
        (turned(3, -pi / 2), (300.0, 8.75), (0.0, -1.0)),
    ],
)
def test_a_pedestrian_walks_in_the_direction_of_its_heading(
    position: str, begin: tuple[float, float], ahead: tuple[float, float]
) -> None:
    walker = other_of(read(CARS | {"Other": WALKER}, EGO + private("Other", moved(position))))
    first, last = np.array(path_of(walker))
    assert first == pytest.approx(begin, abs=0.05)
    assert (last - first) / 1e3 == pytest.approx(ahead, abs=0.01)


def test_a_vehicle_that_comes_towards_the_ego_vehicle_stays_in_that_lane() -> None:
    first, last = path_of(other_of(read(CARS, EGO + private("Other", moved(world(300, -1.75, pi))))))[:2]
    assert first == pytest.approx((300.0, -1.75), abs=0.05)
    assert last[0] < first[0]
    assert last[1] == pytest.approx(-1.75, abs=0.05)


def test_a_vehicle_ahead_of_another_in_its_lane_drives_on_the_lane() -> None:
    ahead = '<Position><RelativeObjectPosition entityRef="Ego" dx="60" dy="0"/></Position>'
    car = other_of(read(CARS, EGO + private("Other", moved(ahead))))
    beside = other_of(read(CARS, EGO + private("Other", moved(ahead.replace('dy="0"', 'dy="-3.4"')))))
    assert path_of(beside)[0] == pytest.approx((210.0, -8.75 - 3.4), abs=0.05)
    assert (car.path, car.edge) == (None, "-7")
    assert car.s == pytest.approx(150 + 60 + 1.4, abs=0.5)


def test_places_that_rounding_moves_beyond_an_end_are_at_the_end() -> None:
    for s, own in (("-1e-12", 0.0), ("2000.0000001", 2000.0)):
        walker = start("Other", lane(-3, s, -6), absolute(0))
        (place,) = of_file(scenario(CARS | {"Other": WALKER}, EGO + walker)).scenario.traffic
        assert place.s == pytest.approx(own, abs=5.0)


def test_a_vehicle_on_an_exit_lane_leaves_the_drive_unless_it_changes_lanes(monkeypatch: pytest.MonkeyPatch) -> None:
    road = exit_ramp()
    network = read_network(converted(road, "a.xodr").network, "a.xodr")
    monkeypatch.setitem(maps(), "maps/motorway.xodr", Map(network, lambda: read_opendrive(road, "a.xodr")))
    at = '<Position><LanePosition roadId="1" laneId="{}" s="{}"/></Position>'
    starts = start("Ego", at.format(-1, 200), absolute(30)) + start("Other", at.format(-3, 500), absolute(25))
    stays = of_file(scenario(CARS, starts)).scenario
    changes = of_file(scenario(CARS, starts, act("Other", event("in", IN, when_time(1))))).scenario
    assert stays.route == ["-1#0", "-1#1", "-1#2", "-2"]
    assert [other.traffic[0].route for other in (stays, changes)] == [["-1#2", "-3"], None]


def test_a_rider_follows_a_route_beside_the_lane_s_centre() -> None:
    waypoints = "".join(f'<Waypoint routeStrategy="shortest">{lane(-3, s)}</Waypoint>' for s in (100, 1900))
    route = f'<Route name="r" closed="false">{waypoints}</Route>'
    reference = '<CatalogReference catalogName="routes" entryName="r"/>'
    at = '<InRoutePosition><FromLaneCoordinates laneId="-3" pathS="{}" laneOffset="1.5"/></InRoutePosition>'
    position = f"<RoutePosition><RouteRef>{reference}</RouteRef>{at.format(150)}</RoutePosition>"
    way = f"<PrivateAction><RoutingAction><AssignRouteAction>{reference}</AssignRouteAction></RoutingAction></PrivateAction>"
    own = f"<RoutePosition><RouteRef>{reference}</RouteRef>{at.format(300)}</RoutePosition>"
    content = acting("Other", MEET.format(master='<LanePosition roadId="7" laneId="-3" s="500"/>', own=own, final=""))
    starts = EGO.replace("</Private>", f"{way}</Private>") + private("Other", moved(f"<Position>{position}</Position>"), way)
    description = read(CARS, starts, content, routes=route)
    assert description.scenario.route == ["-7"]
    rider = other_of(description)
    assert rider.s == pytest.approx(150.0 + 1.4, abs=0.1)
    assert path_of(rider)[0] == pytest.approx((100.0, -8.75 + 1.5), abs=0.05)
    (meet,) = rider.actions
    assert isinstance(meet, Meet)
    assert meet.speed is None
    assert meet.at == pytest.approx(300.0 + 1.4, abs=0.2)


def test_a_place_on_a_route_has_the_lane_of_its_waypoints_or_is_refused() -> None:
    waypoints = "".join(f'<Waypoint routeStrategy="shortest">{lane(-3, s)}</Waypoint>' for s in (100, 1900))
    route = f'<RouteRef><Route name="r" closed="false">{waypoints}</Route></RouteRef><InRoutePosition>{{}}</InRoutePosition>'
    on_lane, on_road = (
        scenario(
            CARS, EGO + start("Other", f"<Position><RoutePosition>{route.format(at)}</RoutePosition></Position>", absolute(9))
        )
        for at in ('<FromLaneCoordinates pathS="150" laneId="-2"/>', '<FromRoadCoordinates pathS="150" t="-5"/>')
    )
    assert "laneId is -2, and the way of the waypoints is on lane -3 there" in refused(on_lane)
    assert any("<FromRoadCoordinates>: ignored: t" in note for note in of_file(on_road).notes)


def test_a_maneuver_of_a_catalog_is_driven_with_its_parameters() -> None:
    brake = f"<LongitudinalAction>{change_of_speed(absolute('$to'), 'linear', 'rate', 3)}</LongitudinalAction>"
    variable = '<GlobalAction><VariableAction variableRef="v"><SetAction value="true"/></VariableAction></GlobalAction>'
    collision = trigger(when("Ego", '<CollisionCondition><EntityRef entityRef="Other"/></CollisionCondition>'))
    events = (
        f'<Event name="e" priority="parallel"><Action name="a"><PrivateAction>{brake}</PrivateAction></Action></Event>'
        f'<Event name="f" priority="parallel"><Action name="b">{variable}</Action>{collision}</Event>'
    )
    own = '<ParameterDeclarations><ParameterDeclaration name="to" parameterType="double" value="9"/></ParameterDeclarations>'
    given = '<ParameterAssignments><ParameterAssignment parameterRef="$to" value="5"/></ParameterAssignments>'
    content = acting("Other", f'<CatalogReference catalogName="moves" entryName="m">{given}</CatalogReference>')
    description = read(CARS, EGO + OTHER, content, moves=f'<Maneuver name="m">{own}{events}</Maneuver>')
    (action,) = other_of(description).actions
    assert isinstance(action, Brake)
    assert (action.speed, action.rate) == (5.0, 3.0)
    assert [note for note in description.notes if note.startswith("scenarios/catalogs/moves.xosc: line 1, <GlobalAction>")]


@pytest.mark.parametrize(
    ("value", "delay", "begin"), [("true", 0, [[]]), ("true", 5, [[(0.0, 5.0, False)]]), ("false", 0, []), ("false", 5, [])]
)
def test_an_act_waits_for_a_parameter(value: str, delay: float, begin: list[list[tuple[float, float, bool]]]) -> None:
    waits = (
        when_time(value, "equalTo", "rising", delay)
        .replace("SimulationTime", "Parameter")
        .replace("value", 'parameterRef="limit" value')
    )
    story = act("Other", event("e", BRAKE), conditions=(waits,))
    content = scenario(CARS, EGO + OTHER, story, parameters={"limit": "true"})
    description = of_file(content)
    actions = other_of(description).actions
    assert [[(each.above, each.delay, each.rising) for each in action.after] for action in actions] == begin
    assert any("never begins" in note for note in description.notes) is not bool(begin)


def test_a_group_without_actors_is_noted() -> None:
    description = read(CARS, EGO + OTHER, acting("", '<Maneuver name="m"/>'))
    assert [note for note in description.notes if "<ManeuverGroup>" in note]


CLOTHOID = WAY.replace("<Polyline>", "<Clothoid>").replace("</Polyline>", "</Clothoid>")
CASES = {
    "ego on a trajectory": (EGO.replace("</Private>", f"{FOLLOW}</Private>"), "", WAY, "controller"),
    "another shape": (EGO + private("Other", FOLLOW), "", CLOTHOID, "Polyline"),
    "timed": (EGO + private("Other", FOLLOW.replace("<None/>", "<Timing/>")), "", WAY, "TimeReference"),
    "closed": (EGO + private("Other", FOLLOW), "", WAY.replace('closed="false"', 'closed="true"'), "closed"),
    "on a lane": (EGO + OTHER, MEET.format(master="", own="", final=""), WAY, "SynchronizeAction"),
    "unknown entry": (EGO + private("Other", FOLLOW), "", WAY.replace('name="across"', 'name="along"'), "across"),
}


@pytest.mark.parametrize("case", CASES)
def test_ways_that_are_not_supported_are_refused_by_line(case: str) -> None:
    starts, content, way, part = CASES[case]
    whole = scenario(CARS, starts, acting("Other", content) if content else "").replace(
        b"<RoadNetwork>", f"<CatalogLocations>{LOCATIONS}</CatalogLocations><RoadNetwork>".encode()
    )
    message = refused(whole, files={"scenarios/catalogs/ways.xosc": catalog("ways", way)})
    assert part in message
    assert "line " in message


def test_places_off_the_lanes_keep_their_distances() -> None:
    points = path_of(other_of(read(CARS | {"Other": WALKER}, EGO + private("Other", FOLLOW))))
    assert hypot(points[1][0] - points[0][0], points[1][1] - points[0][1]) == pytest.approx(12.0, abs=0.02)
