"""The bench of a campaign: everything except the parameter set that decides its results."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from math import isfinite, nan
from typing import Protocol

from drivecal.contracts.work import DriveRequest, SetupRequest
from drivecal.domain.errors import ConflictError
from drivecal.domain.evaluations import Rating
from drivecal.domain.parameters import Parameter
from drivecal.domain.scales import COMFORT, Scale
from drivecal.domain.scenarios import Scenario
from drivecal.domain.setups import DrivenSetup, Setup
from drivecal.plugins.ports import DrivingFunction, Evaluator, SeriesEvaluator, Vehicle
from drivecal.plugins.setups import setup_of


class Bench(Protocol):
    """Scenarios with their simulator, and the score of their results."""

    @property
    def function(self) -> str:
        """Name of the function under test, for which influence maps hold."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters with their usual ranges, in the function's order."""

    @property
    def scenarios(self) -> Collection[str]:
        """Ids of the scenarios, in order."""

    @property
    def setups(self) -> Mapping[str, Setup]:
        """Setups by scenario."""

    @property
    def requests(self) -> Mapping[str, SetupRequest]:
        """Run requests to workers by scenario."""

    @property
    def to_probe(self) -> SetupRequest | None:
        """A request by which a worker finds what is missing in the setups: the answer of the problem's `probe`. None if nothing is."""

    @property
    def evaluator_id(self) -> str:
        """Name and version of the score: with the run fingerprint it names a rating."""

    @property
    def scale(self) -> Scale:
        """Scale of the scores."""

    @property
    def needs_series(self) -> bool:
        """Whether stored runs lack the time series that a score needs."""

    @property
    def rates(self) -> bool:
        """Whether the coordinator rates the results of workers; otherwise workers do."""

    @property
    def repeated_share(self) -> float | None:
        """Share of simulated cells that run twice, because nothing says that the simulator is deterministic; None for none."""

    def rate(self, scenario: str, metrics: Mapping[str, float | None], failure: str | None) -> Rating | None:
        """Rates a run by what is stored of it; None if it lacks a metric. A metric is None if it was not finite."""


@dataclass(frozen=True)
class DrivingBench:
    """A driving function in a vehicle, driven by workers in scenarios of catalogues and rated there by an evaluator."""

    catalogued: Mapping[str, tuple[str, Scenario]]
    """By scenario id, in the catalogue's order: (catalogue's name, scenario)."""
    driving_function: DrivingFunction
    vehicle: Vehicle
    vehicle_parameters: Mapping[str, float]
    evaluator: Evaluator

    def __post_init__(self) -> None:
        """Raises UnavailableError if a plug-in lacks a shipped file, which reading its version reveals."""
        self.driving_function.version, self.vehicle.version, self.evaluator.version  # noqa: B018  reading is what may fail

    @property
    def function(self) -> str:
        """Name of the driving function."""
        return self.driving_function.name

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The driving function's first space."""
        return next(iter(self.driving_function.spaces.values()))

    @property
    def scenarios(self) -> Collection[str]:
        """Ids of the scenarios, in the catalogue's order."""
        return self.catalogued.keys()

    @cached_property
    def setups(self) -> dict[str, DrivenSetup]:
        """Setups by scenario."""
        return {
            name: setup_of(scenario, self.driving_function, self.vehicle, self.vehicle_parameters)
            for name, (_, scenario) in self.catalogued.items()
        }

    @cached_property
    def requests(self) -> dict[str, DriveRequest]:
        """Run requests to workers by scenario."""
        return {
            name: DriveRequest(
                catalogue=catalogue,
                scenario=name,
                driving_function=self.driving_function.name,
                vehicle=self.vehicle.name,
                vehicle_parameters=self.setups[name].vehicle_parameters,
                evaluator=self.evaluator.name,
                evaluator_version=self.evaluator.version,
                run_fingerprint=self.setups[name].fingerprint,
                document=self.setups[name].document,
            )
            for name, (catalogue, _) in self.catalogued.items()
        }

    @property
    def to_probe(self) -> None:
        """Nothing: plug-ins and the simulator have versions."""
        return

    @property
    def evaluator_id(self) -> str:
        """Name and version of the evaluator."""
        return evaluator_id(self.evaluator)

    @property
    def scale(self) -> Scale:
        """Scale of the comfort score."""
        return COMFORT

    @property
    def needs_series(self) -> bool:
        """Whether the evaluator rates time series, which are not stored."""
        return isinstance(self.evaluator, SeriesEvaluator)

    @property
    def rates(self) -> bool:
        """Workers rate, because evaluators may need time series."""
        return False

    @property
    def repeated_share(self) -> float | None:
        """None: the closed loop is deterministic."""
        return None

    def rate(self, scenario: str, metrics: Mapping[str, float | None], failure: str | None) -> Rating | None:
        """Rates a run by its metrics; a failed run scores 0 with every evaluator."""
        scale = self.scale
        if failure is not None:
            return Rating(scale.failed, scale.failed)
        known = {name: nan if value is None else value for name, value in metrics.items()}
        try:
            rating = self.evaluator.rate(self.catalogued[scenario][1].rated_as, known)
        except (KeyError, ValueError):  # a metric that was not measured then, or not finite
            return None
        return Rating(scale.worth(rating.rating), scale.worth(rating.score)) if isfinite(rating.rating) else None


def driving(bench: Bench) -> DrivingBench:
    """Returns a bench with a vehicle. Raises ConflictError for another one, for which nothing about vehicles can be asked."""
    if not isinstance(bench, DrivingBench):
        raise ConflictError(f"{bench.function} has no vehicle parameters")
    return bench


def evaluator_id(evaluator: Evaluator) -> str:
    """Name and version of an evaluator, under which ratings are stored."""
    return f"{evaluator.name} {evaluator.version}"
