"""The resolved specification of a started campaign: enough to read its results, whatever is installed today."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from pydantic import TypeAdapter

from drivecal.analysis.goals import Goals, weighted_mean
from drivecal.campaigns.resolve.problem import CalibrationProblem, EvaluationProblem, resolve, resolve_evaluation
from drivecal.campaigns.resolve.spaces import fixed_from_document, space_from_document
from drivecal.campaigns.resolve.workbench import BundleSource, installed_bundles
from drivecal.contracts.input_errors import nearest, validated
from drivecal.contracts.specification import CampaignSpecification, EvaluationSpecification, ReplicatesSpecification
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.parameters import ParameterSpace
from drivecal.domain.scales import COMFORT, Scale
from drivecal.storage.campaigns import StoredCampaign

_SCALE = TypeAdapter(Scale)


@dataclass(frozen=True, slots=True)
class ResolvedSpec:
    """`evaluator` is a name with a version; a single evaluation's `space` is its driving function's."""

    evaluator: str
    space: ParameterSpace
    weights: Mapping[str, float]
    """Weights of the simulated scenarios in the catalogue's order, with sum 1; empty for a single evaluation."""
    setups: Mapping[str, str]
    """Fingerprints of the setups by scenario."""
    scale: Scale
    goals: Goals
    replicates: ReplicatesSpecification = field(default_factory=ReplicatesSpecification)
    variants: Mapping[str, Goals] = field(default_factory=dict)
    """Objective and constraints of each variant."""

    def of_variant(self, name: str | None) -> "ResolvedSpec":
        """Returns the specification of a variant alone; itself for None. Raises InvalidInputError for an unknown variant."""
        if name is None:
            return self
        if name not in self.variants:
            remedy = nearest(name, list(self.variants)) if self.variants else "leave it out: the campaign has none"
            raise InvalidInputError(Problem("variant", f"the campaign has no variant {shown(name)}", remedy))
        goals = self.variants[name]
        return replace(self, weights=goals.objectives[0].shares, goals=goals, variants={})


def problem_of(campaign: StoredCampaign, bundles: BundleSource = installed_bundles) -> CalibrationProblem | EvaluationProblem:
    """Resolves a campaign against today's plug-ins and the stored bundles. Raises InvalidInputError if that fails."""
    if campaign.kind == "evaluation":
        return resolve_evaluation(validated(EvaluationSpecification, campaign.spec), bundles)
    return resolve(specification_of(campaign), bundles)


def specification_of(campaign: StoredCampaign) -> CampaignSpecification:
    """Returns the specification of a stored campaign of the kind "calibration"."""
    return validated(CampaignSpecification, campaign.spec)


def resolved_spec(campaign: StoredCampaign) -> ResolvedSpec:
    """The specification that a campaign was submitted or started with. Raises InvalidInputError if it cannot be resolved."""
    resolution: Mapping[str, Any] = campaign.resolution or problem_of(campaign).resolution()
    fixed = fixed_from_document(resolution.get("fixed", {}))
    space = ParameterSpace(space_from_document(resolution["space"]), fixed)
    weights, setups = resolution.get("weights", {}), resolution["setups"]
    scale, goals = stored_scale(resolution), stored_goals(resolution)
    wanted = validated(ReplicatesSpecification, campaign.spec.get("replicates") or {})
    variants = {name: Goals.from_json(document) for name, document in resolution.get("variants", {}).items()}
    return ResolvedSpec(resolution["evaluator"], space, weights, setups, scale, goals, wanted, variants)


def stored_goals(resolution: Mapping[str, Any] | None) -> Goals:
    """The objectives and constraints that are stored with a campaign; the weighted mean of the score before it starts, and for a single
    evaluation."""
    known = resolution or {}
    return Goals.from_json(known["goals"]) if "goals" in known else weighted_mean(stored_scale(resolution), {})


def stored_scale(resolution: Mapping[str, Any] | None) -> Scale:
    """Returns the scale that is stored with a campaign; before it starts, that of the comfort score."""
    return _SCALE.validate_python(resolution["scale"]) if resolution is not None else COMFORT
