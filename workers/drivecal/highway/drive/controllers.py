"""Controllers of users: a Python function or class, a program, an FMU. Each gives commands for each observation."""

import copy
import json
import math
import os
import select
import signal
import subprocess
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from drivecal.adapters.driver import described
from drivecal.adapters.fmu_driver import Fmu, end_if_fatal
from drivecal.adapters.python_driver import function_of
from drivecal.domain.errors import DrivecalError
from drivecal.highway.drive.geometry import NAMES

LONGEST_LINE = 1 << 16
"""Largest answer in bytes."""
EXTRA_LINE = "the controller wrote more than one line in answer to one"
LOOK_MILLISECONDS = 500
"""Time between looks whether a program that says nothing has ended."""
END_SECONDS = 1.0
"""Time for a program that has closed its output to end."""


class ControllerError(DrivecalError):
    """A controller raised an exception, ended, or gave something else than its commands."""


class ProgramController:
    """A program behind pipes. A fault ends it; the next run starts another. It gets no time limit of its own: the run has one.

    All messages are lines of JSON. The program answers greeting and begin of each run by `{"ready": true}`, and signals by commands.
    """

    def __init__(self, section: Mapping[str, Any], work: Path, scenario: Mapping[str, Any], period: float) -> None:
        """`section` is the manifest's."""
        self._command, self._work, self._scenario, self._period = section["command"], work, scenario, period
        self._output = list(section["output"])
        self._signals = list(section.get("signals") or NAMES)
        self._indices = [NAMES.index(name) for name in self._signals]
        self._process: subprocess.Popen[bytes] | None = None
        self._number = 0
        self._stdin = self._stdout = -1

    def begin(self, parameters: Mapping[str, Any]) -> None:
        """Tells the program of a run, and waits until it is ready. Raises ControllerError."""
        self._number += 1
        try:
            if self._process is None:
                self._start()
            self._ask({"run": self._number, "parameters": dict(parameters), "scenario": dict(self._scenario)})
        except BaseException:
            self._stop()
            raise

    def step(self, signals: Sequence[float]) -> Sequence[Any]:
        """Returns the program's commands, unchecked. Raises ControllerError."""
        try:
            chosen = [signals[index] for index in self._indices]
            self._send(json.dumps(dict(zip(self._signals, chosen, strict=True))).encode() + b"\n")
            answer = self._line()
            if len(self._output) == 1 and isinstance(answer, (int, float)):
                return (answer,)
            if not isinstance(answer, dict) or answer.keys() != set(self._output):
                raise ControllerError(f"the controller answered {answer!r:.200}, not an object of {', '.join(self._output)}")
            return [answer[name] for name in self._output]
        except BaseException:
            self._stop()
            raise

    def _start(self) -> None:
        try:
            self._process = subprocess.Popen(  # noqa: S603  # the user's program, limited like this process
                self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=self._work, bufsize=0, process_group=0
            )
        except OSError as error:
            raise ControllerError(f"{self._command[0]} cannot be started: {error}") from error
        assert self._process.stdin is not None  # noqa: S101  # for the type checker
        assert self._process.stdout is not None  # noqa: S101  # for the type checker
        self._stdin, self._stdout = self._process.stdin.fileno(), self._process.stdout.fileno()
        self._said = select.poll()
        self._said.register(self._stdout, select.POLLIN)
        greeting = {"drivecal": 1, "signals": self._signals, "output": self._output, "period": self._period}
        self._ask(greeting)

    def _ask(self, message: Mapping[str, Any]) -> None:
        self._send(json.dumps(message, allow_nan=False).encode() + b"\n")
        answer = self._line()
        if not isinstance(answer, dict) or answer.get("ready") is not True:
            raise ControllerError(f'the controller answered {answer!r:.200} to {next(iter(message))}, not {{"ready": true}}')

    def _send(self, content: bytes) -> None:
        try:
            if self._said.poll(0) and os.read(self._stdout, 1):
                raise ControllerError(EXTRA_LINE)
            while content:
                content = content[os.write(self._stdin, content) :]
        except OSError:
            raise self._ended() from None

    def _line(self) -> Any:
        received = b""
        while b"\n" not in received:
            has_ended = self._process is None or self._process.poll() is not None
            is_said = bool(self._said.poll(0 if has_ended else LOOK_MILLISECONDS))
            if not is_said and not has_ended:
                continue
            more = os.read(self._stdout, 65536) if is_said else b""  # a helper of a program that has ended may hold the pipe
            if not more:
                raise self._ended()
            received += more
            if len(received) > LONGEST_LINE:
                raise ControllerError(f"the controller wrote a line of more than {LONGEST_LINE >> 10} kB")
        line, _, rest = received.partition(b"\n")
        if rest:
            raise ControllerError(EXTRA_LINE)
        try:
            return json.loads(line)
        except (ValueError, RecursionError):
            raise ControllerError(f"the controller's answer is not JSON: {line[:200].decode(errors='replace')!r}") from None

    def _ended(self) -> ControllerError:
        """Returns the error of a program that has closed its pipes; its messages are on standard error."""
        try:
            status = None if self._process is None else self._process.wait(END_SECONDS)
        except subprocess.TimeoutExpired:
            return ControllerError("the controller closed its standard input or output")
        killed = status is not None and status < 0
        return ControllerError(
            f"the controller {'was killed by signal' if killed else 'ended with exit code'} {abs(status or 0)}"
        )

    def _stop(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            with suppress(OSError):
                os.killpg(process.pid, signal.SIGKILL)  # with its helpers
            process.wait()
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    pipe.close()


class Controller(Protocol):
    """A controller of one scenario."""

    def begin(self, parameters: Mapping[str, Any]) -> None:
        """Starts a run with these parameters, from the controller's initial state."""

    def step(self, signals: Sequence[float]) -> Sequence[Any]:
        """Returns the commands in the order of the manifest's `output`. `signals` have the order of `geometry.NAMES`."""


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
            if answer.keys() != set(self._output):
                given, wanted = ", ".join(map(str, answer)) or "nothing", ", ".join(self._output)
                raise ControllerError(f"{self._name} gave {given}, not {wanted}"[:300])
            return [answer[name] for name in self._output]
        if isinstance(answer, (list, tuple)) or (isinstance(answer, np.ndarray) and answer.ndim == 1):
            return list(answer)
        return (answer,)


class LoadedFmuController(Controller):
    """An FMU for co-simulation, which is reset for each run. Its inputs are observed at the begin of each step, its outputs at the end.

    It is initialised in the first step, when its inputs are known.
    """

    def __init__(self, file: Path, unpacked: Path, section: Mapping[str, Any], period: float) -> None:
        """`section` is the manifest's. Raises UnusableError."""
        signals, output = section["signals"], section["output"]
        self._fmu = Fmu(file, unpacked)
        self._fmu.check(signals.values(), "name in `signals`")
        inputs = {variable: NAMES.index(name) for name, variable in signals.items() if name not in output}
        self._writer = self._fmu.writer(inputs)
        self._indices = [inputs[name] for name in self._writer.names]
        self._reader = self._fmu.reader(dict.fromkeys(signals[name] for name in output))
        self._order = [self._reader.names.index(signals[name]) for name in output]
        self._period, self._count = period, 0
        self._constants: Mapping[str, Any] = section.get("constants") or {}
        self._values = self._constants

    def begin(self, parameters: Mapping[str, Any]) -> None:
        self._fmu.check(parameters, "parameter")
        self._values, self._count = {**self._constants, **parameters}, 0

    def step(self, signals: Sequence[float]) -> Sequence[Any]:
        inputs = [signals[index] for index in self._indices]
        if self._count == 0:
            self._fmu.begin(self._values, None, lambda: self._writer.write(inputs))
        self._writer.write(inputs)
        self._fmu.step(self._count * self._period, self._period)
        self._count += 1
        values = self._reader.read()
        return [values[index] for index in self._order]


class Checked:
    """A controller whose faults and answers are checked: a ControllerError names each. `output`: names of its commands in their order."""

    def __init__(self, controller: Controller, output: Sequence[str]) -> None:
        self._controller, self.output = controller, tuple(output)

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
        if len(commands) != len(self.output):
            names = ", ".join(self.output)
            raise ControllerError(f"the controller gave {len(commands)} values at {signals[0]:g} s, not {names}")
        for name, value in zip(self.output, commands, strict=True):
            if not _is_finite(value):
                raise ControllerError(f"the controller gave {value!r:.100} for {name} at {signals[0]:g} s; it must be finite")
        return commands


def _is_finite(value: Any) -> bool:
    try:
        return not isinstance(value, np.complexfloating) and math.isfinite(value)
    except (TypeError, OverflowError):
        return False


def controller(
    section: Mapping[str, Any], folder: Path, work: Path, scratch: Path, scenario: Mapping[str, Any], step: float
) -> Checked:
    """Returns the controller of a manifest's section. Raises any exception of the user's file, UnusableError of FMUs.

    Args:
        section: the manifest's section.
        folder: the bundle's folder.
        work: working folder of programs.
        scratch: folder for unpacked files.
        scenario: the scenario's data.
        step: period of the controller (s) if the section has none.
    """
    output, period = section["output"], section.get("period", step)
    made: Controller
    if section["kind"] == "python":
        function = function_of("simulator.controller", section, folder, scratch / "packages")
        made = FunctionController(function, output, scenario)
    elif section["kind"] == "process":
        made = ProgramController(section, work, scenario, period)
    else:
        made = LoadedFmuController(folder / section["file"], scratch / "fmu", section, period)
    return Checked(made, output)
