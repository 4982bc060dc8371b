"""OpenSCENARIO files that are refused, by line or field, and folders with such files."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from tests.support.scenario_files import (
    BOX,
    CARS,
    EGO,
    FILES,
    IN,
    NEAR,
    OTHER,
    WORLD,
    absolute,
    change_of_lane,
    cut_in,
    event,
    motorway,
    of_file,
    refused,
    scenario,
    start,
    when,
    when_all,
    when_time,
    with_events,
)

from drivecal.bundles.archives import files_of
from drivecal.client.problems import read_archived, read_bundle_with_notes
from drivecal.domain.errors import InvalidInputError

PEDESTRIAN = (
    f'<Pedestrian name="p" mass="1" pedestrianCategory="pedestrian">{BOX.format(centre=0, length=0.5, width=0.5)}</Pedestrian>'
)
ACTIVE = '<ControllerAction><ActivateControllerAction lateral="true" longitudinal="true"/></ControllerAction>'
ROUTING = b"<PrivateAction><RoutingAction/></PrivateAction>"
GROUPS = b"<StartTrigger><ConditionGroup/><ConditionGroup/></StartTrigger>"
LATERAL = NEAR.replace("$gap", "3").replace("longitudinal", "lateral")
SIDEWAYS = '<SpeedCondition value="1" rule="greaterThan" direction="lateral"/>'
KEPT = '<RelativeTargetSpeed entityRef="Ego" value="2" speedTargetValueType="delta" continuous="true"/>'
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
    "other lane": (with_events(event("in", change_of_lane('<RelativeTargetLane entityRef="Ego" value="5"/>'))), "lanes"),
    "several that rise": (with_events(event("in", IN, when_all("rising"))), "rising"),
    "many conditions": (with_events(event("in", IN, *[when_time(1)] * 21)), "more than 20"),
    "synchronised": (with_events(event("in", "<SynchronizeAction/>")), "SynchronizeAction"),
    "controller": (with_events(event("in", ACTIVE)), "controller"),
    "no such entity": (
        with_events(event("in", change_of_lane('<RelativeTargetLane entityRef="Nobody" value="1"/>'))),
        "Nobody",
    ),
    "two of a name": (scenario(CARS, EGO + OTHER).replace(b'name="Other"', b'name="Ego"'), "another entity"),
    "walks": (scenario(CARS | {"Other": PEDESTRIAN}, EGO + OTHER), "pedestrian"),
}


@pytest.mark.parametrize("case", CASES)
def test_what_is_needed_and_not_supported_is_refused_by_line(case: str) -> None:
    content, part = CASES[case]
    message = refused(content)
    assert part in message
    assert "scenarios/a.xosc: line " in message


def test_parameters_and_entities_that_the_file_lacks_are_fields_of_the_scenario() -> None:
    for data, field in (({"parameters": {"gap": 3}}, "parameters.gap"), ({"ego": "Hero"}, "ego")):
        with pytest.raises(InvalidInputError) as error:
            of_file(cut_in(), **data)
        assert [problem.field for problem in error.value.problems] == [field]


def test_values_outside_of_a_parameter_s_constraints_are_refused() -> None:
    bound = (
        '<ParameterDeclaration name="x" parameterType="double" value="5"><ConstraintGroup><ValueConstraint rule="greaterThan" value="0"/>'
        '<ValueConstraint rule="lessOrEqual" value="${2 * $limit}"/></ConstraintGroup></ParameterDeclaration>'
        '<ParameterDeclaration name="limit" parameterType="double" value="4"/>'
    )
    content = scenario(CARS, EGO + OTHER, declarations=bound)
    assert of_file(content, parameters={"x": 8}).scenario
    with pytest.raises(InvalidInputError) as error:
        of_file(content, parameters={"x": 8.5})
    assert [problem.field for problem in error.value.problems] == ["parameters.x"]


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
    assert read_archived(files_of(archive)) == manifest
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
def test_faults_of_a_folder_have_the_manifest_s_fields(
    content: bytes, data: dict[str, object], field: str, tmp_path: Path
) -> None:
    with pytest.raises(InvalidInputError) as error:
        read_bundle_with_notes(folder(tmp_path / "b", content, **data))
    assert [problem.field.rpartition(": ")[2] for problem in error.value.problems] == [f"scenarios.x.{field}"]
