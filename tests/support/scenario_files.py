"""OpenSCENARIO and SUMO route files for tests, of the shape of public ones: cut in, cut out, follow and brake on a motorway."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from tests.support.networks import entrance
from tests.support.opendrive_files import PAVED, Road, arc, document, line

from drivecal.bundles.archives import BundleFile
from drivecal.bundles.highway_checks import declared_scenario
from drivecal.bundles.highway_roads import files_read
from drivecal.bundles.traffic.description import Description, described
from drivecal.bundles.traffic.places import Map
from drivecal.domain.errors import InvalidInputError
from drivecal.roads.conversion import converted
from drivecal.roads.network import read_network
from drivecal.roads.opendrive import read_opendrive

STEP = 0.1
BOX = '<BoundingBox><Center x="{centre}" y="0" z="0.8"/><Dimensions length="{length}" width="{width}" height="1.6"/></BoundingBox>'


def motorway() -> bytes:
    """An OpenDRIVE road with three lanes to drive and a shoulder in each direction: 600 m straight, then a curve."""
    lanes = {side * index: ("driving", PAVED) for side in (1, -1) for index in (1, 2, 3)} | {
        side * 4: ("shoulder", [(0.0, 2.5, 0.0, 0.0, 0.0)]) for side in (1, -1)
    }
    shapes = [line(600.0), arc(1_400.0, 1 / 2_000)]
    return document([Road("7", shapes, [(0.0, lanes)], (100.0, 50.0, 0.2), limit=("130", "km/h"))])


def vehicle(length: float = 4.6, centre: float = 1.4, category: str = "car") -> str:
    """A <Vehicle>."""
    return f'<Vehicle name="car" vehicleCategory="{category}">{BOX.format(centre=centre, length=length, width=1.9)}</Vehicle>'


def lane(index: object, s: object, offset: object = 0) -> str:
    """A <Position> on a lane."""
    return f'<Position><LanePosition roadId="7" laneId="{index}" s="{s}" offset="{offset}"/></Position>'


def start(name: str, position: str, speed: str) -> str:
    """Returns a <Private> of <Init> with `speed` as its <SpeedActionTarget>."""
    return (
        f'<Private entityRef="{name}"><PrivateAction><TeleportAction>{position}</TeleportAction></PrivateAction><PrivateAction>'
        f"<LongitudinalAction>{change_of_speed(speed)}</LongitudinalAction></PrivateAction></Private>"
    )


def change_of_speed(target: str, shape: str = "step", dimension: str = "time", value: object = 0) -> str:
    """A <SpeedAction>."""
    return (
        f'<SpeedAction><SpeedActionDynamics dynamicsShape="{shape}" dynamicsDimension="{dimension}" value="{value}"/>'
        f"<SpeedActionTarget>{target}</SpeedActionTarget></SpeedAction>"
    )


def absolute(value: object) -> str:
    """A target speed."""
    return f'<AbsoluteTargetSpeed value="{value}"/>'


def change_of_lane(target: str, value: object = 3, dimension: str = "time") -> str:
    """A <LateralAction>."""
    return (
        f'<LateralAction><LaneChangeAction><LaneChangeActionDynamics dynamicsShape="sinusoidal" dynamicsDimension="{dimension}" '
        f'value="{value}"/><LaneChangeTarget>{target}</LaneChangeTarget></LaneChangeAction></LateralAction>'
    )


def when_time(value: object, rule: str = "greaterThan", edge: str = "none", delay: object = 0) -> str:
    """A <Condition> on the time."""
    return (
        f'<Condition name="t" delay="{delay}" conditionEdge="{edge}"><ByValueCondition><SimulationTimeCondition value="{value}" '
        f'rule="{rule}"/></ByValueCondition></Condition>'
    )


def when(entity: str, condition: str, edge: str = "rising") -> str:
    """A <Condition> on an entity."""
    return (
        f'<Condition name="c" delay="0" conditionEdge="{edge}"><ByEntityCondition><TriggeringEntities triggeringEntitiesRule="any">'
        f'<EntityRef entityRef="{entity}"/></TriggeringEntities><EntityCondition>{condition}</EntityCondition></ByEntityCondition>'
        "</Condition>"
    )


def trigger(*conditions: str, tag: str = "StartTrigger") -> str:
    """A <StartTrigger> of one group."""
    return f"<{tag}><ConditionGroup>{''.join(conditions)}</ConditionGroup></{tag}>" if conditions else f"<{tag}/>"


def event(name: str, content: str, *conditions: str) -> str:
    """An <Event> with an action of the same name."""
    return (
        f'<Event name="{name}" priority="overwrite"><Action name="{name}Action"><PrivateAction>{content}</PrivateAction></Action>'
        f"{trigger(*conditions)}</Event>"
    )


def act(actor: str, *events: str, conditions: tuple[str, ...] = ()) -> str:
    """A <Story> of one act."""
    return (
        f'<Story name="story"><Act name="act"><ManeuverGroup name="group" maximumExecutionCount="1"><Actors '
        f'selectTriggeringEntities="false"><EntityRef entityRef="{actor}"/></Actors><Maneuver name="maneuver">{"".join(events)}</Maneuver>'
        f"</ManeuverGroup>{trigger(*conditions)}</Act></Story>"
    )


def scenario(
    entities: Mapping[str, str],
    starts: str,
    stories: str = "",
    stop: str = trigger(when_time(15), tag="StopTrigger"),
    parameters: Mapping[str, object] | None = None,
    declarations: str = "",
) -> bytes:
    """A whole file."""
    declared = "".join(
        f'<ParameterDeclaration name="{name}" parameterType="double" value="{value}"/>'
        for name, value in (parameters or {}).items()
    )
    objects = "".join(f'<ScenarioObject name="{name}">{content}</ScenarioObject>' for name, content in entities.items())
    return f"""<?xml version="1.0"?>
