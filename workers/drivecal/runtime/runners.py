"""Runners of scenarios that drivecal's own closed loop drives in this process, with installed plug-ins of the coordinator's versions."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from drivecal.bundles.fingerprints import model_of
from drivecal.bundles.highway import TaskScenario
from drivecal.contracts.work import SetupRequest
from drivecal.domain.errors import ConflictError, DrivecalError, UnavailableError
from drivecal.domain.evaluations import Rating
from drivecal.domain.scenarios import Scenario
from drivecal.plugins import registry
from drivecal.plugins.ports import DrivingFunction, Evaluator, Vehicle
from drivecal.plugins.runners import DriveSimulator, Runner
from drivecal.runtime.bundles import refuse_other_parts


class RefusedError(DrivecalError):
    """This worker cannot run a setup with any parameters, because of its installation."""


class Unrated:
    """The evaluator of runs that the coordinator rates."""

    name = "unrated"
    version = "1"

    def rate(self, rated_as: str, metrics: Mapping[str, float]) -> Rating:
        """Returns a rating without a meaning."""
        del rated_as, metrics
        return Rating(0.0, 0.0)


def make_runner(request: SetupRequest, folder: Path) -> Runner:
    """Creates the runner of a setup.

    Args:
        request: the setup.
        folder: the problem's files.

    Raises:
        RefusedError: a plug-in or the simulator is unusable, lacks shipped files, or differs in version from the coordinator's, whose
            results must not mix with others. Other exceptions from the creation of plug-ins propagate, because every worker would
            raise them.
    """
    simulator = registry.simulator("highway")
    try:
        installed = _find(request, folder, simulator)
    except DrivecalError as error:
        raise RefusedError(str(error)) from error
    except Exception as error:  # a badly installed package may raise any exception
        raise RefusedError(f"a plug-in cannot be loaded: {type(error).__name__}: {error}") from error
    try:
        scenario, function, vehicle, evaluator = installed
        return simulator.runner(scenario, function, vehicle, request.varied, evaluator)
    except UnavailableError as error:
        raise RefusedError(str(error)) from error


def _find(
    request: SetupRequest, folder: Path, simulator: DriveSimulator
) -> tuple[Scenario, DrivingFunction, Vehicle, Evaluator]:
    simulator.load()
    refuse_other_parts(request)
    section = request.simulator
    function = registry.driving_function(section["controller"]["driving_function"])
    vehicle = registry.vehicle(model_of(section["vehicle"]))
    evaluator: Evaluator = Unrated() if request.evaluator is None else registry.evaluator(request.evaluator)
    refuse_other_evaluators(request, evaluator)
    return scenario_of(request, folder), function, vehicle, evaluator


def scenario_of(request: SetupRequest, folder: Path) -> Scenario:
    """Returns the scenario of a request: of an installed catalogue, or of the problem's own data and files."""
    if "catalogue" in request.data:
        scenario = registry.catalogue(request.data["catalogue"]).scenarios[request.scenario]
    else:
        declared = TaskScenario.model_validate(request.data)
        scenario = declared.on(request.scenario, (folder / declared.network).read_bytes())
    return replace(scenario, seed=request.seed) if request.seed else scenario


def refuse_other_evaluators(request: SetupRequest, installed: Evaluator) -> None:
    """Raises ConflictError naming both versions if the worker's evaluator differs from the request.

    Reading the version also makes an evaluator check its shipped files.
    """
    version, requested = installed.version, request.evaluator_version
    if requested not in {None, version}:
        raise ConflictError(
            f"coordinator and worker differ: the evaluator {installed.name} is {requested} at the coordinator and {version} at the worker;"
            " install the same drivecal and plug-ins on both"
        )
