"""Resolves the other parts of a specification against the installed plug-ins, and adds its problems to the diagnostics."""

from collections.abc import Mapping, Sequence

from drivecal.bundles.highway import Scenario
from drivecal.bundles.shapes import Shapes
from drivecal.campaigns.resolve.spaces import Function, given_set
from drivecal.contracts.specification import CampaignSpecification, Given, SensitivitySpecification, SeparateThresholds
from drivecal.domain.constraints import Constraints
from drivecal.domain.errors import Diagnostics
from drivecal.domain.parameters import ParameterSet, ParameterSpace
from drivecal.domain.scales import Scale
from drivecal.domain.vehicles import VehicleParameter
from drivecal.plugins import registry
from drivecal.sensitivity import thresholds

MOST_WRONG_SETS = 200
"""Problems after which further start sets are not checked."""


def find_scenarios(
    catalogue: str | list[str], listed: Sequence[str], diagnostics: Diagnostics
) -> dict[str, tuple[str, Scenario]]:
    """Returns scenarios of installed catalogues by id, in the catalogues' order.

    Args:
        catalogue: a catalogue's name, or ids of scenarios.
        listed: all ids of the specification, in whose order faults are numbered.
        diagnostics: gets the faults.

    Returns:
        the catalogue's name and the scenario, by the scenario's id.
    """
    if isinstance(catalogue, str):
        loaded = diagnostics.attempt(lambda: registry.catalogue(catalogue))
        return {} if loaded is None else {name: (loaded.name, scenario) for name, scenario in loaded.scenarios.items()}
    every: dict[str, list[tuple[str, Scenario]]] = {}
    for offered in registry.catalogues():
        for name, scenario in offered.scenarios.items():
            every.setdefault(name, []).append((offered.name, scenario))
    for name in catalogue:
        index = listed.index(name)
        if name not in every:
            diagnostics.add(f"catalogue[{index}]", f"there is no scenario {name!r}", f"installed: {', '.join(every)}")
        elif len(every[name]) > 1:
            owners = [owner for owner, _ in every[name]]
            message = f"{len(owners)} catalogues have a scenario {name!r}: {', '.join(owners)}"
            diagnostics.add(f"catalogue[{index}]", message, f"name one of the catalogues, e.g. catalogue: {owners[0]}")
    return {name: entries[0] for name, entries in every.items() if name in catalogue}


def note_threshold(specification: CampaignSpecification, scale: Scale) -> tuple[str, ...]:
    """Notes what a threshold misses: `auto` by the number of samples, a number that is more than the score's tolerance."""
    wanted = specification.sensitivity
    if not isinstance(wanted, SensitivitySpecification) or isinstance(wanted.threshold, SeparateThresholds):
        return ()
    if wanted.threshold == "auto":
        return (thresholds.tolerance_text(wanted.samples),)
    change, tolerance = scale.amount(wanted.threshold * scale.span), scale.amount(scale.tolerance)
    note = f"`threshold` {wanted.threshold:g} may leave out a parameter that changes the score by {change}; its tolerance is {tolerance}"
    return (note,) if wanted.threshold * scale.span > scale.tolerance > 0 else ()


def own_baseline(
    given: Mapping[str, Given] | None, constraints: Constraints | None, shapes: Shapes
) -> tuple[ParameterSet | None, tuple[str, ...]]:
    """The problem's baseline, and notes if this campaign's space does not hold it, or holds it nearly."""
    diagnostics = Diagnostics()
    baseline = given_set(given, constraints, "baseline", diagnostics, shapes)
    if not diagnostics.problems:
        return baseline, tuple(diagnostics.notes)
    return None, (f"the problem's baseline is left out: {'; '.join(str(problem) for problem in diagnostics.problems)}",)


def find_start_sets(
    specification: CampaignSpecification,
    baseline: ParameterSet | None,
    constraints: Constraints | None,
    diagnostics: Diagnostics,
    population: int | None,
    shapes: Shapes,
) -> tuple[ParameterSet, ...]:
    """Returns the sets that a search begins with, each once: the baseline, then sets from expert knowledge. `population`: the most."""
    wanted = specification.optimizer
    listed = [] if wanted is None else wanted.start_sets
    start_sets: list[ParameterSet | None] = []
    for index, given in enumerate(listed):
        if len(diagnostics.problems) > MOST_WRONG_SETS:
            break  # enough for one message
        start_sets.append(given_set(given, constraints, f"optimizer.start_sets[{index}]", diagnostics, shapes))
    together = tuple(dict.fromkeys(parameter_set for parameter_set in (baseline, *start_sets) if parameter_set is not None))
    if population is not None and len(together) > population:
        message = f"{len(together)} sets, the baseline included, do not fit into a population of {population}"
        diagnostics.add("optimizer.start_sets", message, "give fewer, or a larger population")
    return together


