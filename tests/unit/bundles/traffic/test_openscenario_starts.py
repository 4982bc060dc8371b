"""OpenSCENARIO files: starts, ends, and what is refused by line or field."""

import re
from pathlib import Path

import pytest
import yaml
from tests.support.networks import entrance
from tests.support.scenario_files import (
    CARS,
    EGO,
    FILES,
    IN,
    NEAR,
    OTHER,
    WORLD,
    absolute,
    act,
    change_of_lane,
    cut_in,
    event,
    lane,
    motorway,
    of_file,
    refused,
    scenario,
    start,
    trigger,
    vehicle,
    when,
    when_all,
    when_time,
    with_events,
)
from tests.support.values import faults_of, faulty_fields

from drivecal.bundles.archives import files_of
from drivecal.bundles.traffic.elements import Notes, read_tree, substituted
from drivecal.bundles.traffic.entities import Files, entities_of
from drivecal.bundles.traffic.places import Map
from drivecal.configuration.problems import read_archived, read_bundle_with_notes
from drivecal.domain.errors import InvalidInputError
from drivecal.roads.network import read_network

DISTANCE = '<LongitudinalDistanceAction continuous="false" entityRef="Ego" {}/>'
KEEP = f"<PrivateAction><LongitudinalAction>{DISTANCE}</LongitudinalAction></PrivateAction>"


@pytest.mark.parametrize(
    ("side", "is_last", "ahead"),
    [("leading", True, 2 * 30 + 4.6), ("trailing", True, -(2 * 25 + 4.6)), ("trailing", False, -(2 * 25 + 4.6))],
)
def test_a_time_gap_in_init_is_the_follower_s_at_its_start_speed_whichever_comes_first(
    side: str, is_last: bool, ahead: float
) -> None:
    keep = KEEP.format(f'displacement="{side}ReferencedEntity" timeGap="2" freespace="true"')
    end = "</Private>" if is_last else "<PrivateAction>"
    other = start("Other", lane(-3, 200), absolute(25)).replace(end, keep + end, 1)
    result = of_file(scenario(CARS, EGO + other)).scenario
    assert result.traffic[0].s - result.ego.s == pytest.approx(ahead, abs=1e-3)


@pytest.mark.parametrize(
    ("minor", "displacement", "s", "is_ahead"),
    [
        ("1", "", 200, False),
        ("0", "", 200, True),
        ("0", "", 100, False),
        ("3", 'displacement="any"', 200, True),
        ("3", 'displacement="any"', 100, False),
        ("0", 'displacement="leadingReferencedEntity"', 100, True),
    ],
)
def test_a_distance_in_init_without_a_side_keeps_the_places(minor: str, displacement: str, s: float, is_ahead: bool) -> None:
    keep = KEEP.format(f'{displacement} distance="30" freespace="false"')
    other = start("Other", lane(-2, s), absolute(25)).replace("</Private>", f"{keep}</Private>")
    content = scenario(CARS, EGO + other).replace(b'revMinor="1"', f'revMinor="{minor}"'.encode())
    result = of_file(content).scenario
    assert result.traffic[0].s - result.ego.s == pytest.approx(30 if is_ahead else -30, abs=1e-3)


def test_an_entity_beside_one_at_a_distance_is_beside_the_place_that_this_has() -> None:
    keep = KEEP.format('displacement="leadingReferencedEntity" distance="80" freespace="false"')
    other = start("Other", lane(-2, 160), absolute(25)).replace("</Private>", f"{keep}</Private>")
    beside = '<Position><RelativeLanePosition entityRef="Other" dLane="-1" ds="20"/></Position>'
    cars = CARS | {"Other": vehicle(9.0, 3.0), "Third": vehicle(4.6, 1.4)}
    placed = of_file(scenario(cars, EGO + other + start("Third", beside, absolute(20)))).scenario
    assert placed.traffic[0].s - placed.ego.s == pytest.approx(80, abs=1e-3)
    assert placed.traffic[1].s - placed.traffic[0].s == pytest.approx(20 - 3.0 + 1.4, abs=1e-3)
    assert placed.traffic[1].lane == placed.ego.lane