<OpenSCENARIO>
<FileHeader revMajor="1" revMinor="1" date="2026-01-01T00:00:00" description="" author=""/>
<ParameterDeclarations>{declared}{declarations}</ParameterDeclarations>
<RoadNetwork><LogicFile filepath="../maps/motorway.xodr"/></RoadNetwork>
<Entities>{objects}</Entities>
<Storyboard>
<Init><Actions>{starts}</Actions></Init>
{stories}
{stop}
</Storyboard>
</OpenSCENARIO>
""".encode()


HEADWAY = '<TimeHeadwayCondition entityRef="Other" value="0.8" freespace="false" rule="greaterThan" relativeDistanceType="longitudinal"/>'
NEAR = '<RelativeDistanceCondition entityRef="Other" value="$gap" freespace="true" rule="lessThan" relativeDistanceType="longitudinal"/>'
BESIDE = '<RelativeTargetLane entityRef="Ego" value="0"/>'
BRAKE = f"<LongitudinalAction>{change_of_speed(absolute(15), 'linear', 'rate', -4)}</LongitudinalAction>"


def cut_in() -> bytes:
    """Another car overtakes, changes into the ego vehicle's lane when it is ahead, and brakes afterwards."""
    starts = start("Ego", lane(-3, 150), absolute(30)) + start("Other", lane(-2, "$s"), absolute("${$ego_speed + 6}"))
    done = (
        '<Condition name="d" delay="1" conditionEdge="rising"><ByValueCondition><StoryboardElementStateCondition '
        'storyboardElementType="action" storyboardElementRef="inAction" state="completeState"/></ByValueCondition></Condition>'
    )
    events = event("in", change_of_lane(BESIDE), when("Ego", HEADWAY)), event("brake", BRAKE, done)
    return scenario(
        {"Ego": vehicle(), "Other": vehicle(4.2, 1.3)},
        starts,
        act("Other", *events, conditions=(when_time(0),)),
        parameters={"ego_speed": 30, "s": 120},
    )


