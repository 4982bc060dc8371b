"""Vehicles of users: a Python class, an FMU. The trackers of the built-in vehicle command each every 0.01 s."""

import copy
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from drivecal.adapters.driver import described
from drivecal.adapters.fmu_driver import Fmu
from drivecal.bundles.highway_catalogue import COMMANDS, VEHICLE_INPUTS, VEHICLE_STATES
from drivecal.domain.errors import DrivecalError
from drivecal.domain.roads import Floats
from drivecal.highway.drive.controllers import end_if_fatal, function_of
from drivecal.highway.vehicle import kernels
from drivecal.highway.vehicle.equations import ADHESION_LIMIT, STEP
from drivecal.highway.vehicle.model import SingleTrackModel
from drivecal.highway.vehicle.parameters import SingleTrackParameters

UNITS = {name: quantity.unit for name, quantity in {**COMMANDS, **VEHICLE_STATES}.items()} | {"start_speed": "m/s"}
"""Units of a vehicle's inputs, states and start speed."""
JUMP, TURN, SURGE = 1.0, 0.2, 1.0
"""Largest differences (m, rad, m/s) of the state after the first step from a steady drive."""
STRONGEST = 20.0
"""Acceleration (m/s²) that a vehicle may have besides."""
_NO_PATH: Floats = np.zeros((2, 7))


class PlantError(DrivecalError):
    """A vehicle of the user's raised an exception, ended, or gave something else than its state."""


class Plant(Protocol):
    """A vehicle in its own coordinates: it starts at the origin, along the x axis."""

    def begin(self, parameters: Mapping[str, Any], speed: float) -> None:
        """Starts a run at a speed (m/s)."""

    def step(self, steering: float, acceleration: float) -> Sequence[Any]:
        """Returns the state after 0.01 s, in the order of the manifest's `state`."""


class ClassPlant(Plant):
    """A class that is made for each run of parameters, scenario and start speed, with `step(steering, acceleration, dt)`."""

    def __init__(self, target: Any, state: Sequence[str], scenario: Mapping[str, Any]) -> None:
        self._target, self._state, self._scenario = target, list(state), scenario
        self._step: Any = None

    def begin(self, parameters: Mapping[str, Any], speed: float) -> None:
        self._step = self._target(dict(parameters), copy.deepcopy(dict(self._scenario)), speed).step

    def step(self, steering: float, acceleration: float) -> Sequence[Any]:
        answer = self._step(steering, acceleration, STEP)
        if isinstance(answer, Mapping):
            return [answer[name] for name in self._state]
        return list(answer)


class FmuPlant(Plant):
    """An FMU for co-simulation, which is reset for each run. Its inputs hold for a step, at whose end its outputs are read."""

    def __init__(self, file: Path, unpacked: Path, section: Mapping[str, Any], units: Mapping[str, str] | None = None) -> None:
        """`section` is the manifest's; `units` are the parameters' by name. Raises UnusableError."""
        signals, state = section["signals"], section["state"]
        self._fmu = Fmu(file, unpacked)
        self._fmu.check(signals.values(), "name in `signals`")
        self._fmu.check_units((variable, UNITS[name]) for name, variable in signals.items())
        self._fmu.check_section("simulator.vehicle", section, units or {})
        self._start = signals["start_speed"]
        self._constants: Mapping[str, Any] = section.get("constants") or {}
        inputs = {signals[name]: index for index, name in enumerate(VEHICLE_INPUTS)}
        self._writer = self._fmu.writer(inputs)
        self._indices = [inputs[name] for name in self._writer.names]
        self._reader = self._fmu.reader(dict.fromkeys(signals[name] for name in state))
        self._order = [self._reader.names.index(signals[name]) for name in state]
        self._count = 0

    def begin(self, parameters: Mapping[str, Any], speed: float) -> None:
        known = {name: value for name, value in parameters.items() if name in self._fmu.variables}
        self._fmu.begin({**self._constants, **known, self._start: speed}, None)
        self._count = 0

    def step(self, steering: float, acceleration: float) -> Sequence[Any]:
        inputs = (steering, acceleration)
        self._writer.write([inputs[index] for index in self._indices])
        self._fmu.step(self._count * STEP, STEP)
        self._count += 1
        values = self._reader.read()
        return [values[index] for index in self._order]


def prepare_trackers(model: SingleTrackModel) -> None:
    """Compiles or loads the trackers of users' plants, which would take seconds of the first run."""
    state, _, controller = model.arrays
    kernels.commands(state, controller, kernels.STEERING, 0.0, 0.0, _NO_PATH, 0.0)


