"""The 20-input function of Morris (1991), the example of the paper's [21], and what he read from it."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from drivecal.sensitivity.designs import COLUMNS, Floats, SobolRows, measures, radial_design

INPUTS = 20
GRID = np.full(INPUTS, 1001)


def morris(x: Floats, seed: int) -> Floats:
    """Section 4 of Morris: coefficients that he does not give are standard normal; those of third and fourth order are 0."""
    generator = np.random.default_rng(seed)
    w = 2 * (x - 0.5)
    for curved in (2, 4, 6):
        w[:, curved] = 2 * (1.1 * x[:, curved] / (x[:, curved] + 0.1) - 0.5)
    first = np.concatenate([np.full(10, 20.0), generator.normal(size=10)])
    y = w @ first
    for i, j in combinations(range(INPUTS), 2):
        y += (-15.0 if j < 6 else generator.normal()) * w[:, i] * w[:, j]
    for i, j, k in combinations(range(5), 3):
        y += -10 * w[:, i] * w[:, j] * w[:, k]
    return np.asarray(y + 5 * w[:, 0] * w[:, 1] * w[:, 2] * w[:, 3])


@pytest.mark.parametrize("seed", range(4))
def test_the_factors_fall_into_the_classes_that_morris_found(seed: int) -> None:
    """1 to 10 matter, 1 to 7 of them by curvature or interaction, 8 to 10 nearly linearly; 11 to 20 do not matter."""
    design = radial_design(GRID, SobolRows(COLUMNS * INPUTS, seed), np.zeros_like(GRID), GRID - 1, samples=32)
    effects = design.effects(7 * morris(design.points / (GRID - 1), seed))
    found = [measures(row) for row in effects]
    curved, linear, idle = found[:7], found[7:10], found[10:]
    assert min(one.mu_star for one in curved + linear) > 2 * max(one.mu_star for one in idle)
    assert min(one.sigma for one in curved) > 1.5 * max(one.sigma for one in linear + idle)
    assert all(one.mu == pytest.approx(40, rel=0.25) and one.sigma < 0.3 * abs(one.mu) for one in linear)
    assert min(one.s_rel for one in curved + linear) > 2 * max(one.s_rel for one in idle)
