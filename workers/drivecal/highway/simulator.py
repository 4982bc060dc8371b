"""The simulator of scenarios with a task, driven by drivecal's own closed loop in this process. Sessions import libsumo and numba."""

from collections.abc import Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivecal.bundles.fingerprints import model_of
from drivecal.bundles.highway import Scenario
from drivecal.domain.errors import InvalidInputError, UnavailableError, describe
from drivecal.domain.evaluations import Breakdown
from drivecal.domain.values import Argument
from drivecal.highway.scenarios import scenario_of
from drivecal.plugins import registry
from drivecal.plugins.ports import SeriesEvaluator
from drivecal.plugins.simulators import (
    SEED,
    VERSIONS,
    Declared,
    InstalledSimulator,
    NoMeasuresError,
    RunOutcome,
    SimulatorSession,
    UnsuitableError,
)

if TYPE_CHECKING:
    from drivecal.highway.drive.tasks import TaskRunner


class TaskSession:
    """Runs of an installed driving function and an installed vehicle in one scenario. Sessions share the simulation of this process."""

    def __init__(self, scenario: Scenario, section: Mapping[str, Any], declared: Declared) -> None:
        """Finds the plug-ins. Raises InvalidInputError if one is not installed."""
        self._scenario, self._random = scenario, section["random"]
        self._function = registry.driving_function(section["controller"]["driving_function"])
        self._fixed: Mapping[str, float] = section["controller"].get("values") or {}
        own = section["vehicle"]
        self._vehicle = registry.vehicle(model_of(own))
        nominal = {parameter.name: parameter.nominal for parameter in self._vehicle.parameters}
        changes = {} if isinstance(own, str) else {name: own[name] for name in nominal if own.get(name) is not None}
        self._values = {**nominal, **changes, **declared.varied}
        evaluator = None if declared.evaluator is None else registry.evaluator(declared.evaluator)
        self._evaluator = evaluator if isinstance(evaluator, SeriesEvaluator) else None
        self._runner: TaskRunner | None = None

    def evaluate(self, parameters: Mapping[str, Argument], *, series: bool = False, seed: int = SEED) -> RunOutcome:
        """Runs one parameter set. A scenario that is not random keeps its own seed instead of the first one.

        Raises NoMeasuresError for all exceptions of plug-ins, and UnavailableError if a plug-in says that this machine cannot run it.
        """
        from drivecal.highway.drive.tasks import TaskRunner

        try:
            scenario = replace(self._scenario, seed=seed) if self._random or seed != SEED else self._scenario
            if self._runner is None:
                self._runner = TaskRunner(scenario, self._function, self._vehicle.create(self._values), self._evaluator)
            self._runner.seed(scenario.seed)
            given = {**self._fixed, **parameters}
            values: list[Any] = [given[name] for name in self._runner.parameters]
            return self._runner.run([value if isinstance(value, str) else float(value) for value in values], series=series)
        except UnavailableError:
            self._runner = None  # its seed and its traffic may be of two runs
            raise
        except (Exception, SystemExit) as error:  # a plug-in may raise any exception; the worker must survive
            self._runner = None  # it may be in any state
            cause = Breakdown.MEMORY if isinstance(error, MemoryError) else Breakdown.ERROR
            raise NoMeasuresError(cause, describe(error), is_contained=False) from error

    def close(self) -> None:
        """Leaves the simulation of the process to the next session."""
        self._runner = None


class Highway:
    """The closed loop of planner, vehicle and SUMO's traffic. A process can hold only one SUMO simulation."""

    name = "highway"
    version = VERSIONS["highway"]

    def open(
        self, section: Mapping[str, Any], scenario: str, data: Mapping[str, Any], folder: Path, declared: Declared
    ) -> SimulatorSession:
        """Opens a session. Raises UnavailableError without SUMO, and UnsuitableError if the scenario's network cannot be driven."""
        import_module("drivecal.highway.drive.tasks")  # without SUMO this fails before the road is measured
        try:
            opened = scenario_of(scenario, data, folder)
            _ = opened.road  # measured for the runs, or refused
            return TaskSession(opened, section, declared)
        except InvalidInputError as error:
            raise UnsuitableError(str(error)) from error


HIGHWAY: InstalledSimulator = Highway()
