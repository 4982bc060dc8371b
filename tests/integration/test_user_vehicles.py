"""Vehicles of users behind the built-in trackers: a class, a program and an FMU of one law; faults; and a lane keeper in C++."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from tests.support.motorways import PARAMETERS, compile_fmu, drive, driven, motorway
from tests.support.simulators import lost
from tests.support.vehicles import VEHICLES, write_vehicles

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


def test_a_vehicle_that_is_not_there_refuses_the_worker(folder: Path) -> None:
    with pytest.raises(UnavailableError), driven(folder, drive(), vehicle={"kind": "python", "file": "none.py"}):
        pass