def slower_cut_in() -> bytes:
    """A slower car ahead cuts in when the ego vehicle is near: `gap` is a parameter of the file."""
    other = '<Position><RelativeLanePosition entityRef="Ego" dLane="1" ds="${3 * $gap}"/></Position>'
    relative = '<RelativeTargetSpeed entityRef="Ego" value="-8" speedTargetValueType="delta" continuous="false"/>'
    starts = start("Ego", lane(-3, 50), absolute(30)) + start("Other", other, relative)
    stories = act("Other", event("in", change_of_lane(BESIDE, 2, "rate"), when("Ego", NEAR)))
    return scenario({"Ego": vehicle(), "Other": vehicle()}, starts, stories, parameters={"gap": 25})


def cut_out() -> bytes:
    """The leader leaves the lane before an obstacle."""
    box = (
        f'<MiscObject name="box" miscObjectCategory="obstacle" mass="1">{BOX.format(centre=0, length=2, width=1)}</MiscObject>'
    )
    out = change_of_lane('<RelativeTargetLane entityRef="Other" value="1"/>', 60, "distance")
    reach = f'<ReachPositionCondition tolerance="1">{lane(-3, 300)}</ReachPositionCondition>'
    starts = (
        start("Ego", lane(-3, 50), absolute(25))
        + start("Other", lane(-3, 120), absolute(25))
        + start("Box", lane(-3, 400), absolute(0))
    )
    return scenario(
        {"Ego": vehicle(), "Other": vehicle(), "Box": box},
        starts,
        act("Other", event("out", out, when("Other", reach, "none"))),
    )


def walks_across() -> bytes:
    """A pedestrian walks across the road so as to meet the ego vehicle, in front of a parked car and an oncoming one."""
    person = f'<Pedestrian name="p" mass="1" pedestrianCategory="pedestrian">{BOX.format(centre=0, length=0.6, width=0.5)}</Pedestrian>'
    vertices = "".join(f"<Vertex>{lane(-3, 300, offset)}</Vertex>" for offset in ("${-$reach}", "$reach"))
    way = f'<TrajectoryRef><Trajectory name="w" closed="false"><Shape><Polyline>{vertices}</Polyline></Shape></Trajectory></TrajectoryRef>'
    follow = f"<FollowTrajectoryAction><TimeReference><None/></TimeReference>{way}</FollowTrajectoryAction>"
    final = '<FinalSpeed><AbsoluteSpeed value="1.4"><TargetDistanceSteadyState distance="3"/></AbsoluteSpeed></FinalSpeed>'
    meet = (
        '<SynchronizeAction masterEntityRef="Ego"><TargetPositionMaster><LanePosition roadId="7" laneId="-3" s="296"/>'
        f'</TargetPositionMaster><TargetPosition><TrajectoryPosition s="$reach">{way}</TrajectoryPosition></TargetPosition>{final}'
        "</SynchronizeAction>"
    )
    turned = '<Position><LanePosition roadId="7" laneId="-2" s="500"><Orientation type="relative" h="${pi}"/></LanePosition></Position>'
    parked = '<Position><RelativeObjectPosition entityRef="Ego" dx="${round(100.4)}" dy="-4"/></Position>'
    starts = (
        start("Ego", lane(-3, 150), absolute(20))
        + f'<Private entityRef="Other"><PrivateAction><RoutingAction>{follow}</RoutingAction></PrivateAction></Private>'
        + start("Oncoming", turned, absolute(15))
        + f'<Private entityRef="Parked"><PrivateAction><TeleportAction>{parked}</TeleportAction></PrivateAction></Private>'
    )
    entities = {"Ego": vehicle(), "Other": person, "Oncoming": vehicle(), "Parked": vehicle()}
    return scenario(entities, starts, act("Other", event("meet", meet, when_time(0))), parameters={"reach": 6})


