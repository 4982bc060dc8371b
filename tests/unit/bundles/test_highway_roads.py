"""Scenarios of kind `highway` against their networks: every fault by its field, conversions in archives, and notes."""

import copy
import re
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
import yaml
from tests.support.changes import with_change
from tests.support.networks import crossing, entrance
from tests.support.opendrive_files import exit_ramp, two_way
from tests.support.values import faults_of, faulty_fields

from drivecal.bundles import highway_roads
from drivecal.bundles.archives import BundleFile, content_digest, files_of, with_files
from drivecal.bundles.checks import checked
from drivecal.bundles.highway_roads import check_roads, conversions
from drivecal.bundles.installed import installed_problems
from drivecal.bundles.traffic import description
from drivecal.configuration.problems import read_archived, read_bundle, read_bundle_with_notes
from drivecal.domain.errors import InvalidInputError, UnavailableError
from drivecal.roads.corridor import corridor
from drivecal.roads.network import read_network

CODE = "def control(observation, parameters):\n    return {'acceleration': 0.0}\n"
MANIFEST: dict[str, Any] = {
    "problem": "acc",
    "parameters": {"T": {"lower": 0.8, "upper": 2.5}},
    "simulator": {"kind": "highway", "controller": {"kind": "python", "file": "acc.py", "output": ["acceleration"]}},
    "scenarios": {
        "merge": {
            "network": "road.net.xml",
            "route": ["before", "beside", "after"],
            "duration": 20,
            "ego": {"lane": 0, "s": 100, "speed": 28},
            "traffic": [
                {"s": 160, "lane": 1, "speed": 25},
                {"edge": "ramp", "route": ["ramp", "beside", "after"], "s": 40, "speed": 20},
            ],
        }
    },
    "measures": {"min_ttc_s": "s"},
    "scores": {"safe": {"formula": "min_ttc_s", "direction": "maximise", "range": [0, 10]}},
}


@cache
def networks() -> dict[str, BundleFile]:
    content = {
        "road.net.xml": entrance(),
        "town.net.xml": crossing(),
        "damaged.net.xml": entrance()[:900],
        "acc.py": CODE.encode(),
    }
    return {name: BundleFile(text, executable=False) for name, text in content.items()}


def changed(path: str, value: Any) -> dict[str, Any]:
    return with_change(MANIFEST, f"scenarios/merge/{path.replace('.', '/')}", value)


def fields(document: dict[str, Any], files: dict[str, BundleFile] | None = None) -> list[str]:
    error = faults_of(check_roads, checked(document), networks() if files is None else files)
    assert all(problem.message and problem.remedy for problem in error)
    return [problem.field for problem in error]


def test_a_scenario_that_fits_its_network_passes() -> None:
    assert check_roads(checked(MANIFEST), networks()) == ()


@pytest.mark.parametrize(
    ("path", "value", "field"),
    [
        ("network", "damaged.net.xml", "network"),
        ("route", ["before", "besides", "after"], "route[1]"),
        ("route", ["before", "after"], "route[1]"),
        ("route", ["ramp", "beside", "beside"], "route[2]"),
        ("ego.lane", 2, "ego.lane"),
        ("ego.s", 5000.0, "ego.s"),
        ("ego.edge", "ramp", "ego.edge"),
        ("ego", {"edge": "beside", "lane": 0, "s": 900, "speed": 20}, "ego.s"),
        ("duration", 120.0, "route"),
        ("traffic.0.lane", 2, "traffic[0].lane"),
        ("traffic.0.s", 5000.0, "traffic[0].s"),
        ("traffic.1.edge", "ramps", "traffic[1].edge"),
        ("traffic.1.edge", "before", "traffic[1].edge"),
        ("traffic.1.lane", 1, "traffic[1].lane"),
        ("traffic.1.s", 5000.0, "traffic[1].s"),
        ("traffic.1.route", ["ramp", "after"], "traffic[1].route[1]"),
        ("traffic.0", {"s": 160, "speed": 25, "route": ["ramp", "beside"]}, "traffic[0].route"),
    ],
)
def test_what_does_not_fit_is_named(path: str, value: Any, field: str) -> None:
    assert fields(changed(path, value)) == [f"scenarios.merge.{field}"]


