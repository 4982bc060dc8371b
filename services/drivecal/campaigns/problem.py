"""Resolves what a user submitted against what is installed: the one place that decides whether a campaign can run.

`POST /campaigns`, `?validate_only=true`, `submit --dry-run` and the dispatcher all go through here. Everything wrong with a
specification is reported at once, each with its field and what would be right.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from pydantic import BaseModel, ValidationError

from drivecal.analysis.robustness import check_nominal
from drivecal.campaigns.findings import Findings
from drivecal.campaigns.spaces import free_values, given_set, search_space, space_to_document
from drivecal.contracts.campaign import ExpectedRuns
from drivecal.contracts.specification import (
    CampaignSpecification,
    EvaluationSpecification,
    SensitivitySpecification,
    SeparateThresholds,
    VehicleSpecification,
)
from drivecal.contracts.work import SetupRequest
from drivecal.domain.errors import InvalidInputError
from drivecal.domain.parameters import Parameter, ParameterSet, ParameterSpace, text
from drivecal.domain.scenarios import Scenario
from drivecal.domain.setups import Setup
from drivecal.plugins import registry
from drivecal.plugins.ports import DrivingFunction, Evaluator, OptimizerPlugin, Vehicle
from drivecal.plugins.setups import setup_of
from drivecal.sensitivity import thresholds
from drivecal.sensitivity.analysis import SensitivityAnalysis
from drivecal.sensitivity.settings import SensitivitySettings

MOST_WRONG_SETS = 200
"""Findings after which further start sets are not looked at."""


def evaluator_id(evaluator: Evaluator) -> str:
    """Name and version of an evaluator, under which ratings are stored."""
    return f"{evaluator.name} {evaluator.version}"


@dataclass(frozen=True)
class Bench:
    """Everything besides the parameter set: which scenarios are driven by what, in which vehicle, rated by whom."""

    scenarios: Mapping[str, tuple[str, Scenario]]
    """By scenario id, in the catalogue's order: (catalogue's name, scenario)."""
    driving_function: DrivingFunction
    vehicle: Vehicle
    vehicle_parameters: Mapping[str, float]
    evaluator: Evaluator

    def __post_init__(self) -> None:
        """Raises UnavailableError where a part lacks what it was shipped with: reading its version, it finds out."""
        self.driving_function.version, self.vehicle.version, self.evaluator.version  # noqa: B018  reading is what may fail

    @cached_property
    def setups(self) -> dict[str, Setup]:
        """The setup of each scenario."""
        return {
            name: setup_of(scenario, self.driving_function, self.vehicle, self.vehicle_parameters)
            for name, (_, scenario) in self.scenarios.items()
        }

    @cached_property
    def requests(self) -> dict[str, SetupRequest]:
        """What a worker is asked to run, by scenario."""
        return {
            name: SetupRequest(
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
            for name, (catalogue, _) in self.scenarios.items()
        }

    @property
    def evaluator_id(self) -> str:
        """Name and version of the evaluator: with the run fingerprint it names a rating."""
        return evaluator_id(self.evaluator)


@dataclass(frozen=True)
class Optimization:
    """The chosen optimizer with its checked settings."""

    plugin: OptimizerPlugin
    settings: BaseModel
    population: int
    iterations: int
    seed: int


@dataclass(frozen=True)
class CalibrationProblem:
    """A campaign that can run."""

    specification: CampaignSpecification
    bench: Bench
    space: ParameterSpace
    weights: Mapping[str, float]
    """Normalised to a sum of 1, by scenario; scenarios of weight 0 are left out (Eq. 6)."""
    optimization: Optimization | None
    """None where only the sensitivity analysis is wanted."""
    baseline: ParameterSet | None
    start_sets: tuple[ParameterSet, ...]
    """What must be in the start population, each once: the baseline, then the sets from expert knowledge."""
    robust_sets: tuple[ParameterSet, ...]
    """What the robustness stage examines in any case."""
    notes: tuple[str, ...]

    def analysis(self) -> SensitivityAnalysis | None:
        """A fresh sensitivity analysis; None where a map is named or none is wanted."""
        wanted = self.specification.sensitivity
        if not isinstance(wanted, SensitivitySpecification):
            return None
        return _analysis(wanted, self.space, self.scenarios)

    @property
    def checked_certificates(self) -> float | None:
        """The share of certified cells that are simulated all the same, to check the certificates; None where none are used."""
        wanted = self.specification.reduction
        return wanted.audit if wanted.certified and self.bench.driving_function.certifiable else None

    @property
    def scenarios(self) -> tuple[str, ...]:
        """The ids of the scenarios that are simulated, in the catalogue's order."""
        return tuple(self.weights)

    def expected_runs(self) -> ExpectedRuns:
        """What the campaign costs if no cell could be answered without a simulation."""
        chosen, analysis = self.optimization, self.analysis()
        proposed = requested = 0
        if chosen is not None:
            proposed = chosen.population * chosen.iterations * len(self.scenarios)
            requested = chosen.plugin.requested_individuals(chosen.settings) * len(self.scenarios)
        phases = {} if analysis is None else analysis.expected_runs()
        intervals = phases.get("intervals", 0) * len(self.scenarios)
        return ExpectedRuns(
            sensitivity=intervals,
            sensitivity_at_most=sum(phases.values()) * len(self.scenarios),
            calibration_proposed=proposed,
            calibration_at_most=requested,
            robustness=self._robustness_runs(),
            validation=self._validation_runs(),
            break_even_share=intervals / requested if intervals and requested else None,
            notes=list(self.notes),
        )

    def _robustness_runs(self) -> int:
        wanted = self.specification.robustness
        if wanted is None:
            return 0
        searched = self.optimization is not None or wanted.of is not None
        solutions = len(self.robust_sets) + (wanted.solutions if searched else 0)
        boxes = wanted.steps + wanted.refinements
        return solutions * len(self.scenarios) * (1 + boxes * wanted.samples)

    def _validation_runs(self) -> int:
        wanted = self.specification.validation
        return 0 if wanted is None else wanted.samples * (1 + wanted.references) * len(self.scenarios)

    def resolution(self) -> dict[str, Any]:
        """What decides how the campaign goes on, and must not change before it ends: setups, evaluator, space; JSON-ready.

        `pinned.Pinned` is what it means once the campaign has been taken up.
        """
        fixed = {name: text(value) for name, value in self.space.fixed.items()}
        return _resolution(self.bench, self.space.parameters) | {"fixed": fixed, "weights": dict(self.weights)}


