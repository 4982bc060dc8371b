"""The port of the simulator behind driving functions: it makes a runner for each setup.

An object behind the entry point group `drivecal.simulators`. Like every plug-in it is light: only `load` and `runner` import the
simulator, so that a worker chooses the folder of compiled kernels first.
"""

from collections.abc import Mapping, Sequence
from typing import Protocol

from drivecal.contracts.evaluation import SeriesAnswer
from drivecal.domain.evaluations import RunResult
from drivecal.domain.scenarios import Scenario
from drivecal.plugins.ports import DrivingFunction, Evaluator, Named, Vehicle


class Runner(Protocol):
    """Simulates and rates parameter sets in one setup."""

    @property
    def parameters(self) -> Sequence[str]:
        """Names of the driving function's parameters in the order of `run`."""

    def run(self, parameters: Sequence[float]) -> RunResult:
        """Simulates and rates one parameter set."""

    def trace(self, parameters: Sequence[float]) -> tuple[RunResult, SeriesAnswer]:
        """Runs the same simulation, and returns its time series as well."""


class DriveSimulator(Named, Protocol):
    """The simulator that drives a scenario with a driving function and a vehicle."""

    def load(self) -> None:
        """Imports the simulator. Raises UnavailableError without it."""

    def runner(
        self, scenario: Scenario, function: DrivingFunction, vehicle: Vehicle, values: Mapping[str, float], evaluator: Evaluator
    ) -> Runner:
        """Creates the runner of a setup. `values`: the vehicle's parameters. Exceptions of the plug-ins propagate."""
