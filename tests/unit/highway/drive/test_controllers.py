"""Controllers in this process: what functions and classes get and may return."""

import sys
from collections.abc import Callable
from math import inf, nan
from multiprocessing import connection
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from tests.support.motorways import CONTROLLERS, FMU, PARAMETERS, compile_fmu
from tests.support.serve import until
from tests.support.simulators import is_running

from drivecal.highway.drive import controllers
from drivecal.highway.drive.controllers import (
    Checked,
    ControllerError,
    FunctionController,
    LoadedFmuController,
    ProgramController,
)
from drivecal.highway.drive.geometry import NAMES

SIGNALS = [float(number) for number in range(len(NAMES))]
SCENARIO = {"data": {"list": [1]}}


def controller(target: Callable[..., Any], *output: str) -> Checked:
    names = output or ("acceleration",)
    return Checked(FunctionController(target, names, SCENARIO), names)


def answered(target: Callable[..., Any], *output: str) -> list[float]:
    control = controller(target, *output)
    control.begin({"T": 1.5})
    return list(control.step(SIGNALS))


def test_a_function_gets_signals_by_name_and_parameters() -> None:
    given: list[Any] = []

    def control(observation: dict[str, float], parameters: dict[str, Any]) -> float:
        given.append((dict(observation), dict(parameters)))
        observation.clear()
        return 0.5

    assert answered(control) == [0.5]
    assert given == [(dict(zip(NAMES, SIGNALS, strict=True)), {"T": 1.5})]


@pytest.mark.parametrize("answer", [2, 2.0, np.float64(2), [2.0], (2.0,), {"acceleration": 2.0}])
def test_one_command_may_be_returned_in_many_ways(answer: object) -> None:
    assert answered(lambda _, __: answer) == [2.0]


def test_commands_by_name_come_in_the_manifest_s_order() -> None:
    assert answered(lambda _, __: {"steering": 0.1, "acceleration": 1.0}, "acceleration", "steering") == [1.0, 0.1]


@pytest.mark.parametrize(
    "answer", [None, "1", nan, inf, [1.0, 2.0], [], {}, {"brake": 1}, {"acceleration": None}, 10**400, [[1.0]], object()]
)
def test_anything_else_is_refused(answer: object) -> None:
    with pytest.raises(ControllerError):
        answered(lambda _, __: answer)


@pytest.mark.parametrize("error", [ZeroDivisionError, KeyError, SystemExit, RecursionError])
def test_an_exception_names_the_time(error: type[BaseException]) -> None:
    with pytest.raises(ControllerError, match=f"at 0 s: {error.__name__}"):
        answered(Mock(side_effect=error))


def test_running_out_of_memory_is_no_fault_of_the_controller() -> None:
    with pytest.raises(MemoryError):
        answered(Mock(side_effect=MemoryError))


def test_a_class_is_made_for_each_run() -> None:
    class Counter:
        def __init__(self, parameters: dict[str, Any], scenario: dict[str, Any]) -> None:
            self.count: float = parameters["T"] + len(scenario["data"]["list"])
            scenario["data"]["list"].append(1)

        def step(self, observation: dict[str, float]) -> float:
            self.count += observation["time"] + 1
            return self.count

    control = controller(Counter)
    for _ in range(2):
        control.begin({"T": 1.5})
        assert list(control.step(SIGNALS)) == [3.5]
        assert list(control.step(SIGNALS)) == [4.5]


def test_managers_of_a_controller_do_without_unix_sockets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "default_family", "AF_UNIX")
    monkeypatch.setattr(sys, "path", [*sys.path])
    (tmp_path / "shares.py").write_text(
        "import multiprocessing.connection as c\ndef control(*_): return c.default_family == 'AF_INET'"
    )
    section = {"kind": "python", "file": "shares.py", "function": "control", "output": ["acceleration"]}
    control = controllers.controller(section, tmp_path, tmp_path, tmp_path, {}, 0.1)
    control.begin({})
    assert list(control.step(SIGNALS)) == [True]


def test_a_class_without_step_is_named() -> None:
    class Nothing:
        def __init__(self, parameters: object, scenario: object) -> None: ...

    with pytest.raises(ControllerError, match="no method step"):
        answered(Nothing)