@dataclass(frozen=True)
class EvaluationProblem:
    """One parameter set to be driven in one or more scenarios."""

    bench: Bench
    parameter_set: ParameterSet

    def resolution(self) -> dict[str, Any]:
        """See `CalibrationProblem.resolution`."""
        return _resolution(self.bench, next(iter(self.bench.driving_function.spaces.values())))


def _resolution(bench: Bench, space: Sequence[Parameter]) -> dict[str, Any]:
    return {
        "setups": {scenario: setup.fingerprint for scenario, setup in bench.setups.items()},
        "evaluator": bench.evaluator_id,
        "space": space_to_document(space),
    }


def resolve(specification: CampaignSpecification) -> CalibrationProblem:
    """The problem that a specification describes. Raises InvalidInputError with everything that is wrong."""
    findings = Findings()
    scenarios = _scenarios(specification.catalogue, findings)
    function = findings.attempt(lambda: registry.driving_function(specification.driving_function))
    vehicle, vehicle_parameters = _vehicle(specification.vehicle, findings)
    evaluator = findings.attempt(lambda: registry.evaluator(specification.evaluator))
    optimization = _optimization(specification, findings)
    weights, notes = _weights(specification.weights, list(scenarios), findings)
    space = None if function is None else search_space(specification, function, findings)
    baseline = given_set(specification.baseline, space, "baseline", findings)
    start_sets = _start_sets(specification, baseline, space, findings)
    robust_sets = _robustness(specification, vehicle, vehicle_parameters, list(weights), space, findings)
    _validation(specification, findings)
    if specification.reduction.narrow and specification.sensitivity is None:
        remedy = "ask for a sensitivity analysis, name a map, or leave `narrow` out"
        findings.add("reduction.narrow", "there is no influence map by which the search space could be narrowed", remedy)
    if space is not None and isinstance(specification.sensitivity, SensitivitySpecification):
        try:
            _analysis(specification.sensitivity, space, tuple(weights))
        except InvalidInputError as error:
            findings.problems.extend(error.problems)
    findings.raise_if_any()
    if function is None or vehicle is None or evaluator is None or space is None:
        raise AssertionError("a part is missing without a finding")
    bench = Bench({name: scenarios[name] for name in weights}, function, vehicle, vehicle_parameters, evaluator)
    return CalibrationProblem(specification, bench, space, weights, optimization, baseline, start_sets, robust_sets, notes)


