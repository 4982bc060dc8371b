"""The built-in catalogue and its networks."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from drivecal.domain.roads import reference_line
from drivecal.domain.scenarios import Scenario
from drivecal.highway.manoeuvres import Manoeuvre
from drivecal.highway.scenarios.build import build, without_origin
from drivecal.highway.scenarios.designs import DESIGNS, line_of
from drivecal.highway.scenarios.highway import HIGHWAY

SCENARIOS = list(HIGHWAY.scenarios.values())


def test_the_catalogue_holds_the_six_scenarios_of_the_paper_in_order() -> None:
    assert list(HIGHWAY.scenarios) == ["S1", "S2", "S3", "S4", "S5", "S6"]
    assert [scenario.rated_as for scenario in SCENARIOS] == [
        Manoeuvre.LANE_CHANGE,
        Manoeuvre.LANE_CHANGE,
        Manoeuvre.LANE_KEEPING,
        Manoeuvre.LANE_KEEPING,
        Manoeuvre.SPEED_CHANGE,
        Manoeuvre.SPEED_CHANGE,
    ]


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda scenario: scenario.id)
def test_the_committed_network_is_what_its_design_builds(scenario: Scenario) -> None:
    assert build(DESIGNS[scenario.id]) == scenario.network, "run `make networks`"


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda scenario: scenario.id)
def test_the_measured_road_is_the_designed_one(scenario: Scenario) -> None:
    road, design = scenario.road, DESIGNS[scenario.id]
    assert (road.lanes, road.lane_width) == (design.lanes, design.lane_width)
    assert road.length == pytest.approx(design.length, abs=0.01)
    assert [knot.speed for knot in road.limits] == pytest.approx([knot.speed for knot in design.limits], abs=1e-4)
    assert [knot.s for knot in road.limits] == pytest.approx([knot.s for knot in design.limits], abs=0.6)
    line, truth = reference_line(road), line_of(design)
    assert line.shape == truth.shape
    assert np.abs(line[:, 1:3] - truth[:, 1:3]).max() < 0.01
    assert np.abs(line[:, 3] - truth[:, 3]).max() < 0.001
    assert np.abs(line[:, 4] - truth[:, 4]).max() < 0.05 * max(np.abs(truth[:, 4]).max(), 1e-9)


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda scenario: scenario.id)
def test_every_scenario_keeps_to_the_frame_of_the_catalogue(scenario: Scenario) -> None:
    assert 15.0 <= scenario.duration <= 25.0
    assert scenario.step == 0.1
    assert scenario.road.lanes == 3
    assert 1 <= len(scenario.traffic) <= 6
    fastest = max(knot.speed for knot in scenario.road.limits)
    assert scenario.ego.s + scenario.duration * fastest < scenario.road.length - 50.0, "the road ends too early"
    assert scenario.task.speeds[0].s == 0.0
    assert scenario.road.limits[0].s == 0.0


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


def test_only_the_comment_about_the_origin_is_taken_out_of_a_network() -> None:
    network = b'<?xml version="1.0"?>\n\n<!-- generated on 2020-01-01 by X\n<a/>\n-->\n\n<net><!-- kept --></net>\n'
    assert without_origin(network) == b'<?xml version="1.0"?>\n\n<net><!-- kept --></net>\n'


def test_the_coordinator_can_load_the_catalogue_without_simulator_and_kernels() -> None:
    code = (
        "import sys; from drivecal.highway.scenarios.highway import HIGHWAY; HIGHWAY.scenarios; "
        "print('libsumo' in sys.modules, 'numba' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False"]