def test_a_place_of_the_other_direction_has_no_side() -> None:
    keep = KEEP.format('displacement="any" distance="30" freespace="false"')
    other = start("Other", lane(2, 200), absolute(25)).replace("</Private>", f"{keep}</Private>")
    assert "neither ahead" in refused(scenario(CARS, EGO + other))


@pytest.mark.parametrize(("shape", "value", "noted"), [("step", 3, False), ("linear", 0, False), ("linear", 3, True)])
def test_a_start_speed_that_would_be_reached_later_is_noted(shape: str, value: float, noted: bool) -> None:
    other = OTHER.replace('Shape="step"', f'Shape="{shape}"').replace(
        'Dimension="time" value="0"', f'Dimension="time" value="{value}"'
    )
    described = of_file(scenario(CARS, EGO + other))
    assert described.scenario.traffic[0].speed == 25.0
    assert any("<SpeedActionDynamics>" in note for note in described.notes) == noted


@pytest.mark.parametrize("moved", [(0.0, 0.0), (1234.5, -60.0)])
def test_world_positions_are_those_before_the_network_was_moved(moved: tuple[float, float]) -> None:
    network = re.sub(rb"<location [^>]*>", b"", entrance())
    offset = f'<location netOffset="{moved[0]},{moved[1]}" convBoundary="0,0,1,1" origBoundary="0,0,1,1" projParameter="!"/>'
    at = network.index(b"<edge ")
    roads = Map(read_network(network[:at] + offset.encode() + network[at:], "road.net.xml"), None)
    line = roads.network.edges["before"].lanes[0].shape
    x, y = (0.5 * (line[0] + line[1]) - moved).tolist()
    position = read_tree(f'<Position><WorldPosition x="{x}" y="{y}"/></Position>'.encode(), "a.xosc", "Position")
    place = roads.place(position, {}, [])
    assert (place.edge, place.index) == ("before", 0)
    assert place.offset == pytest.approx(0.0, abs=1e-6)


LOCATIONS = b'<CatalogLocations><VehicleCatalog><Directory path="./catalogs"/></VehicleCatalog></CatalogLocations>'


def test_a_vehicle_of_a_catalog_of_the_bundle_has_its_size() -> None:
    reference = '<CatalogReference catalogName="cars" entryName="long"/>'
    content = scenario({"Ego": reference, "Other": vehicle()}, EGO + OTHER).replace(
        b"<RoadNetwork>", LOCATIONS + b"<RoadNetwork>"
    )
    catalog = (
        f'<OpenSCENARIO><Catalog name="cars">{vehicle(9.5, category="van").replace("car", "long", 1)}</Catalog></OpenSCENARIO>'
    )
    assert of_file(content, {"scenarios/catalogs/c.xosc": catalog.encode()}).scenario.ego.length == 9.5
    assert "no entry" in refused(
        content.replace(b'entryName="long"', b'entryName="short"'), files={"scenarios/catalogs/c.xosc": catalog.encode()}
    )
    assert "no catalog" in refused(content)
    twice = catalog.replace("</Catalog>", f"\n{vehicle().replace('car', 'long', 1)}</Catalog>").encode()
    assert "line 2, <Vehicle>: the name long stands in line 1, too" in refused(
        content, files={"scenarios/catalogs/c.xosc": twice}
    )


def test_a_box_beside_its_place_is_noted_as_driven_on_it() -> None:
    content = scenario(CARS | {"Other": vehicle().replace('y="0"', 'y="0.5"')}, EGO + OTHER)
    assert [note for note in of_file(content).notes if "<Center>: y of Other is ignored" in note]


