"""Starts of OpenSCENARIO files: places, distances, speeds and entities; and when the drive ends."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from tests.support.networks import entrance
from tests.support.scenario_files import (
    CARS,
    EGO,
    OTHER,
    WORLD,
    absolute,
    cut_in,
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
    with_events,
)

from drivecal.bundles.traffic.elements import Notes, read_tree
from drivecal.bundles.traffic.entities import Files, entities_of
from drivecal.bundles.traffic.places import Map
from drivecal.domain.errors import InvalidInputError
from drivecal.roads.network import read_network


def test_a_distance_in_init_places_a_leader_by_its_time_gap() -> None:
    keep = (
        '<PrivateAction><LongitudinalAction><LongitudinalDistanceAction continuous="false" displacement="leadingReferencedEntity" '
        'timeGap="2" entityRef="Ego" freespace="true"/></LongitudinalAction></PrivateAction></Private>'
    )
    other = start("Other", lane(-3, 200), absolute(25)).replace("</Private>", keep)
    found = of_file(scenario(CARS, EGO + other)).scenario
    assert found.traffic[0].s - found.ego.s == pytest.approx(2 * 30 + 4.6, abs=1e-3)


@pytest.mark.parametrize("is_last", [False, True])
def test_a_follower_s_time_gap_is_that_at_its_start_speed_whichever_comes_first(is_last: bool) -> None:
    keep = (
        '<PrivateAction><LongitudinalAction><LongitudinalDistanceAction continuous="false" displacement="trailingReferencedEntity" '
        'timeGap="2" entityRef="Ego" freespace="true"/></LongitudinalAction></PrivateAction>'
    )
    other = start("Other", lane(-3, 200), absolute(25))
    other = (
        other.replace("</Private>", f"{keep}</Private>")
        if is_last
        else other.replace("<PrivateAction>", f"{keep}<PrivateAction>", 1)
    )
    found = of_file(scenario(CARS, EGO + other)).scenario
    assert found.ego.s - found.traffic[0].s == pytest.approx(2 * 25 + 4.6, abs=1e-3)


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
def test_a_distance_in_init_without_a_side_trails_or_keeps_the_side_of_the_place(
    minor: str, displacement: str, s: float, is_ahead: bool
) -> None:
    keep = (
        f'<PrivateAction><LongitudinalAction><LongitudinalDistanceAction continuous="false" {displacement} distance="30" '
        'entityRef="Ego" freespace="false"/></LongitudinalAction></PrivateAction></Private>'
    )
    other = start("Other", lane(-2, s), absolute(25)).replace("</Private>", keep)
    content = scenario(CARS, EGO + other).replace(b'revMinor="1"', f'revMinor="{minor}"'.encode())
    found = of_file(content).scenario
    assert found.traffic[0].s - found.ego.s == pytest.approx(30 if is_ahead else -30, abs=1e-3)


def test_an_entity_beside_one_at_a_distance_is_beside_the_place_that_this_has() -> None:
    keep = (
        '<PrivateAction><LongitudinalAction><LongitudinalDistanceAction continuous="false" displacement="leadingReferencedEntity" '
        'distance="80" entityRef="Ego" freespace="false"/></LongitudinalAction></PrivateAction></Private>'
    )
    other = start("Other", lane(-2, 160), absolute(25)).replace("</Private>", keep)
    beside = '<Position><RelativeLanePosition entityRef="Other" dLane="-1" ds="20"/></Position>'
    cars = CARS | {"Other": vehicle(9.0, 3.0), "Third": vehicle(4.6, 1.4)}
    placed = of_file(scenario(cars, EGO + other + start("Third", beside, absolute(20)))).scenario
    assert placed.traffic[0].s - placed.ego.s == pytest.approx(80, abs=1e-3)
    assert placed.traffic[1].s - placed.traffic[0].s == pytest.approx(20 - 3.0 + 1.4, abs=1e-3)
    assert placed.traffic[1].lane == placed.ego.lane


def test_a_place_of_the_other_direction_has_no_side() -> None:
    keep = (
        '<PrivateAction><LongitudinalAction><LongitudinalDistanceAction continuous="false" displacement="any" distance="30" '
        'entityRef="Ego" freespace="false"/></LongitudinalAction></PrivateAction></Private>'
    )
    other = start("Other", lane(2, 200), absolute(25)).replace("</Private>", keep)
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


def test_world_positions_of_a_converted_road_are_those_of_its_file() -> None:
    """Whatever the converted network says: its coordinates are the file's."""
    roads = maps()["maps/motorway.xodr"]
    moved = Map(replace(roads.network, offset=(500.0, 500.0)), lambda: pytest.fail("the file is not read"))
    x, y = 100 + 200 * np.cos(0.2) + 5.25 * np.sin(0.2), 50 + 200 * np.sin(0.2) - 5.25 * np.cos(0.2)
    position = read_tree(WORLD.format(x, y).encode(), "a.xosc", "Position")
    assert moved.place(position, {}, []) == roads.place(position, {}, [])


def test_a_vehicle_of_a_catalog_of_the_bundle_has_its_size() -> None:
    reference = '<CatalogReference catalogName="cars" entryName="long"/>'
    locations = (
        '<CatalogLocations><VehicleCatalog><Directory path="./catalogs"/></VehicleCatalog></CatalogLocations><RoadNetwork>'
    )
    content = scenario({"Ego": reference, "Other": vehicle()}, EGO + OTHER).replace(b"<RoadNetwork>", locations.encode())
    catalog = (
        f'<OpenSCENARIO><Catalog name="cars">{vehicle(9.5, category="van").replace("car", "long", 1)}</Catalog></OpenSCENARIO>'
    )
    assert of_file(content, {"scenarios/catalogs/c.xosc": catalog.encode()}).scenario.ego.length == 9.5
    assert "no entry" in refused(
        content.replace(b'entryName="long"', b'entryName="short"'), files={"scenarios/catalogs/c.xosc": catalog.encode()}
    )
    assert "no catalog" in refused(content)


def test_a_reference_gives_parameters_of_a_catalog_s_entry_other_values() -> None:
    assigned = '<ParameterAssignment parameterRef="{}" value="{}"/>'
    reference = '<CatalogReference catalogName="cars" entryName="long"><ParameterAssignments>{}</ParameterAssignments></CatalogReference>'
    locations = (
        '<CatalogLocations><VehicleCatalog><Directory path="./catalogs"/></VehicleCatalog></CatalogLocations><RoadNetwork>'
    )
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
        return scenario({"Ego": ego, "Other": vehicle()}, EGO + OTHER).replace(b"<RoadNetwork>", locations.encode())

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
    ],
)
def test_the_end_is_the_time_at_which_the_first_group_of_times_is_whole(
    groups: tuple[tuple[str, ...], ...], duration: float
) -> None:
    described = of_file(with_events(stop=stop(*groups)))
    assert described.scenario.duration == duration
    assert any("<ConditionGroup>: ignored" in note for note in described.notes) == (SLOW in groups[0] or duration == 30.0)


def test_an_end_that_not_only_a_time_decides_needs_a_duration() -> None:
    content = with_events(stop=stop((when_time(10), SLOW)))
    assert "duration" in refused(content)
    assert of_file(content, duration=8.0).scenario.duration == 8.0
