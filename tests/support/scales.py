"""A scale that shares nothing with the comfort score: less is better, no steps, wide."""

from collections.abc import Mapping

from drivecal.analysis.goals import weighted_mean
from drivecal.analysis.solutions import Ranking
from drivecal.contracts.specification import ReplicatesSpecification
from drivecal.domain.scales import COMFORT, Direction, Scale

COST = Scale("cost", Direction.MINIMISE, lower=0.0, upper=100.0, tolerance=2.0, failed=100.0)


def by_score(weights: Mapping[str, float], scale: Scale = COMFORT, wanted: ReplicatesSpecification | None = None) -> Ranking:
    """A ranking by the weighted mean of the score."""
    return Ranking(weights, weighted_mean(scale, weights), wanted)