def test_a_reference_gives_parameters_of_a_catalog_s_entry_other_values() -> None:
    assigned = '<ParameterAssignment parameterRef="{}" value="{}"/>'
    reference = '<CatalogReference catalogName="cars" entryName="long"><ParameterAssignments>{}</ParameterAssignments></CatalogReference>'
    declared = (
        '<ParameterDeclarations><ParameterDeclaration name="length" parameterType="double" value="5"><ConstraintGroup>'
        '<ValueConstraint rule="lessThan" value="15"/></ConstraintGroup></ParameterDeclaration></ParameterDeclarations>'
    )
    car = vehicle().replace('name="car"', 'name="long"').replace('length="4.6"', 'length="$length"')
    car = car.replace("<BoundingBox>", f"{declared}<BoundingBox>")
    catalog = f'<OpenSCENARIO><Catalog name="cars">{car}</Catalog></OpenSCENARIO>'
    files = {"scenarios/catalogs/c.xosc": catalog.encode()}

    def content(*values: str) -> bytes:
        ego = reference.format("".join(values))
        return scenario({"Ego": ego, "Other": vehicle()}, EGO + OTHER).replace(b"<RoadNetwork>", LOCATIONS + b"<RoadNetwork>")

    assert of_file(content(), files).scenario.ego.length == 5.0
    assert of_file(content(assigned.format("length", 12.5)), files).scenario.ego.length == 12.5
    assert "width" in refused(content(assigned.format("width", 2)), files=files)
    assert "constraints" in refused(content(assigned.format("length", 20)), files=files)


def test_a_catalog_is_read_once_however_many_refer_to_it() -> None:
    car = vehicle().replace('name="car"', 'name="long"')
    content = {
        f"c/{name}.xosc": f'<OpenSCENARIO><Catalog name="{name}">{car}</Catalog></OpenSCENARIO>'.encode() for name in "abcd"
    }
    read: list[str] = []

    def contents(name: str) -> bytes:
        read.append(name)
        return content[name]

    files = Files(frozenset(content), contents)
    reference = '<ScenarioObject name="v{}"><CatalogReference catalogName="{}" entryName="long"/></ScenarioObject>'
    locations = '<CatalogLocations><VehicleCatalog><Directory path="c"/></VehicleCatalog></CatalogLocations>'
    entities = "".join(reference.format(number, "bd"[number % 2]) for number in range(50))
    root = read_tree(f"<a>{locations}<Entities>{entities}</Entities></a>".encode(), "s.xosc", "a")
    assert list(entities_of(root, files, Notes("s.xosc"))) == [f"v{number}" for number in range(50)]
    assert read == [f"c/{name}.xosc" for name in "abcd"]
    entities_of(root, files, Notes("s.xosc"))  # of another scenario
    assert read[4:] == ["c/b.xosc", "c/d.xosc"]
    twice = locations.replace("</CatalogLocations>", "") + locations.removeprefix("<CatalogLocations>")
    with pytest.raises(InvalidInputError, match="several"):
        entities_of(read_tree(f"<a>{twice}<Entities>{entities}</Entities></a>".encode(), "s.xosc", "a"), files, Notes("s.xosc"))


def test_a_catalog_beside_a_scenario_at_the_top_of_the_bundle_is_found_and_vehicles_have_parameters_of_their_own() -> None:
    declared = (
        '<ParameterDeclarations><ParameterDeclaration name="l" parameterType="double" value="7"/></ParameterDeclarations>'
    )
    own = re.sub('length="[^"]*"', 'length="$l"', vehicle().replace(">", f">{declared}", 1))
    catalog = f'<OpenSCENARIO><Catalog name="c">{own}</Catalog></OpenSCENARIO>'.encode()
    files = Files(frozenset(["c.xosc"]), {"c.xosc": catalog}.__getitem__)
    locations = '<CatalogLocations><VehicleCatalog><Directory path="."/></VehicleCatalog></CatalogLocations>'
    reference = '<CatalogReference catalogName="c" entryName="car"/>'
    both = "".join(f'<ScenarioObject name="{key}">{of}</ScenarioObject>' for key, of in (("a", reference), ("b", own)))
    root = read_tree(f"<a>{locations}<Entities>{both}</Entities></a>".encode(), "s.xosc", "a", substituted)
    assert [each.length for each in entities_of(root, files, Notes("s.xosc")).values()] == [7.0, 7.0]


def test_a_duration_of_the_scenario_replaces_that_of_the_file() -> None:
    assert of_file(cut_in(), duration=8.0).scenario.duration == 8.0
    never = trigger(when("Other", '<SpeedCondition value="1" rule="lessThan"/>'), tag="StopTrigger")
    assert "duration" in refused(with_events(stop=never))


