"""Resolves the variants of a campaign: the scenarios that are simulated for them, and what is best for each.

A scenario with the vehicle of a variant is a scenario of its own, `S1@eu`; variants with equal vehicles share it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from drivecal.analysis.goals import Goals, normalised
from drivecal.campaigns.resolve.workbench import Workbench
from drivecal.contracts.input_errors import nearest
from drivecal.contracts.specification import CampaignSpecification, VariantSpecification
from drivecal.domain.errors import Diagnostics


@dataclass(frozen=True)
class Variants:
    """Weights of each variant by scenario, of sum 1; none without variants."""

    shares: Mapping[str, Mapping[str, float]]
    weights: Mapping[str, float]
    """By scenario, in their mean; all that are simulated, in the catalogue's order."""
    vehicles: Mapping[str, Mapping[str, float]]
    """Values of the side conditions in scenarios with another vehicle than the campaign's."""


def find_variants(
    specification: CampaignSpecification, weights: Mapping[str, float], workbench: Workbench, diagnostics: Diagnostics
) -> Variants:
    """Returns the variants of a campaign whose scenarios have these weights."""
    wanted = specification.variants
    if not wanted or not weights:
        if specification.common != "mean" and not wanted:
            diagnostics.add("common", "the campaign has no variants", "leave it out, or give variants")
        return Variants({}, weights, {})
    for place, given in enumerate(specification.objectives or ()):
        if place:
            diagnostics.add(f"objectives[{place}]", "variants have one objective", "leave it out")
        if given.scenarios != "all" or given.weights:
            diagnostics.add(f"objectives[{place}]", "the variants have scenarios and weights", "give them in `variants`")
    values: list[Mapping[str, float]] = [workbench.values]
    suffixes, vehicles, shares = [""], dict[str, Mapping[str, float]](), dict[str, dict[str, float]]()
    for name, variant in wanted.items():
        own = workbench.vehicles.get(name, workbench.values)
        if own not in values:
            values.append(own)
            suffixes.append(f"@{name}")
        suffix = suffixes[values.index(own)]
        shares[name] = {scenario + suffix: share for scenario, share in _shares(name, variant, weights, diagnostics).items()}
        vehicles |= {scenario: own for scenario in shares[name] if suffix}
    if vehicles and specification.robustness is not None:
        remedy = "leave it out, and give robustness.sets in a campaign with the vehicle of one variant"
        diagnostics.add("robustness", "it varies one vehicle, and variants have others", remedy)
    listed = [scenario + suffix for scenario in weights for suffix in suffixes]
    return Variants(shares, normalised({each: sum(own.get(each, 0.0) for own in shares.values()) for each in listed}), vehicles)


def _shares(name: str, given: VariantSpecification, weights: Mapping[str, float], diagnostics: Diagnostics) -> dict[str, float]:
    """Returns the weights of a variant by scenario of the problem, of sum 1."""
    listed = list(weights) if given.scenarios == "all" else given.scenarios
    for place, scenario in enumerate(listed):
        if scenario not in weights:
            field, message = f"variants.{name}.scenarios[{place}]", f"the campaign does not simulate a scenario {scenario!r}"
            diagnostics.add(field, message, nearest(scenario, list(weights)))
    for scenario in given.weights:
        if scenario not in listed:
            field = f"variants.{name}.weights.{scenario}"
            diagnostics.add(field, "it is no scenario of the variant", nearest(scenario, listed))
    own = dict.fromkeys(weights, 1.0) | given.weights if given.weights else weights
    return normalised({scenario: own[scenario] for scenario in weights if scenario in listed})


def goals_of_variants(specification: CampaignSpecification, goals: Goals, variants: Variants) -> tuple[Goals, dict[str, Goals]]:
    """Returns the goals of the best common set, and the goals of each variant in its scenarios."""
    if not variants.shares:
        return goals, {}
    objective, bounds = goals.objectives[0], goals.bounds
    made = {}
    for name, shares in variants.shares.items():
        of = [shares if bound.value.change is not None else bound.shares for bound in bounds]
        held = [normalised({each: share for each, share in own.items() if each in shares}) for own in of]
        kept = tuple(replace(bound, shares=own) for bound, own in zip(bounds, held, strict=True) if own)
        made[name] = Goals((replace(objective, shares=shares),), kept)
    if specification.common == "worst" or objective.aggregate.kind != "mean":
        combined = replace(objective, variants=tuple(variants.shares.values()), worst=specification.common == "worst")
        return Goals((combined,), bounds), made
    return goals, made
