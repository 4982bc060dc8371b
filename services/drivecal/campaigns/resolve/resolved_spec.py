"""What a campaign was taken up with: enough to read what it found, whatever is installed by now."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

from drivecal.campaigns.resolve.problem import CalibrationProblem, EvaluationProblem, resolve, resolve_evaluation
from drivecal.campaigns.resolve.spaces import space_from_document
from drivecal.contracts.input_errors import validated
from drivecal.contracts.specification import CampaignSpecification, EvaluationSpecification
from drivecal.domain.parameters import ParameterSpace
from drivecal.storage.campaigns import StoredCampaign


@dataclass(frozen=True, slots=True)
class ResolvedSpec:
    """`evaluator` is its name with its version; `space`: of a single evaluation that of its driving function."""

    evaluator: str
    space: ParameterSpace
    weights: Mapping[str, float]
    """Of the simulated scenarios, in the catalogue's order, normalised to a sum of 1; empty for a single evaluation."""
    setups: Mapping[str, str]
    """Their fingerprints."""


def problem_of(campaign: StoredCampaign) -> CalibrationProblem | EvaluationProblem:
    """What a campaign means today. Raises InvalidInputError where it cannot be resolved any more."""
    if campaign.kind == "evaluation":
        return resolve_evaluation(validated(EvaluationSpecification, campaign.spec))
    return resolve(validated(CampaignSpecification, campaign.spec))


def resolved_spec(campaign: StoredCampaign) -> ResolvedSpec:
    """What a campaign was taken up with; of one that is still queued, what it would be taken up with today.

    Raises InvalidInputError where that cannot be resolved.
    """
    resolution: Mapping[str, Any] = campaign.resolution or problem_of(campaign).resolution()
    fixed = {name: Decimal(value) for name, value in resolution.get("fixed", {}).items()}
    space = ParameterSpace(space_from_document(resolution["space"]), fixed)
    return ResolvedSpec(resolution["evaluator"], space, resolution.get("weights", {}), resolution["setups"])
