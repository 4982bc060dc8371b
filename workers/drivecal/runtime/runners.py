"""From the names in a request to something that runs: plug-ins by the registry, versions compared by the run fingerprint."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from drivecal.contracts.work import SetupRequest
from drivecal.domain.errors import ConflictError, InvalidInputError, Problem
from drivecal.domain.evaluations import RunResult
from drivecal.domain.setups import Setup
from drivecal.plugins import registry
from drivecal.plugins.setups import setup_of


class Runner(Protocol):
    """Simulates and rates one parameter set after the other in one setup."""

    @property
    def parameters(self) -> Sequence[str]:
        """The names of the driving function's parameters in the order that `run` expects."""

    def run(self, parameters: Sequence[float]) -> RunResult:
        """One run."""

    def trace(self, parameters: Sequence[float]) -> dict[str, Any]:
        """The same run with its time series, as plain data."""


class _EpisodeRunner:
    def __init__(self, request: SetupRequest) -> None:
        from drivecal.episode.runner import Runner as Episode  # libsumo and numba, in workers only

        catalogue = registry.catalogue(request.catalogue)
        if request.scenario not in catalogue.scenarios:
            remedy = f"it has {', '.join(catalogue.scenarios)}"
            raise InvalidInputError(
                Problem("scenario", f"the worker's catalogue {catalogue.name} has no {request.scenario!r}", remedy)
            )
        scenario = catalogue.scenarios[request.scenario]
        function = registry.driving_function(request.driving_function)
        vehicle = registry.vehicle(request.vehicle)
        refuse_other_versions(request, setup_of(scenario, function, vehicle, request.vehicle_parameters))
        self.parameters = tuple(parameter.name for parameter in next(iter(function.spaces.values())))
        model = vehicle.create(request.vehicle_parameters)
        self._episode = Episode(scenario, function, model, registry.evaluator(request.evaluator))

    def run(self, parameters: Sequence[float]) -> RunResult:
        return self._episode.run(parameters)

    def trace(self, parameters: Sequence[float]) -> dict[str, Any]:
        return self._episode.trace(parameters).to_json()


def make_runner(request: SetupRequest) -> Runner:
    """The runner of a setup.

    Raises InvalidInputError where a plug-in is not installed here, ConflictError where one is, but in another version than the
    coordinator's: results of both must not mix.
    """
    return _EpisodeRunner(request)


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
