"""The built-in catalogue and its networks."""

import subprocess
import sys
from dataclasses import replace

import pytest
import yaml
from tests.support.changes import with_change
from tests.support.values import faulty_fields

from drivecal.bundles.archives import BundleFile
from drivecal.bundles.checks import checked
from drivecal.bundles.highway import Scenario
from drivecal.bundles.highway_roads import check_roads
from drivecal.bundles.installed import installed_problems
from drivecal.highway.comfort.reference import Manoeuvre
from drivecal.highway.scenarios import FOLDER, HIGHWAY, RANDOM_FOLDER
from drivecal.highway.simulator import HIGHWAY as HIGHWAY_SIMULATOR
from drivecal.plugins.simulators import Declared, UnsuitableError

SCENARIOS = list(HIGHWAY.scenarios.values())


def test_a_session_is_refused_where_the_road_is_no_carriageway() -> None:
    manifest = installed_problems()["highway"].manifest
    section, data = manifest.simulator.model_dump(mode="json"), manifest.scenarios["S5"]
    HIGHWAY_SIMULATOR.open(section, "S5", data, FOLDER, Declared("highway", ())).close()
    with pytest.raises(UnsuitableError):
        HIGHWAY_SIMULATOR.open(section, "S5", {**data, "route": data["route"][::-1]}, FOLDER, Declared("highway", ()))


def test_the_catalogue_holds_the_six_scenarios_of_the_paper_in_order() -> None:
    assert list(HIGHWAY.scenarios) == ["S1", "S2", "S3", "S4", "S5", "S6"]
    assert [scenario.rated_as for scenario in SCENARIOS] == [manoeuvre for manoeuvre in Manoeuvre for _ in range(2)]


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda scenario: scenario.id)
def test_every_scenario_keeps_to_the_frame_of_the_catalogue(scenario: Scenario) -> None:
    assert 15.0 <= scenario.duration <= 25.0
    assert scenario.step == 0.1
    assert scenario.road.lanes == 3
    assert 1 <= len(scenario.traffic) <= 6
    fastest = max(speed for _, speed in scenario.road.limits)
    assert scenario.ego.s + scenario.duration * fastest < scenario.road.length - 50.0, "the road ends too early"
    assert scenario.task.speeds[0][0] == 0.0
    assert scenario.road.limits[0][0] == 0.0


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda scenario: scenario.id)
def test_no_two_vehicles_start_at_the_same_place(scenario: Scenario) -> None:
    width = scenario.road.lane_width
    outlines = [(scenario.ego.s, scenario.ego.d, scenario.ego.length)]
    outlines += [(vehicle.s, vehicle.lane * width, vehicle.length) for vehicle in scenario.traffic]
    for index, (s, d, length) in enumerate(outlines):
        for other_s, other_d, other_length in outlines[:index]:
            assert abs(d - other_d) > 2.5 or abs(s - other_s) > (length + other_length) / 2 + 10.0


def test_the_digest_follows_definition_and_network() -> None:
    scenario = SCENARIOS[0]
    others = [replace(scenario, network=scenario.network + b" "), replace(scenario, duration=17.0), replace(scenario, seed=2)]
    others.append(replace(scenario, route=("e1",)))
    assert len({variant.digest for variant in [scenario, *others]}) == 5
    assert replace(scenario).digest == scenario.digest


def test_the_random_motorway_differs_from_the_other_in_its_traffic_alone() -> None:
    own, other = (yaml.safe_load((folder / "problem.yaml").read_text()) for folder in (RANDOM_FOLDER, FOLDER))
    assert (own["simulator"].pop("random"), other["simulator"].pop("deterministic")) == (True, True)
    for vehicle in [vehicle for scenario in own["scenarios"].values() for vehicle in scenario["traffic"]]:
        assert [vehicle.pop(name) > 0 for name in ("sigma", "speed_deviation", "departure_deviation")] == [True] * 3
    own["scenarios"] = {name.removesuffix("r"): data for name, data in own["scenarios"].items()}
    assert {name for name in own if own[name] != other[name]} == {"problem", "description"}
    networks = [{path.name: path.read_bytes() for path in folder.glob("*.xml")} for folder in (RANDOM_FOLDER, FOLDER)]
    assert networks[0] == networks[1]


@pytest.mark.parametrize(
    ("path", "value", "field"),
    [
        ("traffic/0/s", 4.4, "traffic[0].s"),
        ("traffic/1/s", 1098.5, "traffic[1].s"),
        ("traffic/0/s", 151.0, "traffic[0].s"),
        ("traffic/0/lane", 9, "traffic[0].lane"),
        ("task/target_lane", 3, "task.target_lane"),
        ("ego/d", 50.0, "ego.d"),
        ("ego/s", 5000.0, "ego.s"),
    ],
)
def test_starts_and_lanes_that_the_road_does_not_have_are_refused(path: str, value: float, field: str) -> None:
    document = yaml.safe_load((RANDOM_FOLDER / "problem.yaml").read_text()) | {"problem": "own"}
    files = {path.name: BundleFile(path.read_bytes(), executable=False) for path in RANDOM_FOLDER.glob("*.xml")}
    check_roads(checked(document), files)
    document = with_change(document, f"scenarios/S1r/{path}", value)
    assert faulty_fields(check_roads, checked(document), files) == [f"scenarios.S1r.{field}"]


def test_the_coordinator_can_load_the_catalogue_without_simulator_and_kernels() -> None:
    code = (
        "import sys; from drivecal.highway.scenarios import HIGHWAY; HIGHWAY.scenarios; "
        "print('libsumo' in sys.modules, 'numba' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False"]
