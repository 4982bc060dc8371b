"""The child of simulator kind `fmu`: instantiates an FMU once, resets it for each run and measures its outputs.

Start values come from the scenario's data and the parameters, by the names of the FMU's variables.
"""

import math
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from drivecal.adapters.driver import Evaluate, UnusableError, described, serve
from drivecal.bundles.fmus.checks import reduction_of, wanted_by
from drivecal.bundles.fmus.description import INTEGERS, NUMBERS, Variables, parse_description
from drivecal.domain.errors import InvalidInputError, UnavailableError

FATAL = 4
"""FMI's status after which no function of the FMU may be called."""
_ACCESS = NUMBERS | INTEGERS.keys() | {"Boolean", "String"}
"""Types of variables, which are the ends of the names of the functions that read and write them."""


class Fmu:
    """An instantiated FMU."""

    def __init__(self, file: Path, unpacked: Path) -> None:
        """Unpacks the FMU if it is not, and instantiates it. Raises UnusableError, or UnavailableError on another platform."""
        import fmpy  # 0.3 s

        try:
            self.model = fmpy.read_model_description(str(file), validate=False)
        except (ImportError, MemoryError, OSError):  # of the machine, not of the FMU
            raise
        except Exception as error:
            raise UnusableError(f"FMPy cannot read the modelDescription.xml of {file.name}: {error}") from error
        version = self.model.fmiVersion
        if version[0] not in "23":
            raise UnusableError(f"{file.name} is of FMI {version}; export it as FMI 2 or 3 co-simulation")
        self.is_third = version[0] == "3"
        if self.model.coSimulation is None:
            raise UnusableError(f"{file.name} is for model exchange only; export it for co-simulation")
        platforms = fmpy.supported_platforms(str(file))
        if not {fmpy.platform, fmpy.platform_tuple} & set(platforms):
            raise UnavailableError(f"{file.name} is built for {', '.join(platforms) or 'no platform'}, not for {fmpy.platform}")
        if not unpacked.is_dir():
            fmpy.extract(str(file), unzipdir=str(unpacked))
        self.variables = {variable.name: variable for variable in self.model.modelVariables}
        self.described: Variables = {}
        with suppress(InvalidInputError):  # FMPy reads on; ranges are then not checked
            self.described = parse_description((unpacked / "modelDescription.xml").read_bytes()) or {}
        self._slave = self._instantiated(unpacked)
        self._is_fresh = True

    def begin(self, values: Mapping[str, Any], duration: float | None, set_inputs: Callable[[], None] = lambda: None) -> None:
        """Resets the FMU and initialises it with start values by name. `duration`: None if the end is not known.

        `set_inputs`: writes the inputs of time 0, in initialisation mode.
        """
        if not self._is_fresh:
            self._slave.reset()
        self._is_fresh = False
        if not self.is_third:
            self._slave.setupExperiment(startTime=0.0, stopTime=duration)
        for name, value in values.items():
            self._set(name, value)
        if self.is_third:
            self._slave.enterInitializationMode(startTime=0.0, stopTime=duration)
        else:
            self._slave.enterInitializationMode()
        set_inputs()
        self._slave.exitInitializationMode()

    def step(self, time: float, length: float) -> None:
        """Simulates one communication step. Raises UnusableError if the FMU wants to end earlier."""
        ended = self._slave.doStep(currentCommunicationPoint=time, communicationStepSize=length)
        if self.is_third and (ended[1] or ended[2]):
            raise UnusableError(f"the FMU ended the simulation at {ended[3]:g} s")

    def reader(self, names: Iterable[str]) -> "Reader":
        """Returns a reader of these variables."""
        return Reader(self._slave, {f"get{access}": group for access, group in self._grouped(names, "measured").items()})

    def writer(self, names: Iterable[str]) -> "Writer":
        """Returns a writer of these variables."""
        return Writer(self._slave, self._grouped(names, "set to a number"))

    def _grouped(self, names: Iterable[str], use: str) -> dict[str, list[tuple[str, int]]]:
        """Returns names and value references by the end of the name of their functions."""
        groups: dict[str, list[tuple[str, int]]] = {}
        for name in names:
            access = self._access(name)
            if access == "String":
                raise UnusableError(f"the variable {name} is a text and cannot be {use}")
            groups.setdefault(access, []).append((name, self.variables[name].valueReference))
        return groups

    def check(self, names: Iterable[str], role: str) -> None:
        """Raises UnusableError naming the first name that the FMU does not have."""
        for name in names:
            if name not in self.variables:
                similar = get_close_matches(name, self.variables, 3) or sorted(self.variables)[:5]
                raise UnusableError(f"the FMU has no variable {name}, a {role}; it has e.g. {', '.join(similar)}")

    def _access(self, name: str) -> str:
        kind = self.variables[name].type
        if self.variables[name].dimensions:
            raise UnusableError(f"the variable {name} is an array, which is not supported")
        access = ("Int64" if self.is_third else "Integer") if kind == "Enumeration" else str(kind)
        if access not in _ACCESS:
            raise UnusableError(f"the variable {name} is of type {kind}, which is not supported")
        return access

    def _set(self, name: str, value: Any) -> None:
        variable, access = self.variables[name], self._access(name)
        if access == "String":
            value = str(value)
        elif isinstance(value, str):
            value = self._item(name, value)
        elif name in self.described and (wanted := wanted_by(self.described[name], value)) is not None:
            raise UnusableError(f"{value} does not fit the variable {name} of type {variable.type}: {wanted}")
        elif access not in NUMBERS:
            if value != int(value):
                raise UnusableError(f"{value} does not fit the variable {name} of type {variable.type}: give a whole number")
            value = int(value)
        getattr(self._slave, f"set{access}")([variable.valueReference], [value])

    def _item(self, name: str, text: str) -> int:
        """Returns the value of an enumeration's item."""
        declared = self.variables[name].declaredType
        items = {} if declared is None else {item.name: int(item.value) for item in declared.items}
        if text not in items:
            raise UnusableError(f"the variable {name} has no item {text}; it has {', '.join(items) or 'none'}")
        return items[text]

    def _instantiated(self, unpacked: Path) -> Any:
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        make = FMU3Slave if self.is_third else FMU2Slave
        slave = make(
            guid=self.model.guid,
            unzipDirectory=str(unpacked),
            modelIdentifier=self.model.coSimulation.modelIdentifier,
            instanceName="drivecal",
        )
        slave.instantiate()
        return slave


