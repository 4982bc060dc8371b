"""The simulator `highway` as workers run it: real SUMO and real controllers in child processes."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.support.motorways import CONTROLLERS, PARAMETERS, ROUTE, compile_fmu, compile_program, drive, driven, motorway
from tests.support.simulators import lost, series

from drivecal.domain.errors import UnavailableError
from drivecal.domain.evaluations import Breakdown
from drivecal.plugins.simulators import RunOutcome

LEADER = {"id": "leader", "s": 160, "speed": 30}
BRAKING = LEADER | {"actions": [{"do": "brake", "time": 4, "speed": 12, "rate": 3}]}
CUTTER = {
    "lane": 1,
    "s": 180,
    "speed": 25,
    "model": "constant",
    "actions": [{"do": "cut_in", "gap": 30, "lane": 0, "seconds": 3}],
}
BUSY = [
    LEADER | {"sigma": 0.5, "model": "Krauss", "speed_deviation": 0.1, "lane_change": "LC2013"},
    {"s": 60, "lane": 1, "speed": 33, "model": "EIDM", "lane_change": "LC2013"},
    {"s": 220, "lane": 1, "speed": 28, "model": "Krauss", "sigma": 0.3, "lane_change": "LC2013"},
]
FLOWS = """<routes><vType id="t" sigma="0.5"{}/><route id="r" edges="{}"/>
<flow id="f" type="t" route="r" begin="0" end="100" period="exp(0.33)" departLane="0"/></routes>"""


SUBLANES = [vehicle | {"lane_change": "SL2015"} for vehicle in BUSY]
"""SUMO has one kind of lanes in a scenario, so that the models are not mixed."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = motorway(tmp_path_factory.mktemp("motorways") / "bundle")
    compile_program(path)
    compile_fmu(path)
    return path


def result(
    folder: Path,
    data: Mapping[str, Any],
    controller: Mapping[str, Any] | None = None,
    parameters: Mapping[str, Any] = PARAMETERS,
    **section: Any,
) -> RunOutcome:
    with driven(folder, data, controller, **section) as session:
        return session.evaluate(parameters, series=True)


@pytest.mark.slow
def test_the_seed_of_a_run_decides_what_its_traffic_does(folder: Path) -> None:
    (folder / "flows.rou.xml").write_text(FLOWS.format("", " ".join(ROUTE)))
    data = drive(BUSY, 15.0, routes="flows.rou.xml")
    with driven(folder, data, random=True) as session:
        first, other, again = (session.evaluate(PARAMETERS, seed=seed).measures for seed in (1, 2, 1))
    assert first == again != other


def python(folder: Path, code: str, **controller: Any) -> tuple[Path, dict[str, Any]]:
    """A bundle with other code, and its controller."""
    return motorway(folder / "other", code), CONTROLLERS["python"] | controller


@pytest.mark.slow
def test_an_acc_follows_a_braking_leader_in_its_lane(folder: Path) -> None:
    outcome = result(folder, drive([BRAKING], 30.0))
    measures = outcome.measures
    assert outcome.failure is None
    assert series(outcome, "leader_speed_mps")[-1] == pytest.approx(12, abs=0.01)
    assert series(outcome, "speed_mps")[-1] == pytest.approx(12, abs=0.3)
    assert series(outcome, "gap_m")[-1] == pytest.approx(4 + 1.5 * 12, abs=2)
    assert measures["duration_s"] == pytest.approx(30)
    assert measures["distance_m"] == pytest.approx(series(outcome, "position_m")[-1] - 100, rel=0.002)
    assert 0.5 < measures["min_headway_s"] < 2
    assert measures["min_gap_m"] == series(outcome, "gap_m").min()
    assert measures["max_lane_offset_m"] < 0.05
    assert measures["lane_departures"] == measures["lane_changes"] == 0


@pytest.mark.slow
def test_the_lane_keeper_holds_the_centre_on_a_curve_and_the_speed_keeper_the_limit(folder: Path, tmp_path: Path) -> None:
    outcome = result(folder, drive(duration=40.0, ego={"s": 500}), parameters=PARAMETERS | {"v0": 33.0})
    assert series(outcome, "position_m")[-1] > 1500
    assert abs(series(outcome, "heading_rad")[-1]) > 0.5
    assert outcome.measures["max_lane_offset_m"] < 0.15
    assert outcome.measures["p95_lateral_acceleration_mps2"] == pytest.approx(33**2 / 1000, rel=0.3)
    bundle, controller = python(
        tmp_path,
        "def control(observation, parameters):\n"
        "    return observation['road_curvature'] - 0.002 * observation['lane_offset'] - 0.04 * observation['heading_error']\n",
        output=["curvature"],
    )
    steered = result(bundle, drive(duration=40.0, ego={"s": 500}), controller)
    assert steered.failure is None
    assert steered.measures["max_lane_offset_m"] < 0.5
    assert series(steered, "speed_mps")[-1] == pytest.approx(36.1, abs=1.0)


