"""Creation of runners from requests, with plug-ins of the registry and a check of their versions by the run fingerprint."""

from collections.abc import Sequence
from importlib import import_module
from typing import Any, Protocol

from drivecal.certification.memory import Memory
from drivecal.contracts.work import DriveRequest, RecordedRun
from drivecal.domain.errors import ConflictError, DrivecalError, InvalidInputError, Problem, UnavailableError
from drivecal.domain.evaluations import RunResult
from drivecal.domain.scenarios import Scenario
from drivecal.domain.setups import Setup
from drivecal.plugins import registry
from drivecal.plugins.ports import DrivingFunction, Evaluator, Vehicle
from drivecal.plugins.setups import setup_of


class RefusedError(DrivecalError):
    """This worker cannot run a setup with any parameters, because of its installation."""


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


def make_runner(request: DriveRequest, memory: Memory) -> Runner:
    """Creates the runner of a setup. `memory`: limits the decisions recorded for certificates.

    Raises RefusedError if a plug-in or the simulator is unusable, lacks shipped files, or differs in version from the coordinator's, whose
    results must not mix with others. Other exceptions from the creation of plug-ins propagate, because every worker would raise them.
    """
    try:
        installed = _find(request)
    except DrivecalError as error:
        raise RefusedError(str(error)) from error
    except Exception as error:  # a badly installed package may raise any exception
        raise RefusedError(f"a plug-in cannot be loaded: {type(error).__name__}: {error}") from error
    try:
        from drivecal.episode.certified import CertifiedRunner  # libsumo and numba, in workers only

        scenario, function, vehicle, evaluator = installed
        return CertifiedRunner(scenario, function, vehicle.create(request.vehicle_parameters), evaluator, memory)
    except UnavailableError as error:
        raise RefusedError(str(error)) from error


def _find(request: DriveRequest) -> tuple[Scenario, DrivingFunction, Vehicle, Evaluator]:
    import_module("drivecal.episode.runner")  # raises UnavailableError without a simulator
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
