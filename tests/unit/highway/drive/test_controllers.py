"""Controllers in this process: what functions and classes get and may return."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.support.motorways import CONTROLLERS, FMU, compile_fmu

from drivecal.highway.drive.controllers import Checked, ControllerError, FmuControl, FunctionController
from drivecal.highway.drive.observation import NAMES

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
    "answer",
    [
        None,
        "1",
        float("nan"),
        float("inf"),
        [1.0, 2.0],
        [],
        {},
        {"brake": 1},
        {"acceleration": None},
        10**400,
        [[1.0]],
        object(),
    ],
)
def test_anything_else_is_refused(answer: object) -> None:
    with pytest.raises(ControllerError):
        answered(lambda _, __: answer)


@pytest.mark.parametrize("error", [ZeroDivisionError, KeyError, SystemExit, RecursionError])
def test_an_exception_names_the_time(error: type[BaseException]) -> None:
    def control(*_: object) -> float:
        raise error

    with pytest.raises(ControllerError, match=f"at 0 s: {error.__name__}"):
        answered(control)


def test_running_out_of_memory_is_no_fault_of_the_controller() -> None:
    def control(*_: object) -> float:
        raise MemoryError

    with pytest.raises(MemoryError):
        answered(control)


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
    control = FmuControl(tmp_path / "acc.fmu", tmp_path / "fmu", section["signals"], section["output"], 0.1)
    speed = NAMES.index("speed")
    for factor, speeds in ((2.0, (30.0, 20.0)), (3.0, (10.0, 15.0))):
        control.begin({"T": factor})
        answers: list[Any] = []
        for value in speeds:
            signals = list(SIGNALS)
            signals[speed] = value
            answers += control.step(signals)
        assert answers == [factor * speeds[0]] * 2