def resolve_evaluation(specification: EvaluationSpecification) -> EvaluationProblem:
    """The cells that a single evaluation asks for. Values need not lie on a grid, only within the driving function's limits."""
    findings = Findings()
    scenarios = _scenarios(specification.catalogue, findings)
    if specification.scenario is not None:
        if specification.scenario in scenarios:
            scenarios = {specification.scenario: scenarios[specification.scenario]}
        elif scenarios:
            findings.add("scenario", f"there is no scenario {specification.scenario!r}", f"one of {', '.join(scenarios)}")
    function = findings.attempt(lambda: registry.driving_function(specification.driving_function))
    vehicle, vehicle_parameters = _vehicle(specification.vehicle, findings)
    evaluator = findings.attempt(lambda: registry.evaluator(specification.evaluator))
    values = {} if function is None else free_values(specification.parameters, function, findings)
    findings.raise_if_any()
    if function is None or vehicle is None or evaluator is None:
        raise AssertionError("a part is missing without a finding")
    bench = Bench(scenarios, function, vehicle, vehicle_parameters, evaluator)
    return EvaluationProblem(bench, ParameterSet.of(values))


def catalogue_scenarios(catalogue: str | list[str]) -> dict[str, tuple[str, Scenario]]:
    """The scenarios of a catalogue, or those listed: id to (catalogue's name, scenario). Raises InvalidInputError."""
    findings = Findings()
    found = _scenarios(catalogue, findings)
    findings.raise_if_any()
    return found


def _scenarios(catalogue: str | list[str], findings: Findings) -> dict[str, tuple[str, Scenario]]:
    if isinstance(catalogue, str):
        try:
            found = registry.catalogue(catalogue)
        except InvalidInputError as error:
            findings.problems.extend(error.problems)
            return {}
        return {name: (found.name, scenario) for name, scenario in found.scenarios.items()}
    every = {name: (one.name, scenario) for one in registry.catalogues() for name, scenario in one.scenarios.items()}
    for index, name in enumerate(catalogue):
        if name not in every:
            findings.add(f"catalogue[{index}]", f"there is no scenario {name!r}", f"installed: {', '.join(every)}")
    return {name: entry for name, entry in every.items() if name in catalogue}


def _vehicle(specification: VehicleSpecification, findings: Findings) -> tuple[Vehicle | None, dict[str, float]]:
    vehicle = findings.attempt(lambda: registry.vehicle(specification.model))
    if vehicle is None:
        return None, {}
    known = {parameter.name: parameter for parameter in vehicle.parameters}
    for name in specification.parameters:
        if name not in known:
            findings.add(f"vehicle.parameters.{name}", f"{vehicle.name} has no such parameter", f"one of {', '.join(known)}")
    return vehicle, {name: parameter.nominal for name, parameter in known.items()} | specification.parameters


def _optimization(specification: CampaignSpecification, findings: Findings) -> Optimization | None:
    wanted = specification.optimizer
    if wanted is None:
        others = (
            isinstance(specification.sensitivity, SensitivitySpecification),
            specification.robustness,
            specification.validation,
        )
        if not any(others):
            findings.add("optimizer", "there is nothing to do", "choose an optimizer, a sensitivity analysis or another stage")
        return None
    plugin = findings.attempt(lambda: registry.optimizer(wanted.kind))
    if plugin is None:
        return None
    try:
        settings = plugin.settings.model_validate(wanted.model_dump(exclude={"start_sets"}))
    except ValidationError as error:
        for detail in error.errors(include_url=False):
            field = ".".join(["optimizer", *(str(part) for part in detail["loc"])])
            if detail["type"] == "extra_forbidden":
                known = ", ".join(plugin.settings.model_fields)
                findings.add(field, f"{plugin.name} has no such setting", f"one of {known}")
            else:
                findings.add(field, detail["msg"])
        return None
    return Optimization(plugin, settings, wanted.population, wanted.iterations, wanted.seed)


