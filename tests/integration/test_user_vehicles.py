"""Vehicles of users behind the built-in trackers: a class, a program and an FMU of one law; faults; and a lane keeper in C++."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from tests.support.motorways import CONTROLLERS, PARAMETERS, compile_fmu, drive, driven, motorway
from tests.support.simulators import lost
from tests.support.vehicles import LANE_KEEPER, VEHICLES, write_vehicles

from drivecal.domain.errors import UnavailableError
from drivecal.domain.evaluations import Breakdown
from drivecal.plugins.simulators import RunOutcome

BRAKING = {"id": "leader", "s": 560, "speed": 30, "actions": [{"do": "brake", "time": 4, "speed": 12, "rate": 3}]}
CURVE = drive([BRAKING], 20.0, ego={"s": 500})
STEADY = """
def control(o, p):
    return [[0.25 * i, o["position"] + o["speed"] * 0.25 * i, o["lane_offset"] * max(0.0, 1.0 - 0.5 * 0.25 * i)] for i in range(11)]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = motorway(tmp_path_factory.mktemp("vehicles") / "bundle")
    compile_fmu(path)
    write_vehicles(path)
    (path / "steady.py").write_text(STEADY)
    return path


def result(folder: Path, vehicle: Mapping[str, Any] | str, controller: Mapping[str, Any] | None = None) -> list[RunOutcome]:
    """Two runs of a session."""
    with driven(folder, CURVE, controller, vehicle=vehicle) as session:
        return [session.evaluate(PARAMETERS, series=True) for _ in range(2)]


@pytest.mark.slow("all")
@pytest.mark.parametrize("kinds", [["python"], list(VEHICLES)], ids=["python", "all"])
def test_all_kinds_of_vehicles_give_the_same_bits_in_every_run(folder: Path, kinds: list[str]) -> None:
    outcomes = [outcome for kind in kinds for outcome in result(folder, VEHICLES[kind])]
    assert all(outcome == outcomes[0] for outcome in outcomes)
    assert outcomes[0].failure is None


@pytest.mark.slow
@pytest.mark.parametrize(
    "controller",
    [
        {"kind": "python", "file": "acc.py", "output": ["acceleration"]},
        LANE_KEEPER,
        {"kind": "python", "file": "steady.py", "output": ["trajectory"], "period": 0.2},
    ],
    ids=["path", "curvature", "trajectory"],
)
def test_the_trackers_keep_another_vehicle_on_its_lane_on_a_curve_as_the_built_in_one(
    folder: Path, controller: dict[str, Any]
) -> None:
    own, built_in = (result(folder, vehicle, controller)[0] for vehicle in (VEHICLES["python"], "single_track"))
    assert own.measures != built_in.measures
    assert own.measures["max_lane_offset_m"] < 0.8  # the trackers assume a car that understeers, and feed back slowly
    assert own.measures["distance_m"] == pytest.approx(built_in.measures["distance_m"], rel=0.01)


@pytest.mark.slow
def test_a_lane_keeper_in_cpp_and_an_acc_as_an_fmu_give_the_same_bits_on_two_workers(folder: Path) -> None:
    for controller in (LANE_KEEPER, CONTROLLERS["fmu"]):
        with driven(folder, CURVE, controller) as one, driven(folder, CURVE, controller) as other:
            outcomes = [session.evaluate(PARAMETERS, series=True) for session in (one, other, one, other)]
        assert all(outcome == outcomes[0] for outcome in outcomes)
        assert outcomes[0].failure is None


@pytest.mark.slow("step", "2 values", "finite", "numbers")
@pytest.mark.parametrize(
    ("code", "cause"),
    [
        ("def __init__(self, *_): raise ValueError('tyres')", "tyres"),
        ("def __init__(self, *_): pass", "step"),
        ("def __init__(self, *_): pass\n    def step(self, *_): return 1, 2", "2 values"),
        ("def __init__(self, *_): pass\n    def step(self, *_): return 1, 2, 3, float('nan')", "finite"),
        ("def __init__(self, *_): pass\n    def step(self, *_): return 1, 2, 3, 'fast'", "numbers"),
        ("def __init__(self, *_): pass\n    def step(self, *_): return {'x': 1}", "KeyError"),
    ],
)
def test_a_faulty_vehicle_costs_its_cell(tmp_path: Path, code: str, cause: str) -> None:
    bundle = motorway(tmp_path / "b")
    (bundle / "car.py").write_text(f"class Vehicle:\n    {code}\n")
    with driven(bundle, drive(), vehicle={"kind": "python", "file": "car.py"}) as session:
        assert cause in lost(session, PARAMETERS, Breakdown.ERROR)


@pytest.mark.slow
def test_a_vehicle_that_leaves_its_grip_is_unstable(tmp_path: Path) -> None:
    bundle = motorway(tmp_path / "b")
    (bundle / "car.py").write_text(
        "class Vehicle:\n    def __init__(self, p, s, speed): self.x, self.v = 0.0, speed\n"
        "    def step(self, *_):\n        self.x += 0.01 * self.v\n        return self.x, 0.0, 0.0, self.v, 0.4, 12.0\n"
    )
    vehicle = {"kind": "python", "file": "car.py", "state": ["x", "y", "heading", "speed", "yaw_rate", "lateral_acceleration"]}
    with driven(bundle, drive(), vehicle=vehicle) as session:
        assert session.evaluate(PARAMETERS).failure == "unstable"


def test_a_vehicle_that_is_not_there_refuses_the_worker(folder: Path) -> None:
    for vehicle in ({"kind": "python", "file": "none.py"}, {"kind": "process", "command": ["./none"]}):
        with pytest.raises(UnavailableError), driven(folder, drive(), vehicle=vehicle):
            pass