def find_robust_sets(
    specification: CampaignSpecification,
    varied: Sequence[VehicleParameter],
    constraints: Constraints | None,
    diagnostics: Diagnostics,
    shapes: Shapes,
) -> tuple[ParameterSet, ...]:
    """The sets that the robustness stage always examines; adds the stage's problems."""
    wanted = specification.robustness
    if wanted is None:
        return ()
    if specification.optimizer is None and not wanted.sets and wanted.of is None:
        remedy = "choose an optimizer, or name sets in robustness.sets or a campaign in robustness.of"
        diagnostics.add("robustness", "there are no solutions to examine", remedy)
    if not wanted.solutions and not wanted.sets:
        diagnostics.add("robustness.solutions", "0 examines no set", "give at least 1, or name sets in robustness.sets")
    if specification.optimizer is not None and wanted.of is not None:
        diagnostics.add("robustness.of", "this campaign searches its own solutions", "leave it out, or give optimizer: null")
    if not varied:
        remedy = "leave it out, declare `varied` in problem.yaml, or give the conditions to be robust against as scenarios"
        diagnostics.add("robustness", "the problem has no varied parameters", remedy)
    named = [
        given_set(given, constraints, f"robustness.sets[{index}]", diagnostics, shapes)
        for index, given in enumerate(wanted.sets)
    ]
    return tuple(dict.fromkeys(parameter_set for parameter_set in named if parameter_set is not None))


def check_units(specification: CampaignSpecification, scale: Scale, diagnostics: Diagnostics) -> None:
    """Adds a problem for every difference of scores that is wider than their range."""
    wanted = specification.robustness
    given = {} if wanted is None or wanted.eta is None or wanted.condition == "mean" else {"robustness.eta": wanted.eta}
    given |= {} if specification.reduction.tolerance is None else {"reduction.tolerance": specification.reduction.tolerance}
    for field, value in given.items():
        if value > scale.span:
            message = f"{value:g} is more than the whole range of the score {scale.name}, {scale.lower:g} to {scale.upper:g}"
            diagnostics.add(field, message, f"give at most {scale.amount(scale.span)}")


def note_predictions(specification: CampaignSpecification, scale: Scale) -> tuple[str, ...]:
    """Notes that scores without steps are hardly predicted if no difference is tolerated."""
    reduction = specification.reduction
    if specification.optimizer is None or not reduction.predicts or scale.step is not None or reduction.tolerance_on(scale) > 0:
        return ()
    remedy = "a `tolerance` of the score in problem.yaml, or `reduction.tolerance`, lets predictions answer cells"
    return (f"the score {scale.name} has neither steps nor a tolerance, so hardly any prediction is right: {remedy}",)


def check_validation(specification: CampaignSpecification, diagnostics: Diagnostics) -> None:
    """Adds a problem if there is no map to validate, if the numbers do not fit, or if a search would seem to have another's errors."""
    wanted = specification.validation
    if wanted is None:
        return
    if specification.optimizer is not None and wanted.of is not None:
        diagnostics.add("validation.of", "this campaign searches its own solutions", "leave it out, or give optimizer: null")
    if specification.sensitivity is None and wanted.of is None:
        diagnostics.add("validation", "there is no influence map to validate", "ask for a sensitivity analysis, or name a map")
    if wanted.of is None and wanted.largest < wanted.samples:
        message = f"{wanted.largest:,} is less than the first {wanted.samples:,} samples"
        diagnostics.add("validation.largest", message, "give at least as many")


def find_constraints(function: Function | None, space: ParameterSpace, diagnostics: Diagnostics) -> Constraints | None:
    """The constraints of the search; None if they leave nothing, with the problem in `diagnostics`."""
    if function is None:
        return None
    constraints = Constraints(space, function.constraints)
    if constraints:
        last = space.n_values - 1
        if diagnostics.attempt(lambda: constraints.region(0 * last, last)) is None:
            return None
    return constraints
