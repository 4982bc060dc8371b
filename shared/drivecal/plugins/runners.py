"""The port of the simulator behind driving functions: a session of a worker makes a runner for each setup.

An object behind the entry point group `drivecal.simulators`. Like every plug-in it is light: only `load` and `runner` import the
simulator, so that a worker chooses the folder of compiled kernels first.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from drivecal.contracts.work import CertificateMemory, RecordedRun
from drivecal.domain.evaluations import RunResult
from drivecal.domain.scenarios import Scenario
from drivecal.plugins.ports import DrivingFunction, Evaluator, Named, Vehicle


class TimeSeries(Protocol):
    """Time series of a run."""

    def to_json(self) -> dict[str, Any]:
        """Returns plain data."""


class Runner(Protocol):
    """Simulates and rates parameter sets in one setup."""

    @property
    def parameters(self) -> Sequence[str]:
        """Names of the driving function's parameters in the order of `run`."""

    def run(self, parameters: Sequence[float]) -> RunResult:
        """Simulates and rates one parameter set."""

    def answer(self, parameters: Sequence[float], number: int, *, check: bool) -> RunResult:
        """Returns the result of `run`, without simulation if it would provably repeat an earlier run.

        A simulated run is recorded under `number`. `check`: simulate in any case.
        """

    def prove(self, parameters: Sequence[float]) -> int | None:
        """Returns the number of the run that these parameters would provably repeat, or None. Simulates nothing."""

    def trace(self, parameters: Sequence[float]) -> TimeSeries:
        """Runs the same simulation and returns its time series."""

    def learn(self, known: Sequence[RecordedRun]) -> None:
        """Records runs of other workers, and from now on keeps its own for `recorded`."""

    def recorded(self, most_bytes: int) -> tuple[RecordedRun, ...]:
        """Returns runs recorded since `learn`, best rating first."""

    def take_over(self, interrupted: Any) -> None:
        """Takes the recorded runs of a runner of the same setup that an exception interrupted, unless it interrupted their recording."""


class DriveSession(Protocol):
    """All runners of a process, which share the memory for certificates."""

    @property
    def remembered(self) -> CertificateMemory:
        """Memory for certificates in use."""

    def load(self) -> None:
        """Imports the simulator. Raises UnavailableError without it."""

    def runner(
        self, scenario: Scenario, function: DrivingFunction, vehicle: Vehicle, values: Mapping[str, float], evaluator: Evaluator
    ) -> Runner:
        """Creates the runner of a setup. `values`: the vehicle's parameters. Exceptions of the plug-ins propagate."""


class DriveSimulator(Named, Protocol):
    """The simulator that drives a scenario with a driving function and a vehicle."""

    @property
    def controllers(self) -> Mapping[str, str]:
        """Versions of its own controllers that problem bundles may name, by kind: digests of the code that decides what they drive."""

    def open(self, certificates_mb: int | None) -> DriveSession:
        """Opens the session of this process. `certificates_mb`: memory limit of certificates, by default a share of the machine's."""