FILES = {"cut_in": cut_in, "slower_cut_in": slower_cut_in, "cut_out": cut_out, "walks_across": walks_across}
ROUTES = b"""<routes>
<vType id="car" carFollowModel="IDM" laneChangeModel="LC2013" length="4.5" maxSpeed="35" tau="1.2" speedFactor="normc(1,0.1,0.2,2)"
  lcAssertive="2" color="red"/>
<vType id="lorry" vClass="truck" speedDev="0.02" sigma="0.3"/>
<route id="through" edges="before beside after"/>
<vehicle id="a.1" type="car" route="through" depart="0" departLane="1" departPos="150" departSpeed="28"/>
<vehicle id="late" type="lorry" depart="4.5" departLane="best" departSpeed="max"><route edges="before beside after"/></vehicle>
<trip id="joins" type="car" from="ramp" to="after" depart="0:00:01" departSpeed="20"/>
<flow id="stream" type="car" route="through" begin="0" end="60" vehsPerHour="600" departLane="free" departSpeed="desired"/>
<flow id="others" route="through" begin="2" period="exp(0.2)" departLane="0" departSpeed="25" arrivalPos="max"/>
<vehicle id="never" route="through" depart="900"/>
<person id="p" depart="0"><walk edges="before"/></person>
</routes>
"""


def write_files(folder: Path) -> None:
    """Adds the files to a bundle, and the networks that they are about: `merge` and the converted motorway."""
    for name in ("maps", "scenarios"):
        (folder / name).mkdir()
    (folder / "maps" / "motorway.xodr").write_bytes(motorway())
    (folder / "maps" / "motorway.xodr.net.xml").write_bytes(converted(motorway(), "motorway.xodr").network)
    for name, make in FILES.items():
        (folder / "scenarios" / f"{name}.xosc").write_bytes(make())
    (folder / "merge.net.xml").write_bytes(entrance())
    (folder / "merge.rou.xml").write_bytes(ROUTES)


@cache
def maps() -> dict[str, Map]:
    """The networks of the tests."""
    road = motorway()
    network = read_network(converted(road, "motorway.xodr").network, "maps/motorway.xodr")
    return {
        "maps/motorway.xodr": Map(network, lambda: read_opendrive(road, "maps/motorway.xodr")),
        "road.net.xml": Map(read_network(entrance(), "road.net.xml"), None),
    }


def description(files: Mapping[str, bytes], **data: Any) -> Description:
    """The description of a scenario with these files."""
    bundle = {name: BundleFile(content, executable=False) for name, content in files.items()}
    return described(declared_scenario(data), files_read(bundle), maps().__getitem__, STEP)


def of_file(content: bytes, files: Mapping[str, bytes] | None = None, **data: Any) -> Description:
    """The description of an OpenSCENARIO file."""
    bundle = {"scenarios/a.xosc": content, "maps/motorway.xodr": b""} | dict(files or {})
    return description(bundle, openscenario="scenarios/a.xosc", **data)


def with_routes(content: bytes, **data: Any) -> Description:
    """The description of a scenario of the merge with a route file."""
    base = {
        "network": "road.net.xml",
        "route": ["before", "beside", "after"],
        "duration": 20.0,
        "ego": {"lane": 0, "s": 100.0, "speed": 28.0},
        "routes": "a.rou.xml",
    }
    return description({"a.rou.xml": content}, **(base | data))


def refused(content: bytes, **data: Any) -> str:
    """The refusal of an OpenSCENARIO file."""
    with pytest.raises(InvalidInputError) as error:
        of_file(content, **data)
    assert all(problem.field and problem.message and problem.remedy for problem in error.value.problems)
    return str(error.value)


EGO = start("Ego", lane(-3, 150), absolute(30))
OTHER = start("Other", lane(-2, 200), absolute(25))
WORLD = '<Position><WorldPosition x="{}" y="{}" h="0.2"/></Position>'
CARS = {"Ego": vehicle(), "Other": vehicle()}
IN = change_of_lane(BESIDE)


def with_events(*events: str, other: str = OTHER, stop: str = trigger(when_time(10), tag="StopTrigger")) -> bytes:
    """Returns a file with actions of another car."""
    return scenario(CARS, EGO + other, act("Other", *events), stop)


def when_all(edge: str) -> str:
    """A condition that all vehicles fulfil."""
    speed = '<SpeedCondition value="3" rule="greaterThan"/>'
    several = when("Ego", speed, edge).replace('Rule="any">', 'Rule="all"><EntityRef entityRef="Other"/>')
    assert several.count("<EntityRef") == 2
    return several
