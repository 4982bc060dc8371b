"""Resolves each part of a specification against the installed plug-ins, and adds its problems to the diagnostics."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pydantic import BaseModel, ValidationError

from drivecal.analysis.robustness import check_nominal
from drivecal.campaigns.resolve.diagnostics import Diagnostics
from drivecal.campaigns.resolve.spaces import given_set
from drivecal.contracts.input_errors import nearest, problem
from drivecal.contracts.specification import (
    CampaignSpecification,
    SensitivitySpecification,
    SeparateThresholds,
    VehicleSpecification,
)
from drivecal.contracts.studies import STUDIES
from drivecal.domain.errors import InvalidInputError
from drivecal.domain.parameters import ParameterSet, ParameterSpace
from drivecal.domain.scales import COMFORT, Scale
from drivecal.domain.scenarios import Scenario
from drivecal.plugins import registry
from drivecal.plugins.ports import OptimizerPlugin, Vehicle
from drivecal.sensitivity import thresholds
from drivecal.sensitivity.analysis import SensitivityAnalysis
from drivecal.sensitivity.settings import SensitivitySettings

MOST_WRONG_SETS = 200
"""Problems after which further start sets are not checked."""


@dataclass(frozen=True)
class Optimization:
    """The chosen optimizer with its checked settings."""

    plugin: OptimizerPlugin
    settings: BaseModel
    population: int
    iterations: int
    seed: int


def find_scenarios(catalogue: str | list[str], diagnostics: Diagnostics) -> dict[str, tuple[str, Scenario]]:
    """Scenarios by id, in the catalogues' order: (catalogue's name, scenario)."""
    if isinstance(catalogue, str):
        try:
            loaded = registry.catalogue(catalogue)
        except InvalidInputError as error:
            diagnostics.problems.extend(error.problems)
            return {}
        return {name: (loaded.name, scenario) for name, scenario in loaded.scenarios.items()}
    every = {
        name: (catalogue.name, scenario)
        for catalogue in registry.catalogues()
        for name, scenario in catalogue.scenarios.items()
    }
    for index, name in enumerate(catalogue):
        if name not in every:
            diagnostics.add(f"catalogue[{index}]", f"there is no scenario {name!r}", f"installed: {', '.join(every)}")
    return {name: entry for name, entry in every.items() if name in catalogue}


def find_vehicle(specification: VehicleSpecification, diagnostics: Diagnostics) -> tuple[Vehicle | None, dict[str, float]]:
    """The vehicle and its parameters: nominal by default."""
    vehicle = diagnostics.attempt(lambda: registry.vehicle(specification.model))
    if vehicle is None:
        return None, {}
    known = {parameter.name: parameter for parameter in vehicle.parameters}
    for name in specification.parameters:
        if name not in known:
            diagnostics.add(f"vehicle.parameters.{name}", f"{vehicle.name} has no such parameter", f"one of {', '.join(known)}")
    return vehicle, {name: parameter.nominal for name, parameter in known.items()} | specification.parameters


def note_vehicle(vehicle: Vehicle | None, values: Mapping[str, float]) -> tuple[str, ...]:
    """Notes vehicle values beyond the bounds of the model: unusual but valid, perhaps a wrong unit."""
    if vehicle is None:
        return ()
    return tuple(
        f"vehicle.parameters.{parameter.name} is {values[parameter.name]:g} {parameter.unit}, beyond the {parameter.minimum:g} to"
        f" {parameter.maximum:g} {parameter.unit} of {vehicle.name}"
        for parameter in vehicle.parameters
        if not parameter.minimum <= values[parameter.name] <= parameter.maximum
    )


def note_threshold(specification: CampaignSpecification) -> tuple[str, ...]:
    """Notes what the threshold `auto` of a new analysis may miss with its number of samples."""
    wanted = specification.sensitivity
    if not isinstance(wanted, SensitivitySpecification) or wanted.threshold != "auto":
        return ()
    return (thresholds.tolerance_text(wanted.samples),)


def choose_optimizer(specification: CampaignSpecification, diagnostics: Diagnostics) -> Optimization | None:
    """The optimizer with its checked settings; None if none is requested."""
    wanted = specification.optimizer
    if wanted is None:
        analyses = isinstance(specification.sensitivity, SensitivitySpecification)
        if not analyses and not any(getattr(specification, study) for study in STUDIES):
            diagnostics.add(
                "optimizer", "there is nothing to do", "choose an optimizer, a sensitivity analysis or another stage"
            )
        return None
    plugin = diagnostics.attempt(lambda: registry.optimizer(wanted.kind))
    if plugin is None:
        return None
    try:
        settings = plugin.settings.model_validate(wanted.model_dump(exclude={"start_sets"}))
    except ValidationError as error:
        for detail in error.errors(include_url=False):
            field = ".".join(["optimizer", *(str(part) for part in detail["loc"])])
            if detail["type"] == "extra_forbidden":
                remedy = nearest(str(detail["loc"][-1]), list(plugin.settings.model_fields))
                diagnostics.add(field, f"{plugin.name} has no such setting", remedy)
            else:
                diagnostics.problems.append(problem(field, detail))
        return None
    return Optimization(plugin, settings, wanted.population, wanted.iterations, wanted.seed)


def find_start_sets(
    specification: CampaignSpecification, baseline: ParameterSet | None, space: ParameterSpace | None, diagnostics: Diagnostics
) -> tuple[ParameterSet, ...]:
    """The sets that the start population must hold, each once: the baseline, then sets from expert knowledge."""
    wanted = specification.optimizer
    listed = [] if wanted is None else wanted.start_sets
    start_sets: list[ParameterSet | None] = []
    for index, given in enumerate(listed):
        if len(diagnostics.problems) > MOST_WRONG_SETS:
            break  # who has so many to mend begins with them
        start_sets.append(given_set(given, space, f"optimizer.start_sets[{index}]", diagnostics))
    together = tuple(dict.fromkeys(parameter_set for parameter_set in (baseline, *start_sets) if parameter_set is not None))
    if wanted is not None and len(together) > wanted.population:
        message = f"{len(together)} sets, the baseline included, do not fit into a population of {wanted.population}"
        diagnostics.add("optimizer.start_sets", message, "give fewer, or a larger population")
    return together


def find_robust_sets(
    specification: CampaignSpecification,
    vehicle: Vehicle | None,
    nominal: Mapping[str, float],
    scenarios: Sequence[str],
    space: ParameterSpace | None,
    diagnostics: Diagnostics,
) -> tuple[ParameterSet, ...]:
    """The sets that the robustness stage always examines; adds the stage's problems."""
    wanted = specification.robustness
    if wanted is None:
        return ()
    if specification.optimizer is None and not wanted.sets and wanted.of is None:
        remedy = "choose an optimizer, or name sets in robustness.sets or a campaign in robustness.of"
        diagnostics.add("robustness", "there are no solutions to examine", remedy)
    if specification.optimizer is not None and wanted.of is not None:
        diagnostics.add("robustness.of", "this campaign searches its own solutions", "leave it out, or give optimizer: null")
    if isinstance(wanted.eta, list) and len(wanted.eta) != len(scenarios):
        message = f"{len(wanted.eta)} numbers for {len(scenarios)} scenarios"
        diagnostics.add("robustness.eta", message, f"one number, or one for each of {', '.join(scenarios)}")
    if vehicle is not None:
        diagnostics.attempt(lambda: check_nominal(vehicle.parameters, nominal))
    named = [given_set(given, space, f"robustness.sets[{index}]", diagnostics) for index, given in enumerate(wanted.sets)]
    return tuple(dict.fromkeys(parameter_set for parameter_set in named if parameter_set is not None))