def test_crossings_on_the_route_are_named() -> None:
    document = changed("network", "town.net.xml")
    document["scenarios"]["merge"] |= {"route": ["west", "east"], "traffic": []}
    assert fields(document) == ["scenarios.merge.route[1]"]


def test_a_route_of_many_scenarios_is_checked_once(monkeypatch: pytest.MonkeyPatch) -> None:
    document = copy.deepcopy(MANIFEST)
    scenario = document["scenarios"]["merge"]
    others = changed("route", ["ramp", "beside", "after"])["scenarios"]["merge"] | {"traffic": []}
    document["scenarios"] = {f"s{number}": others if number % 2 else scenario for number in range(6)}
    counted = Mock(side_effect=corridor)
    monkeypatch.setattr(highway_roads, "corridor", counted)
    check_roads(checked(document), networks())
    assert counted.call_count == 2


def test_gaps_over_which_vehicles_jump_are_noted() -> None:
    files = networks() | {"road.net.xml": BundleFile(entrance("--no-internal-links"), executable=False)}
    document = changed("duration", 5)
    assert check_roads(checked(document), networks()) == ()
    (note,) = check_roads(checked(document), files)
    assert note.startswith("scenarios.merge: ")
    assert "8.2 m behind the edge before" in note


def test_a_folder_is_converted_and_measured_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    document = changed("duration", 50.0)
    (tmp_path / "problem.yaml").write_text(yaml.safe_dump(document))
    for name in ("road.net.xml", "acc.py"):
        (tmp_path / name).write_bytes(networks()[name].content)
    counted = Mock(side_effect=read_network)
    monkeypatch.setattr(description, "read_network", counted)
    _, _, notes = read_bundle_with_notes(tmp_path)
    assert len(notes) == 1
    assert [call.args[1] for call in counted.call_args_list] == ["road.net.xml"]


OPEN_ROUTE = ["-1#0", "-1#1", "-1#2", "-3"]


def folder(path: Path, road: bytes, **others: bytes) -> Path:
    """A folder with an OpenDRIVE file."""
    document = changed("network", "maps/road.xodr")
    document["scenarios"]["merge"] |= {"route": OPEN_ROUTE, "ego": {"lane": 2, "s": 50, "speed": 30}, "traffic": []}
    (path / "maps").mkdir(parents=True, exist_ok=True)
    (path / "problem.yaml").write_text(yaml.safe_dump(document))
    (path / "acc.py").write_text(CODE)
    (path / "maps" / "road.xodr").write_bytes(road)
    for name, content in others.items():
        (path / "maps" / name.replace("__", ".")).write_bytes(content)
    return path


def test_a_refusal_of_a_place_on_a_converted_road_comes_with_the_notes_that_may_explain_it(tmp_path: Path) -> None:
    turned = re.sub(rb'<lane id="(-\d+)" type="driving"', rb'<lane id="\1" type="driving" direction="reversed"', exit_ramp())
    problem = next(problem for problem in faults_of(read_bundle, folder(tmp_path, turned)) if ".route" in problem.field)
    assert 'direction="reversed"' in problem.remedy


def test_an_archive_holds_the_converted_network_and_the_folder_does_not(tmp_path: Path) -> None:
    path = folder(tmp_path, exit_ramp())
    manifest, archive = read_bundle(path)
    assert set(files_of(archive)) == {"problem.yaml", "acc.py", "maps/road.xodr", "maps/road.xodr.net.xml"}
    assert {file.name for file in (path / "maps").iterdir()} == {"road.xodr"}
    assert read_archived(files_of(archive))[0] == manifest
    assert content_digest(archive) == content_digest(read_bundle(path)[1])


