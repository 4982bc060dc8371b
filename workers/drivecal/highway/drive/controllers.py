"""Controllers of users: a Python function or class, a program, an FMU. Each gives commands for each observation."""

import copy
import math
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from drivecal.adapters.driver import described
from drivecal.adapters.fmu_driver import FATAL, Fmu
from drivecal.adapters.python_driver import imported, unpack
from drivecal.bundles.highway_catalogue import COMMANDS, SIGNALS
from drivecal.domain.errors import DrivecalError
from drivecal.highway.drive.observation import NAMES
from drivecal.highway.drive.programs import ProgramController


class ControllerError(DrivecalError):
    """A controller raised an exception, ended, or gave something else than its commands."""


class Controller(Protocol):
    """A controller of one scenario."""

    def begin(self, parameters: Mapping[str, Any]) -> None:
        """Starts a run with these parameters, from the controller's initial state."""

    def step(self, signals: Sequence[float]) -> Sequence[Any]:
        """Returns the commands in the order of the manifest's `output`. `signals`: in the order of `observation.NAMES`."""


class FunctionController(Controller):
    """A function `(observation, parameters)`, or a class with `step(observation)` that is made for each run."""

    def __init__(self, target: Callable[..., Any], output: Sequence[str], scenario: Mapping[str, Any]) -> None:
        self._target, self._output, self._scenario = target, list(output), scenario
        self._name = getattr(target, "__name__", "the controller")
        self._call: Callable[[dict[str, float]], Any] = lambda _: None

    def begin(self, parameters: Mapping[str, Any]) -> None:
        given = dict(parameters)
        if not isinstance(self._target, type):
            target = self._target
            self._call = lambda observation: target(observation, given)
            return
        step = getattr(self._target(given, copy.deepcopy(dict(self._scenario))), "step", None)
        if not callable(step):
            raise ControllerError(f"the class {self._name} has no method step(observation)")
        self._call = step

    def step(self, signals: Sequence[float]) -> Sequence[Any]:
        answer = self._call(dict(zip(NAMES, signals, strict=True)))
        if isinstance(answer, Mapping):
            return by_name(answer, self._output, self._name)
        if isinstance(answer, (list, tuple)) and "trajectory" not in self._output:
            return answer
        return (answer,)


class FmuControl(Controller):
    """An FMU for co-simulation, which is reset for each run. Its inputs are observed at the begin of each step, its outputs at the end.

    It is initialised in the first step, when its inputs are known.
    """

    def __init__(
        self, file: Path, unpacked: Path, section: Mapping[str, Any], period: float, units: Mapping[str, str] | None = None
    ) -> None:
        """`section`: the manifest's; `units`: of the problem's parameters by name. Raises UnusableError."""
        signals, output = section["signals"], section["output"]
        self._fmu = Fmu(file, unpacked)
        self._fmu.check(signals.values(), "name in `signals`")
        self._fmu.check_units(
            (variable, (COMMANDS if name in output else SIGNALS)[name].unit) for name, variable in signals.items()
        )
        self._fmu.check_section("simulator.controller", section, units or {})
        inputs = {variable: NAMES.index(name) for name, variable in signals.items() if name not in output}
        self._writer = self._fmu.writer(inputs)
        self._indices = [inputs[name] for name in self._writer.names]
        self._reader = self._fmu.reader(dict.fromkeys(signals[name] for name in output))
        self._order = [self._reader.names.index(signals[name]) for name in output]
        self._period, self._count = period, 0
        self._constants: Mapping[str, Any] = section.get("constants") or {}
        self._parameters: Mapping[str, Any] = {}

    def begin(self, parameters: Mapping[str, Any]) -> None:
        self._fmu.check(parameters, "parameter")
        self._parameters, self._count = dict(parameters), 0

    def step(self, signals: Sequence[float]) -> Sequence[Any]:
        inputs = [signals[index] for index in self._indices]
        if self._count == 0:
            self._fmu.begin({**self._constants, **self._parameters}, None, lambda: self._writer.write(inputs))
        self._writer.write(inputs)
        self._fmu.step(self._count * self._period, self._period)
        self._count += 1
        values = self._reader.read()
        return [values[index] for index in self._order]


