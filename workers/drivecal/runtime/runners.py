"""Creation of runners from requests, with plug-ins of the registry and a check of their versions by the run fingerprint."""

from drivecal.contracts.work import DriveRequest
from drivecal.domain.errors import ConflictError, DrivecalError, InvalidInputError, Problem, UnavailableError
from drivecal.domain.scenarios import Scenario
from drivecal.domain.setups import Setup
from drivecal.plugins import registry
from drivecal.plugins.ports import DrivingFunction, Evaluator, Vehicle
from drivecal.plugins.runners import DriveSimulator, Runner
from drivecal.plugins.setups import setup_of


class RefusedError(DrivecalError):
    """This worker cannot run a setup with any parameters, because of its installation."""


def make_runner(request: DriveRequest) -> Runner:
    """Creates the runner of a setup.

    Raises RefusedError if a plug-in or the simulator is unusable, lacks shipped files, or differs in version from the coordinator's, whose
    results must not mix with others. Other exceptions from the creation of plug-ins propagate, because every worker would raise them.
    """
    simulator = registry.simulator("highway")
    try:
        installed = _find(request, simulator)
    except DrivecalError as error:
        raise RefusedError(str(error)) from error
    except Exception as error:  # a badly installed package may raise any exception
        raise RefusedError(f"a plug-in cannot be loaded: {type(error).__name__}: {error}") from error
    try:
        scenario, function, vehicle, evaluator = installed
        return simulator.runner(scenario, function, vehicle, request.vehicle_parameters, evaluator)
    except UnavailableError as error:
        raise RefusedError(str(error)) from error


def _find(request: DriveRequest, simulator: DriveSimulator) -> tuple[Scenario, DrivingFunction, Vehicle, Evaluator]:
    simulator.load()
    catalogue = registry.catalogue(request.catalogue)
    if request.scenario not in catalogue.scenarios:
        remedy = f"it has {', '.join(catalogue.scenarios)}"
        message = f"the worker's catalogue {catalogue.name} has no {request.scenario!r}"
        raise InvalidInputError(Problem("scenario", message, remedy))
    scenario = catalogue.scenarios[request.scenario]
    function, vehicle = registry.driving_function(request.driving_function), registry.vehicle(request.vehicle)
    refuse_other_versions(request, setup_of(scenario, function, vehicle, request.vehicle_parameters))
    evaluator = registry.evaluator(request.evaluator)
    refuse_other_evaluators(request, evaluator)
    return scenario, function, vehicle, evaluator


def refuse_other_evaluators(request: DriveRequest, installed: Evaluator) -> None:
    """Raises ConflictError naming both versions if the worker's evaluator differs from the request.

    Reading the version also makes an evaluator check its shipped files.
    """
    version, requested = installed.version, request.evaluator_version
    if requested not in {None, version}:
        raise ConflictError(
            f"coordinator and worker differ: the evaluator {installed.name} is {requested} at the coordinator and {version} at the worker;"
            " install the same drivecal and plug-ins on both"
        )


def refuse_other_versions(request: DriveRequest, installed: Setup) -> None:
    """Raises ConflictError naming each difference with both values if the worker's setup differs from the request."""
    if installed.fingerprint == request.run_fingerprint:
        return
    differences = [
        f"{name} is {request.document[name]} at the coordinator and {here} at the worker"
        for name, here in installed.document.items()
        if name in request.document and request.document[name] != here
    ]
    if not differences:
        differences = [
            f"the run fingerprint is {request.run_fingerprint} in the request and {installed.fingerprint} at the worker"
        ]
    raise ConflictError(
        f"coordinator and worker differ: {'; '.join(differences)}; install the same drivecal and plug-ins on both"
    )
