"""The built-in motorway as the simulator of driving functions. Light: libsumo and numba are imported by `load` and `runner` only."""

from collections.abc import Mapping
from importlib import import_module

from drivecal.domain.scenarios import Scenario
from drivecal.plugins.ports import DrivingFunction, Evaluator, Vehicle
from drivecal.plugins.runners import DriveSimulator, Runner


class Highway:
    """The closed loop of planner, vehicle and SUMO's traffic. A process can hold only one SUMO simulation."""

    name = "highway"

    def load(self) -> None:
        """Imports SUMO and the compiled kernels. Raises UnavailableError without SUMO."""
        import_module("drivecal.highway.drive.tasks")

    def runner(
        self, scenario: Scenario, function: DrivingFunction, vehicle: Vehicle, values: Mapping[str, float], evaluator: Evaluator
    ) -> Runner:
        """Creates the runner of a setup."""
        from drivecal.highway.drive.tasks import TaskRunner

        return TaskRunner(scenario, function, vehicle.create(values), evaluator)


HIGHWAY: DriveSimulator = Highway()