class Checked:
    """A controller whose faults and answers are checked: a ControllerError names each."""

    def __init__(self, controller: Controller, output: Sequence[str]) -> None:
        self._controller, self._output = controller, tuple(output)

    def begin(self, parameters: Mapping[str, Any]) -> None:
        """Starts a run. Raises ControllerError."""
        try:
            self._controller.begin(parameters)
        except (MemoryError, DrivecalError):
            raise
        except (Exception, SystemExit) as error:
            end_if_fatal(error)
            raise ControllerError(f"the controller does not start: {described(error)}") from error

    def step(self, signals: Sequence[float]) -> Sequence[float]:
        """Returns finite commands. Raises ControllerError."""
        try:
            commands = self._controller.step(signals)
        except (MemoryError, DrivecalError):
            raise
        except (Exception, SystemExit) as error:
            end_if_fatal(error)
            raise ControllerError(f"the controller failed at {signals[0]:g} s: {described(error)}") from error
        if len(commands) != len(self._output):
            names = ", ".join(self._output)
            raise ControllerError(f"the controller gave {len(commands)} values at {signals[0]:g} s, not {names}")
        for name, value in zip(self._output, commands, strict=True):
            if name != "trajectory" and not _is_finite(value):
                raise ControllerError(
                    f"the controller gave {value!r:.100} for {name} at {signals[0]:g} s; it must be a finite number"
                )
        return commands


def _is_finite(value: Any) -> bool:
    try:
        return math.isfinite(value)
    except (TypeError, OverflowError):
        return False


def end_if_fatal(error: BaseException) -> None:
    """Ends the process after an FMU's fatal error, after which none of its functions may be called."""
    if getattr(error, "status", None) == FATAL:
        print(described(error), file=sys.stderr, flush=True)  # noqa: T201  # the cause of the crash
        os._exit(1)


def by_name(answer: Mapping[str, Any], output: Sequence[str], source: str) -> list[Any]:
    """Returns commands by name in the order of `output`. Raises ControllerError if others are there."""
    if answer.keys() != set(output):
        raise ControllerError(f"{source} gave {', '.join(map(str, answer)) or 'nothing'}, not {', '.join(output)}"[:300])
    return [answer[name] for name in output]


def controller(
    section: Mapping[str, Any],
    folder: Path,
    work: Path,
    scratch: Path,
    scenario: Mapping[str, Any],
    step: float,
    units: Mapping[str, str],
) -> Checked:
    """Returns the controller of a manifest's section. `units`: of the problem's parameters by name.

    Raises any exception of the user's file, UnusableError of FMUs.
    """
    output, period = section["output"], section.get("period", step)
    made: Controller
    if section["kind"] == "python":
        made = FunctionController(function_of(section, folder, scratch), output, scenario)
    elif section["kind"] == "process":
        made = ProgramController(section, work, scenario, period)
    else:
        made = FmuControl(folder / section["file"], scratch / "fmu", section, period, units)
    return Checked(made, output)


def function_of(section: Mapping[str, Any], folder: Path, scratch: Path) -> Callable[..., Any]:
    """Returns the function or class of the user's file. Raises ControllerError, and any exception of the file."""
    if section.get("wheels") is not None:
        sys.path.insert(0, str(unpack(folder / section["wheels"], scratch / "packages")))
    file = folder / section["file"]
    sys.path.insert(0, str(file.parent))
    function = getattr(imported(file), section.get("function", "control"), None)
    if not callable(function):
        raise ControllerError(f"{section['file']} has no function {section.get('function', 'control')}")
    return function