def stop(*groups: tuple[str, ...]) -> str:
    """A <StopTrigger> of several groups."""
    inner = [f"<ConditionGroup>{''.join(group)}</ConditionGroup>" for group in groups]
    return f"<StopTrigger>{''.join(inner)}</StopTrigger>"


SLOW = when("Other", '<SpeedCondition value="1" rule="lessThan"/>')


@pytest.mark.parametrize(
    ("groups", "duration"),
    [
        (((when_time(10), when_time(20)),), 20.0),
        (((when_time(10, delay=4),), (when_time(12),)), 12.0),
        (((when_time(10), SLOW), (when_time(20), when_time(15))), 20.0),
        (((when_time(10), when_time(5, "lessThan")), (when_time(30),)), 30.0),
        (((when_time(1e6),), (when_time(20),), (when_time(4, delay="INF"),)), 20.0),
    ],
)
def test_the_end_is_when_the_first_group_of_times_is_whole(groups: tuple[tuple[str, ...], ...], duration: float) -> None:
    described = of_file(with_events(stop=stop(*groups)))
    assert described.scenario.duration == duration
    assert any("<ConditionGroup>: ignored" in note for note in described.notes) == (SLOW in groups[0] or duration == 30.0)


@pytest.mark.parametrize("group", [(when_time(10), SLOW), (when_time(1e6),), (when_time(10, delay=3600),)])
def test_an_end_that_no_time_up_to_an_hour_decides_needs_a_duration(group: tuple[str, ...]) -> None:
    content = with_events(stop=stop(group))
    assert "duration" in refused(content)
    assert of_file(content, duration=8.0).scenario.duration == 8.0


LATE = ((when_time(10, delay=5),), (when_time(20),))


@pytest.mark.parametrize(("actor", "groups", "noted"), [("Other", (), False), ("Other", LATE, True), ("Ego", ((SLOW,),), True)])
def test_an_act_may_stop_late_or_without_actions(actor: str, groups: tuple[tuple[str, ...], ...], noted: bool) -> None:
    story = act(actor, event("in", IN)).replace("</Act>", f"{stop(*groups)}</Act>")
    notes = of_file(scenario(CARS, EGO + OTHER, story)).notes
    assert any("<ConditionGroup>" in note for note in notes) is noted
    assert not any("<StopTrigger>" in note for note in notes)


