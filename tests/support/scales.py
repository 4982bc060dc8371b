"""A scale that shares nothing with the comfort score: less is better, no steps, wide."""

from drivecal.domain.scales import Direction, Scale

COST = Scale("cost", Direction.MINIMISE, lower=0.0, upper=100.0, tolerance=2.0, failed=100.0)
