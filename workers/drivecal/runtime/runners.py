"""From the names in a request to something that runs: plug-ins by the registry, versions compared by the run fingerprint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol

from drivecal.certification.memory import Memory
from drivecal.contracts.work import SetupRequest
from drivecal.domain.errors import ConflictError, DrivecalError, InvalidInputError, Problem, UnavailableError
from drivecal.domain.evaluations import Answered, RunResult
from drivecal.domain.scenarios import Scenario
from drivecal.domain.setups import Setup
from drivecal.plugins import registry
from drivecal.plugins.ports import DrivingFunction, Evaluator, Vehicle
from drivecal.plugins.setups import setup_of


class RefusedError(DrivecalError):
    """This worker cannot run a setup, whatever the parameters: its installation is to blame, no cell is."""


class Runner(Protocol):
    """Simulates and rates one parameter set after the other in one setup."""

    @property
    def parameters(self) -> Sequence[str]:
        """The names of the driving function's parameters in the order that `run` expects."""

    def run(self, parameters: Sequence[float]) -> RunResult:
        """One run."""

    def answer(self, parameters: Sequence[float], number: int, *, check: bool) -> Answered:
        """As `run`, or without one where it would provably repeat an earlier one; `number`: under which it is known to later ones;
        `check`: simulated in any case."""

    def prove(self, parameters: Sequence[float]) -> int | None:
        """The number of the run that these parameters would provably repeat; None where that is not known. Nothing is simulated."""

    def trace(self, parameters: Sequence[float]) -> dict[str, Any]:
        """The same run with its time series, as plain data."""


@dataclass(frozen=True, slots=True)
class _Installed:
    scenario: Scenario
    function: DrivingFunction
    vehicle: Vehicle
    evaluator: Evaluator


class _EpisodeRunner:
    def __init__(self, request: SetupRequest, installed: _Installed, memory: Memory) -> None:
        from drivecal.episode.certified import CertifiedRunner as Episode  # libsumo and numba, in workers only

        self.parameters = tuple(parameter.name for parameter in next(iter(installed.function.spaces.values())))
        model = installed.vehicle.create(request.vehicle_parameters)
        self._episode = Episode(installed.scenario, installed.function, model, installed.evaluator, memory)

    def run(self, parameters: Sequence[float]) -> RunResult:
        return self._episode.run(parameters)

    def answer(self, parameters: Sequence[float], number: int, *, check: bool) -> Answered:
        return self._episode.answer(parameters, number, check=check)

    def prove(self, parameters: Sequence[float]) -> int | None:
        return self._episode.prove(parameters)

    def trace(self, parameters: Sequence[float]) -> dict[str, Any]:
        return self._episode.trace(parameters).to_json()


def make_runner(request: SetupRequest, memory: Memory) -> Runner:
    """The runner of a setup; `memory` is for what it remembers to certify other runs.

    Raises RefusedError where a plug-in or the simulator is not usable here, or is another version than the coordinator's (results of
    both must not mix), or lacks what it was shipped with. What else the plug-ins raise while they are put together goes through: another
    worker's would raise it, too.
    """
    try:
        installed = _find(request)
    except DrivecalError as error:
        raise RefusedError(str(error)) from error
    except Exception as error:  # what a package may raise that is installed badly
        raise RefusedError(f"a plug-in cannot be loaded: {type(error).__name__}: {error}") from error
    try:
        return _EpisodeRunner(request, installed, memory)
    except UnavailableError as error:
        raise RefusedError(str(error)) from error


def _find(request: SetupRequest) -> _Installed:
    import_module("drivecal.episode.runner")  # raises UnavailableError where there is no simulator
    catalogue = registry.catalogue(request.catalogue)
    if request.scenario not in catalogue.scenarios:
        remedy = f"it has {', '.join(catalogue.scenarios)}"
        raise InvalidInputError(
            Problem("scenario", f"the worker's catalogue {catalogue.name} has no {request.scenario!r}", remedy)
        )
    scenario = catalogue.scenarios[request.scenario]
    function, vehicle = registry.driving_function(request.driving_function), registry.vehicle(request.vehicle)
    refuse_other_versions(request, setup_of(scenario, function, vehicle, request.vehicle_parameters))
    evaluator = registry.evaluator(request.evaluator)
    refuse_other_evaluators(request, evaluator)
    return _Installed(scenario, function, vehicle, evaluator)


def refuse_other_evaluators(request: SetupRequest, installed: Evaluator) -> None:
    """Raises ConflictError with both versions where the worker would rate by another one than was asked for; reading its version, an
    evaluator finds out whether it has what it was shipped with."""
    version, wanted = installed.version, request.evaluator_version
    if wanted not in {None, version}:
        raise ConflictError(
            f"coordinator and worker differ: the evaluator {installed.name} is {wanted} at the coordinator and {version} at the worker;"
            " install the same drivecal and plug-ins on both"
        )


def refuse_other_versions(request: SetupRequest, installed: Setup) -> None:
    """Raises ConflictError naming what differs, with both values, where the worker would run something else than was asked for."""
    if installed.fingerprint == request.run_fingerprint:
        return
    differences = [
        f"{name} is {request.document[name]} at the coordinator and {here} at the worker"
        for name, here in installed.document.items()
        if name in request.document and request.document[name] != here
    ]
    if not differences:
        differences = [f"run fingerprint {request.run_fingerprint} was asked for, the worker has {installed.fingerprint}"]
    raise ConflictError(
        f"coordinator and worker differ: {'; '.join(differences)}; install the same drivecal and plug-ins on both"
    )