ACTIVE = '<ControllerAction><ActivateControllerAction lateral="true" longitudinal="true"/></ControllerAction>'
ROUTING = b"<PrivateAction><RoutingAction/></PrivateAction>"
GROUPS = b"<StartTrigger><ConditionGroup/><ConditionGroup/></StartTrigger>"
LATERAL = NEAR.replace("$gap", "3").replace("longitudinal", "lateral")
SIDEWAYS = '<SpeedCondition value="1" rule="greaterThan" direction="lateral"/>'
KEPT = '<RelativeTargetSpeed entityRef="Ego" value="2" speedTargetValueType="delta" continuous="true"/>'
STOPS = [f"{stop((condition,))}</Act>".encode() for condition in (when_time(9.9), SLOW)]
CASES = {
    "version": (cut_in().replace(b'revMajor="1"', b'revMajor="2"'), "line 3, <FileHeader>"),
    "no road": (cut_in().replace(b'"../maps/motorway.xodr"', b'"../../motorway.xodr"'), "leaves the folder"),
    "unknown road": (cut_in().replace(b'roadId="7" laneId="-2"', b'roadId="8" laneId="-2"'), "no road 8"),
    "unknown lane": (cut_in().replace(b'laneId="-2"', b'laneId="-9"'), "no lane -9"),
    "shoulder": (cut_in().replace(b'laneId="-2"', b'laneId="-4"'), "shoulder"),
    "beyond the road": (cut_in().replace(b'value="120"', b'value="2500"'), "2500"),
    "unknown parameter": (cut_in().replace(b'"$s"', b'"$t"'), "no parameter t"),
    "no expression": (cut_in().replace(b"+ 6}", b"+ }"), "AbsoluteTargetSpeed"),
    "division by zero": (cut_in().replace(b"+ 6}", b"/ 0}"), "AbsoluteTargetSpeed"),
    "routes": (cut_in().replace(b"</Private>", ROUTING + b"</Private>", 1), "RoutingAction"),
    "world outside": (with_events(other=start("Other", WORLD.format(0, 999), absolute(1))), "no lane at"),
    "alternatives": (with_events(event("in", IN)).replace(b"<StartTrigger/>", GROUPS, 1), "alternatives"),
    "falling": (with_events(event("in", IN, when_time(1, edge="falling"))), "falling"),
    "sideways": (with_events(event("in", IN, when("Other", SIDEWAYS, "none"))), "direction is 'lateral'"),
    "kept speed": (with_events(other=OTHER.replace(absolute(25), KEPT)), "line 8, <SpeedAction>: a start speed that is kept"),
    "lateral": (with_events(event("in", IN, when("Ego", LATERAL))), "lateral"),
    "oncoming lane": (with_events(event("in", change_of_lane('<AbsoluteTargetLane value="1"/>'))), "direction"),
    "towards the oncoming lanes": (
        with_events(event("in", change_of_lane('<RelativeTargetLane entityRef="Other" value="3"/>'))),
        "other direction",
    ),
    "other lane": (with_events(event("in", change_of_lane('<RelativeTargetLane entityRef="Ego" value="5"/>'))), "lanes"),
    "several that rise": (with_events(event("in", IN, when_all("rising"))), "rising"),
    "act that stops": (with_events(event("in", IN)).replace(b"</Act>", STOPS[0]), "<ConditionGroup>"),
    "act that may stop": (with_events(event("in", IN)).replace(b"</Act>", STOPS[1]), "<ConditionGroup>"),
    "values": (b'<OpenSCENARIO><FileHeader revMajor="1"/><ParameterValueDistribution/></OpenSCENARIO>', "1, <ParameterValueD"),
    "many conditions": (with_events(event("in", IN, *[when_time(1)] * 21)), "more than 20"),
    "synchronised": (with_events(event("in", "<SynchronizeAction/>")), "SynchronizeAction"),
    "controller": (with_events(event("in", ACTIVE)), "controller"),
    "no such entity": (
        with_events(event("in", change_of_lane('<RelativeTargetLane entityRef="Nobody" value="1"/>'))),
        "Nobody",
    ),
    "two of a name": (scenario(CARS, EGO + OTHER).replace(b'name="Other"', b'name="Ego"'), "another entity"),
}


def test_a_catalog_takes_values_for_parameters_with_and_without_a_dollar_sign() -> None:
    declared = (
        '<ParameterDeclarations><ParameterDeclaration name="Long" parameterType="double" value="4"/>'
        '<ParameterDeclaration name="TrailerRef" parameterType="string" value=""/></ParameterDeclarations>'
    )
    towing = '<Trailer><TrailerRef entityRef="$TrailerRef"/></Trailer>'
    car = vehicle().replace('length="4.6"', 'length="$Long"').replace("<BoundingBox>", f"{declared}{towing}<BoundingBox>")
    catalog = f'<OpenSCENARIO><FileHeader revMajor="1" revMinor="2"/><Catalog name="cars">{car}</Catalog></OpenSCENARIO>'
    for sign in ("", "$"):
        given = "".join(
            f'<ParameterAssignment parameterRef="{sign}{name}" value="{value}"/>'
            for name, value in (("Long", 7), ("TrailerRef", "T"))
        )
        assigned = f"<ParameterAssignments>{given}</ParameterAssignments>"
        reference = f'<CatalogReference catalogName="cars" entryName="car">{assigned}</CatalogReference>'
        content = scenario(CARS | {"Other": reference}, EGO + OTHER).replace(b"<RoadNetwork>", LOCATIONS + b"<RoadNetwork>")
        description = of_file(content, {"scenarios/catalogs/c.xosc": catalog.encode()})
        assert description.scenario.traffic[0].length == 7.0
        assert [note for note in description.notes if "without its trailer" in note]