@pytest.mark.slow
def test_steering_leaves_the_road_and_a_blind_driver_hits_the_leader(tmp_path: Path) -> None:
    bundle, controller = python(tmp_path, "def control(o, p):\n    return {'steering': -0.01, 'acceleration': 0}\n")
    off = result(bundle, drive(), controller | {"output": ["acceleration", "steering"]})
    assert off.failure == "off_road"
    assert off.measures["duration_s"] < 10
    assert series(off, "time_s")[-1] == pytest.approx(off.measures["duration_s"])
    assert off.measures["max_lane_offset_m"] == abs(series(off, "offset_m")).max()
    blind = motorway(tmp_path / "blind", "def control(observation, parameters):\n    return 0.0\n")
    hit = result(blind, drive([BRAKING], 30.0))
    assert hit.failure == "collision"
    assert hit.measures["min_ttc_s"] < 0.2
    jam = {"id": "jam", "s": 2996.5, "speed": 0, "model": "constant"}
    through = result(blind, drive([jam], 30.0, ego={"s": 2705, "speed": 40}), step=0.5)
    assert through.failure == "collision"
    assert through.measures["progress"] > 0.99  # in the step that ends the route
    wild = motorway(tmp_path / "wild", "def control(o, p):\n    return [0, 0.3 if o['time'] > 1 else 0]\n")
    spun = result(wild, drive(), controller | {"output": ["acceleration", "steering"]})
    assert spun.failure == "unstable"


@pytest.mark.slow
def test_a_vehicle_cuts_in_when_the_gap_is_small_enough(folder: Path) -> None:
    outcome = result(folder, drive([CUTTER], 20.0))
    gaps = series(outcome, "gap_m")
    seen = int(np.argmax(gaps < 1000))
    assert 15 < gaps[seen] < 30
    assert gaps[:seen].min() == 1000
    assert gaps[seen:].max() < 200
    late = result(folder, drive([CUTTER | {"actions": [{"do": "cut_in", "time": 6, "lane": 0}]}], 20.0))
    begin = int(np.argmax(series(late, "gap_m") < 1000))
    assert 60 < begin < 90


@pytest.mark.slow
def test_all_kinds_of_controllers_give_the_same_bits(folder: Path) -> None:
    outcomes = [result(folder, drive([BRAKING], 20.0), controller) for controller in CONTROLLERS.values()]
    assert all(outcome == outcomes[0] for outcome in outcomes)
    assert outcomes[0].failure is None


KINDS = ("python", "process", "numba", "fmu")


@pytest.mark.slow(*(f"exact-{kind}" for kind in KINDS), "random-python", "sublanes-numba")
@pytest.mark.faults(*(f"random-{kind}" for kind in KINDS[1:]), "sublanes-python", "sublanes-process", "sublanes-fmu")
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "data",
    [
        drive([BRAKING, CUTTER], 15.0),
        drive(BUSY, 15.0, routes="flows.rou.xml", seed=5),
        drive(SUBLANES, 15.0, routes="flows.rou.xml", seed=5),
    ],
    ids=["exact", "random", "sublanes"],
)
def test_runs_repeat_in_any_order_and_process(folder: Path, kind: str, data: dict[str, Any]) -> None:
    sets = [PARAMETERS | {"v0": speed} for speed in (28.0, 31.0, 33.0)]
    model = ' laneChangeModel="SL2015"' if data["traffic"] == SUBLANES else ""
    (folder / "flows.rou.xml").write_text(FLOWS.format(model, " ".join(ROUTE)))
    with driven(folder, data, CONTROLLERS[kind]) as session:
        first = [session.evaluate(parameters, series=True) for parameters in sets]
        again = [session.evaluate(parameters, series=True) for parameters in reversed(sets)]
    with driven(folder, data, CONTROLLERS[kind]) as session:
        other = [session.evaluate(sets[index], series=True) for index in (2, 0, 1)]
    assert again == first[::-1]
    assert other == [first[2], first[0], first[1]]
    assert first[0] != first[1]


@pytest.mark.slow
@pytest.mark.parametrize("ends", [False, True], ids=["goes on", "ends"])
def test_a_faulty_controller_costs_its_cell(tmp_path: Path, ends: bool) -> None:
    code = """
import os, time
def control(observation, parameters):
    if observation["time"] < 1.0 or parameters["x"] == 0:
        return 0.0
    return {1: lambda: float("nan"), 2: lambda: 1 / 0, 3: lambda: "fast", 4: lambda: [1, 2], 5: lambda: {"brake": 1},
            6: lambda: os._exit(3), 7: lambda: os.abort(), 8: lambda: time.sleep(100), 9: lambda: exit(2), 10: lambda: None}[
        parameters["x"]]()
"""
    bundle, controller = python(tmp_path, code)
    with driven(bundle, drive(duration=5.0), controller, timeout=5.0) as session:
        expected = session.evaluate({"x": 0})
        assert "nan for acceleration at 1 s" in lost(session, {"x": 1}, Breakdown.ERROR)
        assert "ZeroDivisionError" in lost(session, {"x": 2}, Breakdown.ERROR)
        assert "'fast' for acceleration" in lost(session, {"x": 3}, Breakdown.ERROR)
        assert "2 values" in lost(session, {"x": 4}, Breakdown.ERROR)
        assert "brake" in lost(session, {"x": 5}, Breakdown.ERROR)
        if ends:
            assert "exit code 3" in lost(session, {"x": 6}, Breakdown.CRASH)
            assert "SIGABRT" in lost(session, {"x": 7}, Breakdown.CRASH)
            lost(session, {"x": 8}, Breakdown.HANG)
        assert "SystemExit" in lost(session, {"x": 9}, Breakdown.ERROR)
        assert "None for acceleration" in lost(session, {"x": 10}, Breakdown.ERROR)
        assert session.evaluate({"x": 0}) == expected


def test_a_program_that_is_not_there_refuses_the_worker(folder: Path) -> None:
    for command in (["./missing"], ["no-such-program"]):
        with pytest.raises(UnavailableError), driven(folder, drive(), CONTROLLERS["process"] | {"command": command}):
            pass