def check_units(specification: CampaignSpecification, scale: Scale, diagnostics: Diagnostics) -> None:
    """Adds a problem for every difference of scores that is wider than their range."""
    wanted = specification.robustness
    eta = [] if wanted is None else wanted.eta if isinstance(wanted.eta, list) else [wanted.eta]
    given = {f"robustness.eta[{index}]" if len(eta) > 1 else "robustness.eta": value for index, value in enumerate(eta)}
    given |= {} if wanted is None else {"robustness.within": wanted.within}
    given |= {} if specification.reduction.tolerance is None else {"reduction.tolerance": specification.reduction.tolerance}
    for field, value in given.items():
        if value > scale.span:
            message = f"{value:g} is more than the whole range of the score {scale.name}, {scale.lower:g} to {scale.upper:g}"
            diagnostics.add(field, message, f"give at most {scale.amount(scale.span)}")


def check_validation(specification: CampaignSpecification, diagnostics: Diagnostics) -> None:
    """Adds a problem if there is no map to validate, or if the numbers do not fit."""
    wanted = specification.validation
    if wanted is None:
        return
    if specification.sensitivity is None and wanted.of is None:
        diagnostics.add("validation", "there is no influence map to validate", "ask for a sensitivity analysis, or name a map")
    if wanted.of is None and wanted.largest < wanted.samples:
        message = f"{wanted.largest:,} is less than the first {wanted.samples:,} samples"
        diagnostics.add("validation.largest", message, "give at least as many")


def plan_analysis(
    wanted: SensitivitySpecification, space: ParameterSpace, scenarios: Sequence[str], scale: Scale = COMFORT
) -> SensitivityAnalysis:
    """Plans a new sensitivity analysis. Raises InvalidInputError if the space does not allow it."""
    threshold = wanted.threshold
    settings = SensitivitySettings(
        design=wanted.design,
        intervals=wanted.intervals,
        samples=wanted.samples,
        threshold=thresholds.MuSigmaThresholds(threshold.mu, threshold.sigma)
        if isinstance(threshold, SeparateThresholds)
        else threshold,
        seed=wanted.seed,
        sequential=wanted.sequential,
    )
    return SensitivityAnalysis(space, scenarios, settings, scale)


def normalise_weights(
    given: Mapping[str, float], scenarios: Sequence[str], diagnostics: Diagnostics
) -> tuple[dict[str, float], tuple[str, ...]]:
    """Positive weights by scenario, of sum 1 (Eq. 6), with a note that names the scenarios of weight 0."""
    for name in given:
        if scenarios and name not in scenarios:
            diagnostics.add(
                f"weights.{name}", f"there is no scenario {name!r} in the catalogue", f"one of {', '.join(scenarios)}"
            )
    weights = {name: float(given.get(name, 1.0)) for name in scenarios}
    total = sum(weights.values())
    if scenarios and total == 0:
        diagnostics.add(
            "weights", "all weights are 0, so nothing would be simulated", "give at least one scenario a positive weight"
        )
        return {}, ()
    left_out = [name for name, weight in weights.items() if weight == 0]
    notes = (f"not simulated because their weight is 0: {', '.join(left_out)}",) if left_out else ()
    return {name: weight / total for name, weight in weights.items() if weight > 0}, notes