def _start_sets(
    specification: CampaignSpecification, baseline: ParameterSet | None, space: ParameterSpace | None, findings: Findings
) -> tuple[ParameterSet, ...]:
    wanted = specification.optimizer
    listed = [] if wanted is None else wanted.start_sets
    found: list[ParameterSet | None] = []
    for index, one in enumerate(listed):
        if len(findings.problems) > MOST_WRONG_SETS:
            break  # who has so many to mend begins with them
        found.append(given_set(one, space, f"optimizer.start_sets[{index}]", findings))
    together = tuple(dict.fromkeys(one for one in (baseline, *found) if one is not None))
    if wanted is not None and len(together) > wanted.population:
        message = f"{len(together)} sets, the baseline included, do not fit into a population of {wanted.population}"
        findings.add("optimizer.start_sets", message, "give fewer, or a larger population")
    return together


def _robustness(
    specification: CampaignSpecification,
    vehicle: Vehicle | None,
    nominal: Mapping[str, float],
    scenarios: Sequence[str],
    space: ParameterSpace | None,
    findings: Findings,
) -> tuple[ParameterSet, ...]:
    """The sets that are examined in any case; finds what is wrong with the stage."""
    wanted = specification.robustness
    if wanted is None:
        return ()
    if specification.optimizer is None and not wanted.sets and wanted.of is None:
        remedy = "choose an optimizer, or name sets in robustness.sets or a campaign in robustness.of"
        findings.add("robustness", "there are no solutions to examine", remedy)
    if specification.optimizer is not None and wanted.of is not None:
        findings.add("robustness.of", "this campaign searches its own solutions", "leave it out, or give optimizer: null")
    if isinstance(wanted.eta, list) and len(wanted.eta) != len(scenarios):
        message = f"{len(wanted.eta)} numbers for {len(scenarios)} scenarios"
        findings.add("robustness.eta", message, f"one number, or one for each of {', '.join(scenarios)}")
    if vehicle is not None:
        findings.attempt(lambda: check_nominal(vehicle.parameters, nominal))
    found = [given_set(one, space, f"robustness.sets[{index}]", findings) for index, one in enumerate(wanted.sets)]
    return tuple(dict.fromkeys(one for one in found if one is not None))


def _validation(specification: CampaignSpecification, findings: Findings) -> None:
    wanted = specification.validation
    if wanted is None:
        return
    if specification.sensitivity is None:
        findings.add("validation", "there is no influence map to validate", "ask for a sensitivity analysis, or name a map")
    if wanted.largest < wanted.samples:
        message = f"{wanted.largest:,} is less than the first {wanted.samples:,} samples"
        findings.add("validation.largest", message, "give at least as many")


def _analysis(wanted: SensitivitySpecification, space: ParameterSpace, scenarios: Sequence[str]) -> SensitivityAnalysis:
    threshold = wanted.threshold
    settings = SensitivitySettings(
        design=wanted.design,
        intervals=wanted.intervals,
        samples=wanted.samples,
        threshold=thresholds.SeparateThresholds(threshold.mu, threshold.sigma)
        if isinstance(threshold, SeparateThresholds)
        else threshold,
        seed=wanted.seed,
    )
    return SensitivityAnalysis(space, scenarios, settings)


def _weights(
    given: Mapping[str, float], scenarios: Sequence[str], findings: Findings
) -> tuple[dict[str, float], tuple[str, ...]]:
    for name in given:
        if scenarios and name not in scenarios:
            findings.add(f"weights.{name}", f"there is no scenario {name!r} in the catalogue", f"one of {', '.join(scenarios)}")
    weights = {name: float(given.get(name, 1.0)) for name in scenarios}
    total = sum(weights.values())
    if scenarios and total == 0:
        findings.add(
            "weights", "all weights are 0, so nothing would be simulated", "give at least one scenario a positive weight"
        )
        return {}, ()
    left_out = [name for name, weight in weights.items() if weight == 0]
    notes = (f"not simulated because their weight is 0: {', '.join(left_out)}",) if left_out else ()
    return {name: weight / total for name, weight in weights.items() if weight > 0}, notes