def test_a_route_without_limits_needs_the_field_of_its_scenario_and_notes_name_the_file(tmp_path: Path) -> None:
    road = exit_ramp().replace(b"<speed ", b"<velocity ")
    path = folder(tmp_path, road)
    (problem,) = faults_of(read_bundle_with_notes, path)
    assert "scenarios.merge.default_limit" in problem.field
    assert "road 1, 3" in problem.message
    document = yaml.safe_load((path / "problem.yaml").read_text())
    document["scenarios"]["merge"]["default_limit"] = 30
    (path / "problem.yaml").write_text(yaml.safe_dump(document))
    _, _, notes = read_bundle_with_notes(path)
    assert any(note.startswith("maps/road.xodr: ") and "no speed limit" in note for note in notes)
    assert any(note.startswith("maps/road.xodr: ") and " x velocity: ignored" in note for note in notes)


def test_a_network_of_the_same_file_is_kept_without_netconvert(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = folder(tmp_path, exit_ramp())
    _, archive = read_bundle(path)
    (path / "maps" / "road.xodr.net.xml").write_bytes(files_of(archive)["maps/road.xodr.net.xml"].content)
    monkeypatch.setattr(highway_roads, "converted", Mock(side_effect=UnavailableError("netconvert is missing")))
    assert content_digest(read_bundle(path)[1]) == content_digest(archive)
    (path / "maps" / "road.xodr.net.xml").unlink()
    with pytest.raises(UnavailableError):
        read_bundle(path)


def test_a_network_of_another_file_is_refused(tmp_path: Path) -> None:
    path = folder(tmp_path, exit_ramp())
    _, archive = read_bundle(path)
    other = two_way()
    with pytest.raises(InvalidInputError) as pushed:
        read_archived(files_of(with_files(archive, {"maps/road.xodr": other})))
    (path / "maps" / "road.xodr.net.xml").write_bytes(entrance())
    with pytest.raises(InvalidInputError) as packed:
        read_bundle(path)
    for error in (pushed, packed):
        assert [problem.field.rpartition(": ")[2] for problem in error.value.problems] == ["scenarios.merge.network"]


def test_an_archive_without_the_converted_network_is_refused(tmp_path: Path) -> None:
    path = folder(tmp_path, exit_ramp())
    files = {name: file for name, file in files_of(read_bundle(path)[1]).items() if not name.endswith(".net.xml")}
    document = yaml.safe_load((path / "problem.yaml").read_text())
    assert fields(document, files) == ["scenarios.merge.network"]


def test_a_file_that_cannot_be_converted_is_named(tmp_path: Path) -> None:
    path = folder(tmp_path, exit_ramp().replace(b'revMajor="1"', b'revMajor="2"'))
    document = yaml.safe_load((path / "problem.yaml").read_text())
    files = {"maps/road.xodr": BundleFile((path / "maps" / "road.xodr").read_bytes(), executable=False)}
    (problem,) = faults_of(conversions, checked(document), files)
    assert problem.field == "scenarios.merge.network"
    assert "maps/road.xodr" in problem.message
    assert [problem.field.startswith("problem.yaml: line ") for problem in faults_of(read_bundle, tmp_path)] == [True]


@pytest.mark.parametrize("first", ["described", "corridor", "carriageway"])
def test_files_that_take_too_long_to_read_are_refused(first: str, monkeypatch: pytest.MonkeyPatch) -> None:
    document, files = changed("traffic", []), networks()
    document["scenarios"]["later"] = document["scenarios"]["merge"] | {"route": ["ramp", "beside", "after"]}
    if first == "carriageway":
        motorway = installed_problems()["highway"]
        document, files = motorway.manifest.model_dump(mode="json") | {"problem": "mine"}, files_of(motorway.archive)
    whole = getattr(highway_roads, first)

    def slow(*given: Any, **named: Any) -> Any:
        monkeypatch.setattr(highway_roads, "MOST_SECONDS", -1.0)
        return whole(*given, **named)

    monkeypatch.setattr(highway_roads, first, slow)
    assert faulty_fields(check_roads, checked(document), files) == ["scenarios"]
