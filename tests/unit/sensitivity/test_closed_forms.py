"""Effects of functions whose sensitivities are known on paper, from radial designs.

Some sensitivities hold for every step law. The g-function and sigma of x^2 need independent base and auxiliary points, so their design
has no shortest step. With a shortest step, the tests sum the exact values over the grid.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from scipy import stats

from drivecal.sensitivity.designs import COLUMNS, SHORTEST, Floats, SobolRows, radial_design
from drivecal.sensitivity.thresholds import EffectStatistics, measures

SAMPLES = 4096
A = np.array([0.0, 1.0, 4.5, 9.0])
"""Coefficients of the g-function."""

Function = Callable[[Floats], Floats]


def analysed(function: Function, dimensions: int, shortest: float, grid: int = 10_001, seed: int = 1) -> list[EffectStatistics]:
    """Analyses 7 times `function` on the unit cube, because effects are in units of the scale 0..7."""
    n_values = np.full(dimensions, grid)
    rows = SobolRows(COLUMNS * dimensions, seed)
    design = radial_design(n_values, rows, np.zeros_like(n_values), n_values - 1, SAMPLES, shortest)
    effects = design.effects(7 * function(design.points / (grid - 1)))
    return [measures(row) for row in effects]


def g_factor(x: Floats, a: float) -> Floats:
    return (np.abs(4 * x - 2) + a) / (1 + a)


def g_function(x: Floats) -> Floats:
    factors = np.array([g_factor(x[:, column], a) for column, a in enumerate(A)])
    return np.asarray(factors.prod(axis=0))


def effects_under_law(function: Function, shortest: float, grid: int = 801) -> tuple[Floats, Floats]:
    """All effects of a function of one variable between two grid points and their probabilities: base uniform, then step uniform."""
    x = np.linspace(0, 1, grid)
    steps = x[None, :] - x[:, None]
    allowed = (np.abs(steps) >= shortest - 1e-9) & (steps != 0)
    probabilities = allowed / allowed.sum(axis=1, keepdims=True) / grid
    changes = function(x)[None, :] - function(x)[:, None]
    return np.where(allowed, changes / np.where(allowed, steps, 1), 0), probabilities


def near(found: float, exact: float, spread: float) -> bool:
    """Within four standard errors of plain random sampling, which Sobol' points beat."""
    return bool(abs(found - exact) <= 4 * spread / np.sqrt(SAMPLES))


def test_under_the_step_law_a_square_keeps_its_mean_and_has_the_spread_of_the_law() -> None:
    effects, probabilities = effects_under_law(lambda x: x**2, SHORTEST)
    sigma = float(np.sqrt((probabilities * effects**2).sum() - 1))
    assert float((probabilities * effects).sum()) == pytest.approx(1)
    (result,) = analysed(lambda x: x[:, 0] ** 2, 1, SHORTEST)
    assert near(result.mu, 1, sigma)
    assert result.sigma == pytest.approx(sigma, rel=0.02)
    assert sigma < np.sqrt(1 / 6) - 0.01, "long steps average out curvature, so the two laws can be told apart"


def test_the_g_function_has_its_closed_form() -> None:
    others = 1 + 1 / (3 * (1 + A) ** 2)
    for column, found in enumerate(analysed(g_function, len(A), shortest=0)):
        mu_star = 4 * np.log(2) / (1 + A[column])
        variance = 32 * (1 - np.log(2)) / (1 + A[column]) ** 2 * np.delete(others, column).prod()
        assert near(found.mu, 0, np.sqrt(variance))
        assert near(found.mu_star, mu_star, np.sqrt(variance - mu_star**2))
        assert found.sigma == pytest.approx(np.sqrt(variance), rel=0.03)


def test_under_the_step_law_the_g_function_has_the_sums_over_the_law() -> None:
    second_moments = 1 + 1 / (3 * (1 + A) ** 2)
    for column, found in enumerate(analysed(g_function, len(A), SHORTEST)):
        effects, probabilities = effects_under_law(partial(g_factor, a=A[column]), SHORTEST)
        mu_star = float((probabilities * np.abs(effects)).sum())
        variance = float((probabilities * effects**2).sum()) * np.delete(second_moments, column).prod()
        assert near(found.mu, 0, np.sqrt(variance))
        assert near(found.mu_star, mu_star, np.sqrt(variance - mu_star**2))
        assert found.sigma == pytest.approx(np.sqrt(variance), rel=0.03)
        assert mu_star < 4 * np.log(2) / (1 + A[column]) * 0.95, "the two laws can be told apart"


def test_points_fill_the_box_evenly_and_steps_follow_the_law() -> None:
    n_values = np.array([1001])
    design = radial_design(n_values, SobolRows(COLUMNS, 3), np.array([200]), np.array([600]), SAMPLES)
    base = design.points[design.first[0], 0]
    assert stats.kstest((base - 200) / 400, "uniform").pvalue > 0.01
    lengths = np.abs(design.steps[0]) * 1000
    assert lengths.min() >= 100
    grid = np.arange(401)
    allowed = np.abs(grid[:, None] - grid[None, :]) >= 100
    shares = (allowed / allowed.sum(axis=1, keepdims=True)).ravel() / 401
    exact = float((shares * np.abs(grid[:, None] - grid[None, :]).ravel()).sum())
    assert lengths.mean() == pytest.approx(exact, rel=0.02)