def test_an_fmu_is_initialised_with_its_parameters_and_the_inputs_of_time_0(tmp_path: Path) -> None:
    """This one multiplies the first speed by a parameter at the end of its initialisation, and then keeps its output."""
    end = "fmi2ExitInitializationMode(fmi2Component c) { "
    source = FMU.replace(end, f"{end}v[7] = v[0] * v[4]; ").replace("v[7] = law(v[0], v[1], v[2], v[3], v[4], v[5], v[6]);", "")
    compile_fmu(tmp_path, source)
    section = CONTROLLERS["fmu"]
    control = LoadedFmuController(tmp_path / "acc.fmu", tmp_path / "fmu", section, 0.1)
    speed = NAMES.index("speed")
    for factor, speeds in ((2.0, (30.0, 20.0)), (3.0, (10.0, 15.0))):
        control.begin({"T": factor})
        answers: list[Any] = []
        for value in speeds:
            signals = list(SIGNALS)
            signals[speed] = value
            answers += control.step(signals)
        assert answers == [factor * speeds[0]] * 2


def test_constants_give_inputs_and_parameters_of_an_fmu_in_every_run(tmp_path: Path) -> None:
    """The speed of the leader is no signal here, and `c` no parameter of the problem."""
    compile_fmu(tmp_path)
    section = CONTROLLERS["fmu"]
    whole = LoadedFmuController(tmp_path / "acc.fmu", tmp_path / "fmu", section, 0.1)
    signals = [0.0] * len(NAMES)
    for name, value in (("speed", 30.0), ("gap", 40.0), ("leader_speed", 25.0)):
        signals[NAMES.index(name)] = value
    whole.begin(PARAMETERS)
    expected = whole.step(signals)
    rest = {name: variable for name, variable in section["signals"].items() if name != "leader_speed"}
    given = section | {"signals": rest, "constants": {"u3": 25.0, "c": PARAMETERS["c"]}}
    control = LoadedFmuController(tmp_path / "acc.fmu", tmp_path / "fmu", given, 0.1)
    for _ in range(2):
        control.begin({name: value for name, value in PARAMETERS.items() if name != "c"})
        assert control.step(signals) == expected


PROGRAM = """
import json, sys
names = json.loads(sys.stdin.readline())["signals"]
print('{"ready": true}', flush=True)
sys.stdin.readline()
print('{"ready": true}', flush=True)
values = json.loads(sys.stdin.readline())
print(json.dumps({"acceleration": len(values), "curvature": values["relative_speed"]}), flush=True)
"""


@pytest.mark.parametrize(("signals", "expected"), [(None, [42, 41]), (["leader_exists", "relative_speed"], [2, 41])])
def test_programs_get_the_signals_that_they_name(tmp_path: Path, signals: list[str] | None, expected: list[float]) -> None:
    (tmp_path / "program.py").write_text(PROGRAM)
    section = {"command": [sys.executable, "-S", "program.py"], "output": ["acceleration", "curvature"]}
    program = ProgramController(section | {"signals": signals}, tmp_path, {}, 0.1)
    program.begin({})
    assert list(program.step(SIGNALS)) == expected
    with pytest.raises(ControllerError):
        program.step(SIGNALS)  # ends and waits for it


def test_a_program_ends_with_its_helpers_and_is_not_waited_for(tmp_path: Path) -> None:
    """Although a helper holds its output."""
    command = ["sh", "-c", "sleep 600 & echo $! > helper; exit 3"]
    program = ProgramController({"command": command, "output": ["acceleration"]}, tmp_path, {}, 0.1)
    with pytest.raises(ControllerError, match="exit code 3"):
        program.begin({})
    helper = int((tmp_path / "helper").read_text())
    until(lambda: not is_running(helper))


def test_a_line_too_many_that_comes_late_is_no_later_command(tmp_path: Path) -> None:
    late = "import time\ntime.sleep(0.2)\nprint('{\"acceleration\": 9}', flush=True)\nsys.stdin.readline()\n"
    (tmp_path / "program.py").write_text(PROGRAM + late)
    section = {"command": [sys.executable, "-S", "program.py"], "output": ["acceleration", "curvature"], "signals": None}
    program = ProgramController(section, tmp_path, {}, 0.1)
    program.begin({})

    def drive() -> None:
        program.step(SIGNALS)
        connection.wait([program._stdout])
        program.step(SIGNALS)

    with pytest.raises(ControllerError, match="more than one line"):
        drive()