class Reader:
    """Reads a fixed list of variables; `names` has their order."""

    def __init__(self, slave: Any, groups: Mapping[str, list[tuple[str, int]]]) -> None:
        """`groups`: names and value references by the function that reads them."""
        self.names = [name for group in groups.values() for name, _ in group]
        self._calls = [(getattr(slave, function), [reference for _, reference in group]) for function, group in groups.items()]

    def read(self) -> list[float]:
        """Returns the values."""
        return [float(value) for function, references in self._calls for value in function(references)]


class Writer:
    """Writes a fixed list of variables; `names` has their order. Numbers are rounded unless the variable is a real."""

    def __init__(self, slave: Any, groups: Mapping[str, list[tuple[str, int]]]) -> None:
        """`groups`: names and value references by the end of the name of the function that writes them."""
        self.names = [name for group in groups.values() for name, _ in group]
        self._calls = [
            (getattr(slave, f"set{access}"), None if access in NUMBERS else access, [r for _, r in group])
            for access, group in groups.items()
        ]

    def write(self, values: Sequence[float]) -> None:
        """Writes the values, in the order of `names`."""
        first = 0
        for function, access, references in self._calls:
            last = first + len(references)
            given = values[first:last] if access is None else [round(value) for value in values[first:last]]
            least, most = INTEGERS.get(access or "", (-math.inf, math.inf))
            if any(value < least or value > most for value in given):  # it would wrap
                names = ", ".join(self.names[first:last])
                raise UnusableError(f"{given} does not fit the variables {names} of type {access}: give {least} to {most}")
            function(references, given)
            first = last


class OutputStatistics:
    """Last, least, greatest, mean and integral of one output; the integral is that of straight lines between steps."""

    def __init__(self, first: float) -> None:
        """Starts with the value at time 0."""
        self.last = self.min = self.max = first
        self.integral = 0.0
        self._time = 0.0

    def add(self, value: float, length: float) -> None:
        """Adds the value after a step."""
        self.integral += 0.5 * (self.last + value) * length
        self._time += length
        self.last, self.min, self.max = value, min(self.min, value), max(self.max, value)
        if math.isnan(value):  # min and max would skip it
            self.min = self.max = value

    @property
    def mean(self) -> float:
        """Integral by time."""
        return self.integral / self._time


def prepare(settings: Mapping[str, Any]) -> Evaluate:
    """Instantiates the FMU and checks all names. `settings`: see `drivecal.adapters.kinds`."""
    section = settings["section"]
    measures = {name: reduction_of(text) for name, text in section["measures"].items()}
    duration, step, seed = section["duration"], section["step"], section["seed"]
    fmu = Fmu(Path(settings["file"]), Path(settings["unpacked"]))
    fmu.check((output for _, output in measures.values()), "measured output")
    fmu.check(settings["data"], "name in the scenario's data")
    fmu.check([] if seed is None else [seed], "seed")
    recorded = [name for name in settings["series"] if name in fmu.variables]
    reader = fmu.reader(dict.fromkeys([*(output for _, output in measures.values()), *recorded]))
    steps = max(1, math.ceil(duration / step - 1e-9))
    rest = duration - (steps - 1) * step
    last = step if rest > step * (1 - 1e-9) else rest  # many FMUs want one size, and a rest is short of it by rounding
    stop = max(duration, (steps - 1) * step + last)

    def evaluate(request: Mapping[str, Any]) -> Mapping[str, Any]:
        fmu.check(request["parameters"], "parameter")
        try:
            seeded = {} if seed is None else {seed: request["seed"]}
            fmu.begin({**settings["data"], **request["parameters"], **seeded}, stop)
            values = reader.read()
            statistics = [OutputStatistics(value) for value in values]
            rows = [values]
            for number in range(steps):
                length = step if number < steps - 1 else last
                fmu.step(number * step, length)
                values = reader.read()
                for entry, value in zip(statistics, values, strict=True):
                    entry.add(value, length)
                if "series" in request:
                    rows.append(values)
        except Exception as error:
            end_if_fatal(error)
            raise
        results = dict(zip(reader.names, statistics, strict=True))
        answer = {"measures": {name: getattr(results[output], key) for name, (key, output) in measures.items()}}
        if "series" in request:
            columns = dict(zip(reader.names, zip(*rows, strict=True), strict=True))
            answer["series"] = {name: columns[name] for name in recorded}
            if "time" in settings["series"] and "time" not in recorded:
                answer["series"]["time"] = [min(number * step, duration) for number in range(steps + 1)]
        return answer

    return evaluate


def end_if_fatal(error: BaseException) -> None:
    """Ends the process after an FMU's fatal error, after which none of its functions may be called."""
    if getattr(error, "status", None) == FATAL:
        print(described(error), file=sys.stderr, flush=True)  # noqa: T201  # the cause of the crash
        os._exit(1)


if __name__ == "__main__":
    serve(prepare)