class UserVehicleModel(SingleTrackModel):
    """A plant of the user's behind the built-in trackers, which assume the single-track model of these `parameters`."""

    def __init__(self, plant: Plant, state: Sequence[str], parameters: SingleTrackParameters) -> None:
        super().__init__(parameters, parameters)
        self.plant, self._names = plant, tuple(state)
        self._origin = (0.0, 0.0, 0.0)
        self._first: float | None = None
        self._begun: tuple[Mapping[str, Any]] | None = None

    def begin(self, parameters: Mapping[str, Any]) -> None:
        """Sets the parameters of later runs."""
        self._begun = (parameters,)

    def start(self, x: float, y: float, heading: float, speed: float) -> None:
        super().start(x, y, heading, speed)
        self._origin, self._first = (x, y, heading), speed
        if self._begun is not None:
            self._guarded("does not start", self.plant.begin, self._begun[0], speed)

    def follow(self, trajectory: Floats, since: float, duration: float, dynamics: Floats) -> bool:
        del duration  # the rows of `dynamics` say it
        return self.drive(kernels.TRAJECTORY, 0.0, 0.0, trajectory, since, dynamics)

    def drive(self, by: int, lateral: float, acceleration: float, path: Floats, since: float, dynamics: Floats) -> bool:
        if self._begun is None:  # nothing is driven before the first run
            return True
        state = self._state
        for row in range(len(dynamics)):
            steering, wanted = kernels.commands(state, self._controller, by, lateral, acceleration, path, since + row * STEP)
            values = self._guarded("failed", self.plant.step, steering, wanted)
            stable = self._take(values, steering)
            dynamics[row] = state[3], state[6], state[7], state[5], state[8]
            if not stable:
                dynamics[row:] = dynamics[row]
                return False
        return True

    def _take(self, values: Sequence[Any], steering: float) -> bool:
        """Writes the plant's state into the vehicle's; returns whether it is stable. Raises PlantError."""
        if len(values) != len(self._names):
            raise PlantError(f"the vehicle gave {len(values)} values, not {', '.join(self._names)}")
        try:
            given = {name: float(value) for name, value in zip(self._names, values, strict=True)}
        except (TypeError, ValueError, OverflowError):
            raise PlantError(f"the vehicle gave {values!r:.200}; its state must be numbers") from None
        if not all(map(math.isfinite, given.values())):
            raise PlantError(f"the vehicle gave {given!r:.200}; its state must be finite")
        if self._first is not None:
            _check_begun(given, self._first)
            self._first = None
        state, (x, y, turned) = self._state, self._origin
        speed = given["speed"]
        change = math.remainder(turned + given["heading"] - state.item(2), math.tau)  # headings may jump by whole turns
        heading, yaw_rate = state.item(2) + change, given.get("yaw_rate", change / STEP)
        forward = given.get("longitudinal_acceleration", (speed - state.item(3)) / STEP)
        cosine, sine = math.cos(turned), math.sin(turned)
        state[:9] = (
            x + cosine * given["x"] - sine * given["y"],
            y + sine * given["x"] + cosine * given["y"],
            heading,
            speed,
            given.get("side_slip", 0.0),
            yaw_rate,
            forward,
            given.get("lateral_acceleration", speed * yaw_rate),
            given.get("steering_angle", steering),
        )
        return bool(abs(state[7]) <= ADHESION_LIMIT and np.abs(state[:4]).sum() < 1e9)

    def _guarded(self, what: str, call: Any, *arguments: Any) -> Any:
        try:
            return call(*arguments)
        except (MemoryError, DrivecalError):
            raise
        except (Exception, SystemExit) as error:
            end_if_fatal(error)
            raise PlantError(f"the vehicle {what}: {described(error)}") from error


def _check_begun(given: Mapping[str, float], speed: float) -> None:
    """Raises PlantError if the state after the first step does not follow from the origin and the start speed."""
    is_there = math.hypot(given["x"] - speed * STEP, given["y"]) <= JUMP
    is_along = abs(math.remainder(given["heading"], math.tau)) <= TURN
    if not is_there or not is_along or abs(given["speed"] - speed) > SURGE + STRONGEST * STEP:
        state = ", ".join(f"{name} = {given[name]:g}" for name in ("x", "y", "heading", "speed"))
        raise PlantError(
            f"the vehicle gave {state} after its first step; it starts at x = 0, y = 0, heading = 0, speed = {speed:g} (m, rad, m/s): "
            "take over the start speed, and give the state from there"
        )


def plant_of(
    section: Mapping[str, Any], folder: Path, scratch: Path, scenario: Mapping[str, Any], units: Mapping[str, str]
) -> Plant:
    """Returns the plant of a manifest's section. Raises any exception of the user's file, UnusableError of FMUs.

    Args:
        section: the manifest's section.
        folder: the bundle's folder.
        scratch: folder for unpacked files.
        scenario: the scenario's data.
        units: units of the problem's parameters by name.
    """
    if section["kind"] == "python":
        return ClassPlant(function_of(section, folder, scratch / "vehicle"), section["state"], scenario)
    return FmuPlant(folder / section["file"], scratch / "vehicle-fmu", section, units)