def test_an_obstacle_may_stand_far_beside_its_lane() -> None:
    beside = start("Other", lane(-3, 400, -5.25), absolute(0))
    (other,) = of_file(scenario(CARS, EGO + beside)).scenario.traffic
    assert other.offset == pytest.approx(-5.25)


@pytest.mark.parametrize("case", CASES)
def test_what_is_needed_and_not_supported_is_refused_by_line(case: str) -> None:
    content, part = CASES[case]
    message = refused(content)
    assert part in message
    assert "scenarios/a.xosc: line " in message


def test_parameters_and_entities_that_the_file_lacks_are_fields_of_the_scenario() -> None:
    for data, field in (({"parameters": {"gap": 3}}, "parameters.gap"), ({"ego": "Hero"}, "ego")):
        assert faulty_fields(of_file, cut_in(), **data) == [field]


def test_values_outside_of_a_parameter_s_constraints_are_refused() -> None:
    bound = (
        '<ParameterDeclaration name="x" parameterType="double" value="5"><ConstraintGroup><ValueConstraint rule="greaterThan" value="0"/>'
        '<ValueConstraint rule="lessOrEqual" value="${2 * $limit}"/></ConstraintGroup></ParameterDeclaration>'
        '<ParameterDeclaration name="limit" parameterType="double" value="4"/>'
    )
    content = scenario(CARS, EGO + OTHER, declarations=bound)
    assert of_file(content, parameters={"x": 8}).scenario
    assert "the name limit stands in line 4, too" in refused(content.replace(b'name="x"', b'name="limit"'))
    assert faulty_fields(of_file, content, parameters={"x": 8.5}) == ["parameters.x"]


def folder(path: Path, content: bytes, **data: object) -> Path:
    """A bundle with an OpenSCENARIO file in one folder and its road in another."""
    for name in ("scenarios", "maps"):
        (path / name).mkdir(parents=True)
    document = {
        "problem": "acc",
        "parameters": {"T": {"lower": 0.8, "upper": 2.5}},
        "simulator": {"kind": "highway", "controller": {"kind": "python", "file": "acc.py", "output": ["acceleration"]}},
        "scenarios": {"x": {"openscenario": "scenarios/a.xosc"} | data},
        "measures": {"min_ttc_s": "s"},
        "scores": {"safe": {"formula": "min_ttc_s", "direction": "maximise", "range": [0, 10]}},
    }
    (path / "problem.yaml").write_text(yaml.safe_dump(document))
    (path / "acc.py").write_text("def control(observation, parameters):\n    return 0.0\n")
    (path / "scenarios" / "a.xosc").write_bytes(content)
    (path / "maps" / "motorway.xodr").write_bytes(motorway())
    return path


@pytest.mark.parametrize("name", FILES)
def test_a_folder_with_a_file_and_its_road_is_packed_and_checked_again_in_the_archive(name: str, tmp_path: Path) -> None:
    manifest, archive, notes = read_bundle_with_notes(folder(tmp_path / "b", FILES[name]()))
    assert read_archived(files_of(archive))[0] == manifest
    assert any("the route is" in note for note in notes)


@pytest.mark.parametrize(
    ("content", "data", "field"),
    [
        (cut_in().replace(b'laneId="-2"', b'laneId="-9"'), {}, "openscenario"),
        (cut_in().replace(b"../maps", b"../map"), {}, "openscenario"),
        (cut_in(), {"network": "maps/none.xodr"}, "network"),
        (cut_in(), {"route": ["7"]}, "ego.edge"),
        (cut_in(), {"duration": 200.0}, "route"),
        (cut_in(), {"openscenario": "scenarios/b.xosc"}, "openscenario"),
        (cut_in().replace(b'value="3"', b'value="900"'), {}, "openscenario"),
    ],
)
def test_faults_of_a_folder_name_manifest_fields(content: bytes, data: dict[str, object], field: str, tmp_path: Path) -> None:
    assert [
        problem.field.rpartition(": ")[2]
        for problem in faults_of(read_bundle_with_notes, folder(tmp_path / "b", content, **data))
    ] == [f"scenarios.x.{field}"]
