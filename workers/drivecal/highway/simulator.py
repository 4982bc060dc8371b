"""The built-in motorway as the simulator of driving functions. Light: libsumo and numba are imported by `load` and `runner` only."""

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType

from drivecal.contracts.work import CertificateMemory
from drivecal.domain.scenarios import Scenario
from drivecal.highway.certification.memory import Memory
from drivecal.highway.planner.frenet import corridor_version
from drivecal.plugins.ports import DrivingFunction, Evaluator, Vehicle
from drivecal.plugins.runners import DriveSession, DriveSimulator, Runner


class HighwaySession:
    """Runners of one process, whose certificates share one memory."""

    def __init__(self, certificates_mb: int | None) -> None:
        self._memory = Memory(certificates_mb)

    @property
    def remembered(self) -> CertificateMemory:
        """States and bytes of all runners, and their limit."""
        return CertificateMemory(self._memory.states, self._memory.bytes, self._memory.limit)

    def load(self) -> None:
        """Imports SUMO and the compiled kernels. Raises UnavailableError without SUMO."""
        import_module("drivecal.highway.episode.runner")

    def runner(
        self, scenario: Scenario, function: DrivingFunction, vehicle: Vehicle, values: Mapping[str, float], evaluator: Evaluator
    ) -> Runner:
        """Creates the runner of a setup, which records decisions if its driving function can be certified."""
        from drivecal.highway.episode.certified import CertifiedRunner

        return CertifiedRunner(scenario, function, vehicle.create(values), evaluator, self._memory)


class Highway:
    """The closed loop of planner, vehicle and SUMO's traffic."""

    name = "highway"
    controllers: Mapping[str, str] = MappingProxyType({"planner": corridor_version()})

    def open(self, certificates_mb: int | None) -> DriveSession:
        """Opens a session of this process, which can hold only one SUMO simulation."""
        return HighwaySession(certificates_mb)


HIGHWAY: DriveSimulator = Highway()
